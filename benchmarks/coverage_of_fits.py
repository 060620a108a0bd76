"""How often 95 % intervals of `cl.fit` and `cl.discover` hold the truth, compared with those of least squares."""

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
from commonlaw.law.parameters import coefficient_intervals, named_parameters

Floats = NDArray[np.float64]

SAMPLES, OBJECTS, KINDS, VERBS = (3, 6, 12), (1, 8), ("unknown", "given", "columns"), ("fit", "discover")
LEVEL = 0.95
NOISE = 0.04
"""Standard deviation of the measurements, 2 % of the range of the states."""

SCATTER = 0.2
"""Standard deviation of the logarithms of a coefficient over objects."""


@dataclass(frozen=True, eq=False)
class Family:
    """An equation with its parameters, its solution x(t; parameters, start), and what is typical of an experiment.

    `to_coefficients` turns parameters into the coefficients of `terms`, and is its own inverse.
    """

    equation: str
    parameters: tuple[str, ...]
    terms: tuple[str, ...]
    to_coefficients: Callable[..., tuple[Any, ...]]
    solution: Callable[..., Floats]
    typical: tuple[float, ...]
    start: float
    end: float

    def by_terms(self, time: Floats, *parameters: float) -> Floats:
        """Return the solution by the coefficients of the terms and the start."""
        return self.solution(time, *self.to_coefficients(*parameters[:-1]), parameters[-1])


FAMILIES = {
    "decay": Family(
        "x' = -k*x", ("k",), ("x",), lambda k: (-k,), lambda time, k, start: start * np.exp(-k * time), (0.5,), 2.0, 4.0
    ),
    "growth": Family(
        "x' = r*x*(1 - x/K)",
        ("r", "K"),
        ("x", "x^2"),
        lambda r, K: (r, -r / K),
        lambda time, r, K, start: K / (1 + (K / start - 1) * np.exp(-r * time)),
        (1.0, 2.0),
        0.2,
        8.0,
    ),
}


@dataclass(frozen=True, eq=False)
class Experiment:
    """True parameters of each object, (objects, parameters), and noisy states, (objects, samples), at these times."""

    family: Family
    truth: Floats
    times: Floats
    states: Floats

    @property
    def freedom(self) -> int:
        """The degrees of freedom of the residuals of all objects, whose starts are unknown."""
        return self.states.size - (len(self.family.parameters) + 1) * len(self.states)

    def trials(self, kind: str) -> cl.Trials:
        """Return what was measured, with a column of the noise if that is of the kind `columns`."""
        return cl.Trials.from_arrays(
            [self.times] * len(self.states),
            [*self.states[:, :, np.newaxis]],
            object=[f"object {i + 1}" for i in range(len(self.states))],
            noise=[np.full((len(state), 1), NOISE) for state in self.states] if kind == "columns" else None,
            names=["x"],
        )

    def fit(self, kind: str, **settings: Any) -> cl.Law:
        """Return the fitted law, with the noise `unknown`, `given` as a setting, or in `columns` of the table."""
        return cl.fit(self.family.equation, self.trials(kind), **_given(kind), **settings)

    def discover(self, kind: str) -> cl.Law:
        """Return the law among those with any polynomial of the true degree."""
        method = cl.TrajectoryLikelihood(**_given(kind))
        return cl.discover(self.trials(kind), order=1, library=f"poly:{len(self.family.terms)}", method=method)


def _given(kind: str) -> dict[str, Any]:
    return {"noise": {"x": NOISE}} if kind == "given" else {}


def experiment(name: str, samples: int, objects: int, seed: int, scatter: float = SCATTER) -> Experiment:
    """Return one draw of the objects and of the noise."""
    family, random = FAMILIES[name], np.random.default_rng([seed, samples, objects])
    times = np.linspace(0, family.end, samples)
    truth = np.array(family.typical) * np.exp(scatter * random.standard_normal((objects, len(family.typical))))
    states = np.stack([family.solution(times, *parameters, family.start) for parameters in truth])
    return Experiment(family, truth, times, states + NOISE * random.standard_normal(states.shape))


def stated(law: cl.Law, family: Family) -> tuple[Floats, Floats]:
    """Return the middles of a law's intervals and half their widths, both (objects, parameters)."""
    parameters = named_parameters(law)
    low, high = parameters.intervals(LEVEL)
    order = [parameters.names.index(parameter) for parameter in family.parameters]
    return (low + high)[:, order] / 2, (high - low)[:, order] / 2


