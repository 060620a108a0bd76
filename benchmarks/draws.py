"""What comes out of many draws of the noise on the same experiment."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from scipy.stats import norm

import commonlaw as cl
from benchmarks.families import Experiment, experiment
from benchmarks.variational import term_values
from commonlaw.differentiation import AbstractDifferentiator, parse_differentiation
from commonlaw.law import pool_objects
from commonlaw.law.parameters import reach_of_equations

Floats = NDArray[np.float64]

SMOOTHINGS = ("spline", "savgol:7:3", "savgol:15:3", "savgol:35:3")
"""Ways of estimating rates for plain regression: the smoothing spline chooses its strength, the others have windows."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """Coefficients from one draw of the noise, shape (objects, parameters).

    Parameters
    ----------
    own
        By commonlaw's defaults, before they are pooled; nothing where the support is not the true one.
    found
        By commonlaw's defaults.
    plain
        By plain regression on the true terms, with each of the `SMOOTHINGS`.
    """

    own: "Stated | None"
    found: "Stated | None"
    plain: tuple[Floats, ...]


@dataclass(frozen=True, eq=False)
class Stated:
    """Coefficients and the standard errors that a law states, each of shape (objects, parameters).

    And how many of these its 95 % intervals reach to both sides, shape (parameters,) or one number.
    """

    coefficients: Floats
    errors: Floats
    reach: Floats | float = float(norm.ppf(0.975))


def draw(name: str, level: float, count: int, n_jobs: int = 1) -> list[Outcome]:
    """Return the outcomes of that many draws, the same whatever the number of jobs."""
    return list(Parallel(n_jobs=n_jobs)(delayed(_outcome)(name, level, seed) for seed in range(count)))


def add_options(parser: argparse.ArgumentParser, families: Sequence[str], count: int) -> None:
    """Add how much is to be drawn to a command line."""
    parser.add_argument("--families", nargs="+", choices=families, default=families, metavar="FAMILY")
    parser.add_argument("--draws", type=int, default=count, help="of the noise (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: %(default)s)")


def plain_regression(experiment: Experiment, trials: cl.Trials, smoothing: AbstractDifferentiator) -> Floats:
    """Return each object's coefficients by least squares of smoothed rates on the true terms of smoothed states."""
    family = experiment.family
    coefficients = []
    for name in trials.objects:
        rates = [smoothing.differentiate(trial.times, trial.states, family.order) for trial in trials.of_object(name)]
        values = np.concatenate([np.hstack([rate.states, *rate.derivatives[:-1]]) for rate in rates])
        targets = np.concatenate([rate.derivatives[-1] for rate in rates])
        own: list[float] = []
        for equation, target in zip(family.equations, targets.T, strict=True):
            library = np.stack([term_values(term, family.variables, values) for term in equation], axis=1)
            own += np.linalg.lstsq(library, target, rcond=None)[0].tolist()
        coefficients.append(own)
    return np.array(coefficients)


def stated(known: Experiment, law: cl.Law) -> Stated | None:
    """Return what a law states of the coefficients; nothing where its support is not the true one."""
    coefficients = known.estimates(law)
    if coefficients is None:
        return None
    sizes = list(map(len, known.family.equations))
    return Stated(coefficients, known.errors(law), np.repeat(reach_of_equations(law), sizes))


def _outcome(name: str, level: float, seed: int) -> Outcome:
    known = experiment(name)
    trials = known.measured(level, seed)
    law = known.discover(trials)
    plain = tuple(plain_regression(known, trials, parse_differentiation(each)) for each in SMOOTHINGS)
    return Outcome(stated(known, law), stated(known, pool_objects(law)), plain)
