"""How often the 95 % intervals of `cl.fit` hold the true coefficients, compared with those of least squares."""

import argparse
import itertools
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeWarning, curve_fit
from scipy.stats import norm, t

import commonlaw as cl
from benchmarks.machine import machine

Floats = NDArray[np.float64]

SAMPLES, OBJECTS, KINDS = (3, 6, 12), (1, 8), ("unknown", "given", "columns")
LEVEL = 0.95
NOISE = 0.04
"""Standard deviation of the measurements, 2 % of the range of the states."""

SCATTER = 0.2
"""Standard deviation of the logarithms of a coefficient over objects."""


@dataclass(frozen=True, eq=False)
class Family:
    """An equation with its letters, its solution x(t; letters, start), and what is typical of an experiment."""

    equation: str
    letters: tuple[str, ...]
    solution: Callable[..., Floats]
    typical: tuple[float, ...]
    start: float
    end: float


FAMILIES = {
    "decay": Family("x' = -k*x", ("k",), lambda time, k, start: start * np.exp(-k * time), (0.5,), 2.0, 4.0),
    "growth": Family(
        "x' = r*x*(1 - x/K)",
        ("r", "K"),
        lambda time, r, K, start: K / (1 + (K / start - 1) * np.exp(-r * time)),
        (1.0, 2.0),
        0.2,
        8.0,
    ),
}


@dataclass(frozen=True, eq=False)
class Experiment:
    """True letters of each object, (objects, letters), and states with noise, (objects, samples), at these times."""

    family: Family
    truth: Floats
    times: Floats
    states: Floats

    @property
    def freedom(self) -> int:
        """The degrees of freedom of the residuals of all objects, whose starts are unknown."""
        return self.states.size - (len(self.family.letters) + 1) * len(self.states)

    def fit(self, kind: str, **settings: Any) -> cl.Law:
        """Return the law, with the noise `unknown`, `given` as a setting, or in `columns` of the table."""
        states = [*self.states[:, :, np.newaxis]]
        trials = cl.Trials.from_arrays(
            [self.times] * len(states),
            states,
            object=[f"object {i + 1}" for i in range(len(states))],
            noise=[np.full_like(each, NOISE) for each in states] if kind == "columns" else None,
            names=["x"],
        )
        if kind == "given":
            settings["noise"] = {"x": NOISE}
        return cl.fit(self.family.equation, trials, **settings)


def experiment(name: str, samples: int, objects: int, seed: int, scatter: float = SCATTER) -> Experiment:
    """Return one draw of the objects and of the noise."""
    family, random = FAMILIES[name], np.random.default_rng([seed, samples, objects])
    times = np.linspace(0, family.end, samples)
    truth = np.array(family.typical) * np.exp(scatter * random.standard_normal((objects, len(family.typical))))
    states = np.stack([family.solution(times, *letters, family.start) for letters in truth])
    return Experiment(family, truth, times, states + NOISE * random.standard_normal(states.shape))


def stated(law: cl.Law, family: Family) -> tuple[Floats, Floats]:
    """Return the middles of a law's intervals and half their widths, both (objects, letters)."""
    low, high = law.letter_interval_ends(LEVEL)
    order = [law.letters.index(letter) for letter in family.letters]
    return (low + high)[:, order] / 2, (high - low)[:, order] / 2


def least_squares(drawn: Experiment, kind: str) -> tuple[Floats, Floats]:
    """Return the same of each object by SciPy, the noise estimated from the residuals of all objects."""
    family = drawn.family
    found, covariances, squares = [], [], 0.0
    for letters, states in zip(drawn.truth, drawn.states, strict=True):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OptimizeWarning)
            start = [*letters, family.start]
            sigma = np.ones(len(states))
            best, covariance = curve_fit(family.solution, drawn.times, states, start, sigma, True, maxfev=10_000)
        squares += ((states - family.solution(drawn.times, *best)) ** 2).sum()
        found.append(best[:-1])
        covariances.append(np.diag(covariance)[:-1])
    freedom = drawn.freedom
    if kind != "unknown":
        reach = NOISE * norm.ppf((1 + LEVEL) / 2)
    else:
        reach = np.sqrt(squares / freedom) * t.ppf((1 + LEVEL) / 2, freedom) if freedom else np.nan
    return np.array(found), reach * np.sqrt(covariances)


def holds(middle: Floats, half: Floats, truth: Floats) -> float:
    """Return the share of the intervals that hold the truth, NaN where they have no ends."""
    return float(np.mean(abs(middle - truth) <= half)) if np.isfinite(half).all() else np.nan


def share(held: Iterable[float]) -> str:
    """Return the mean over draws with its standard error, or that no interval has ends."""
    known = np.array([each for each in held if not np.isnan(each)])
    if not len(known):
        return "none"
    return f"{known.mean():.3f} ± {known.std() / np.sqrt(len(known)):.3f}"


def line(name: str, samples: int, objects: int, kind: str, draws: int, scatter: float) -> str:
    """Return a row of the table."""
    held, references, widths, other_errors = [], [], [], 0
    for seed in range(draws):
        drawn = experiment(name, samples, objects, seed, scatter)
        reference = least_squares(drawn, kind)
        references.append(holds(*reference, drawn.truth))
        if drawn.freedom < 1 and kind == "unknown":  # Refused
            continue
        law = drawn.fit(kind)
        middle, half = stated(law, drawn.family)
        held.append(holds(middle, half, drawn.truth))
        widths.append(np.median(half / reference[1]))
        other_errors += any(each.kind.name == "ERRORS" for each in law.outcomes)
    width = f"{np.median(widths):.2f}" if widths else ""
    return (
        f"| {name} | {samples} | {objects} | {kind} | {share(held)} | {share(references)} | {width} | {other_errors} |"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line for each cell."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.coverage_of_fits", description=__doc__)
    parser.add_argument("--draws", type=int, default=200, help="of objects and noise (default: %(default)s)")
    parser.add_argument("--scatter", type=float, default=SCATTER, help="of coefficients over objects, relative")
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=[*FAMILIES], metavar="FAMILY")
    parser.add_argument("--samples", nargs="+", type=int, default=SAMPLES, metavar="COUNT", help="of a trial")
    parser.add_argument("--objects", nargs="+", type=int, default=OBJECTS, metavar="COUNT", help="one trial each")
    parser.add_argument("--noise", nargs="+", choices=KINDS, default=KINDS, metavar="KIND", help=", ".join(KINDS))
    chosen = parser.parse_args(arguments)
    print(f"{machine()}\n\nShare of the 95 % intervals that hold the truth; goal: 0.93 to 0.97.\n")
    print("| family | samples | objects | noise | share | least squares | width | other errors |")
    print("|" + "---|" * 8)
    for cell in itertools.product(chosen.families, chosen.samples, chosen.objects, chosen.noise):
        print(line(*cell, chosen.draws, chosen.scatter), flush=True)


if __name__ == "__main__":
    main()
