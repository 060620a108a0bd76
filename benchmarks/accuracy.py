"""How near coefficients come to least squares on all rows, by how badly scaled and conditioned the library is."""

import numpy as np
from numpy.typing import NDArray

import commonlaw as cl
from benchmarks.problem import lorenz
from commonlaw.formulation import law_variables

Floats = NDArray[np.float64]


def main() -> None:
    """Print one line for each library."""
    print("| library | rows | terms | condition | of scaled columns | largest error | relative to itself |")
    print("|---|---|---|---|---|---|---|")
    for name, library, targets in _libraries():
        raw, scaled = np.linalg.cond(library), np.linalg.cond(library / np.linalg.norm(library, axis=0))
        most, own = errors(library, targets)
        shape = f"{library.shape[0]} | {library.shape[1]}"
        print(f"| {name} | {shape} | {raw:.0e} | {scaled:.0e} | {most:.0e} | {own:.0e} |")
    print()


def errors(library: Floats, targets: Floats) -> tuple[float, float]:
    """Return the largest difference of coefficients to those of `numpy.linalg.lstsq` on all rows.

    Of columns scaled to unit norm, relative to the largest coefficient of the equation; and relative to the
    coefficient itself.
    """
    scales = np.linalg.norm(library, axis=0)
    expected = np.linalg.lstsq(library / scales, targets, rcond=None)[0]
    system, everything = cl.formulation.LeastSquaresProblem.of(library, targets), np.ones(library.shape[1], dtype=bool)
    found = np.stack([system.least_squares(everything, j) * scales for j in range(targets.shape[1])], axis=1)
    apart = np.abs(found - expected)
    return float(np.max(apart / np.abs(expected).max(axis=0))), float(np.max(apart / np.abs(expected)))


def _libraries() -> list[tuple[str, Floats, Floats]]:
    return [
        *[(f"Lorenz, degree {degree}", *_rows(degree)) for degree in range(1, 7)],
        *[(f"random, condition 1e{digits}, scales 1e-8 to 1e8", *_random(10.0**digits)) for digits in range(2, 11, 2)],
    ]


def _rows(degree: int) -> tuple[Floats, Floats]:
    problem = lorenz(20_000, degree)
    trials = cl.Trials.from_arrays(problem.times, problem.states[0])
    form = cl.formulation.StrongForm(cl.differentiation.FiniteDifference())
    return form.rows(trials[0], cl.library.PolynomialLibrary(degree).bind(law_variables(trials.schema, form.order)))


def _random(condition: float) -> tuple[Floats, Floats]:
    """Return rows of random columns of that condition, then scaled by up to 16 powers of ten, and a target."""
    generator = np.random.default_rng(0)
    left, _ = np.linalg.qr(generator.standard_normal((20_000, 20)))
    right, _ = np.linalg.qr(generator.standard_normal((20, 20)))
    library = left * np.geomspace(1, 1 / condition, 20) @ right
    targets = library @ generator.uniform(1, 2, (20, 1))
    return library * 10.0 ** generator.uniform(-8, 8, 20), targets


if __name__ == "__main__":
    main()