def stated_of_terms(law: cl.Law, family: Family, averaged: bool) -> tuple[Floats, Floats]:
    """Return the same of the coefficients of the terms, see `Law.conf_int`; NaN for a law that has others."""
    low, high = coefficient_intervals(law, LEVEL, averaged)
    own = [law.terms.names.index(term) for term in family.terms]
    is_right = np.array_equal(np.flatnonzero(law.support[0]), sorted(own))
    found = np.array([low, high])[:, :, 0, own] if is_right else np.full((2, len(law.objects), len(own)), np.nan)
    return found.mean(axis=0), (found[1] - found[0]) / 2


def least_squares(drawn: Experiment, kind: str, by_terms: bool = False) -> tuple[Floats, Floats]:
    """Return the same of each object by SciPy, the noise estimated from the residuals of all objects."""
    family = drawn.family
    solution = family.by_terms if by_terms else family.solution
    found, covariances, squares = [], [], 0.0
    for parameters, states in zip(drawn.truth, drawn.states, strict=True):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OptimizeWarning)
            start = [*(family.to_coefficients(*parameters) if by_terms else parameters), family.start]
            sigma = np.ones(len(states))
            best, covariance = curve_fit(solution, drawn.times, states, start, sigma, True, maxfev=10_000)
        squares += ((states - solution(drawn.times, *best)) ** 2).sum()
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


def line(verb: str, name: str, samples: int, objects: int, kind: str, draws: int, scatter: float) -> str:
    """Return a row of the table."""
    held, of_average, references, widths, others, by_terms = [], [], [], [], 0, verb == "discover"
    for seed in range(draws):
        drawn = experiment(name, samples, objects, seed, scatter)
        truth = np.stack(drawn.family.to_coefficients(*drawn.truth.T), axis=1) if by_terms else drawn.truth
        reference = least_squares(drawn, kind, by_terms)
        references.append(holds(*reference, truth))
        if drawn.freedom < 1 and kind == "unknown":  # Refused
            continue
        law = drawn.discover(kind) if by_terms else drawn.fit(kind)
        middle, half = stated_of_terms(law, drawn.family, False) if by_terms else stated(law, drawn.family)
        if by_terms:
            of_average.append(holds(*stated_of_terms(law, drawn.family, True), truth))
        held.append(holds(middle, half, truth))
        widths.append(np.median(half / reference[1]))
        others += bool(np.isnan(half).any()) or any(diagnostic.kind.name == "ERRORS" for diagnostic in law.diagnostics)
    width = f"{np.nanmedian(widths):.2f}" if np.isfinite(widths).any() else ""
    shares = f"{share(held)} | {share(of_average) if by_terms else ''} | {share(references)}"
    return f"| {verb} | {name} | {samples} | {objects} | {kind} | {shares} | {width} | {others} |"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line for each cell."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.coverage_of_fits", description=__doc__)
    parser.add_argument("--draws", type=int, default=200, help="of objects and noise (default: %(default)s)")
    parser.add_argument("--scatter", type=float, default=SCATTER, help="of coefficients over objects, relative")
    parser.add_argument("--verbs", nargs="+", choices=VERBS, default=VERBS, metavar="VERB", help=", ".join(VERBS))
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=[*FAMILIES], metavar="FAMILY")
    parser.add_argument("--samples", nargs="+", type=int, default=SAMPLES, metavar="COUNT", help="of a trial")
    parser.add_argument("--objects", nargs="+", type=int, default=OBJECTS, metavar="COUNT", help="one trial each")
    parser.add_argument("--noise", nargs="+", choices=KINDS, default=KINDS, metavar="KIND", help=", ".join(KINDS))
    chosen = parser.parse_args(arguments)
    print(f"{machine()}\n\nShare of the 95 % intervals that hold the truth; goal: 0.93 to 0.97.\n")
    print("| verb | family | samples | objects | noise | share | averaged | least squares | width | other laws |")
    print("|" + "---|" * 10)
    for cell in itertools.product(chosen.verbs, chosen.families, chosen.samples, chosen.objects, chosen.noise):
        print(line(*cell, chosen.draws, chosen.scatter), flush=True)


if __name__ == "__main__":
    main()
