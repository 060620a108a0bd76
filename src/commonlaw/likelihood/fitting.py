"""States and coefficients of one object, fitted together to what was measured.

Twice the negative log-likelihood is the sum of squared gaps between measured and sought states over the noise, and of
squared defects of the law over a tolerance. As the tolerance goes to zero, the states become a solution of the law and
the coefficients those of maximum likelihood, with free initial states: multiple shooting in which every step is a shot
(Bock 1983). Beginning with a tolerance as large as the noise and lowering it step by step leads there from far away,
also for chaotic laws (Abarbanel's annealing: Ye et al. 2015).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.likelihood.collocation import Dynamics
from commonlaw.likelihood.measurement import Measurement
from commonlaw.likelihood.mesh import Mesh
from commonlaw.likelihood.normal_equations import NotPositiveError, Reduced, reduce

_SHORTEST = 1e-4
"""Steps shorter than this share of the Gauss-Newton step are not tried."""

_GAIN = 1e-3
"""A step that gains less than this in twice the log-likelihood, beside its thousandth part, is the last."""


@dataclass(frozen=True, eq=False)
class Problem:
    """What is known of one object.

    Parameters
    ----------
    dynamics
        The family of laws.
    meshes
        Where states are sought, and what was measured.
    measurement
        What measurements are worth.
    unit
        In what the tolerance for each state's defects is counted, shape (D,): the noise of the measured states, and
        what corresponds to it for their rates.
    """

    dynamics: Dynamics
    meshes: Sequence[Mesh]
    measurement: Measurement
    unit: Floats

    def stiffness(self, mesh: Mesh, tolerance: float) -> Floats:
        """Return what squared defects count, shape (n - 1, D): their tolerance is a random walk in time."""
        return mesh.linked[:, np.newaxis] / (tolerance * self.unit) ** 2 / mesh.shares[:, np.newaxis]

    def gaps(self, mesh: Mesh, states: Floats) -> Floats:
        """Return measured less sought states, shape (n, d); NaN where nothing was measured."""
        return mesh.measured - states[:, : self.dynamics.equations]


@dataclass(frozen=True, eq=False)
class Estimate:
    """States and coefficients of one object.

    Parameters
    ----------
    states
        For each mesh, shape (n, D).
    coefficients
        Shape (equations, terms).
    misfit
        Twice the negative log-likelihood of the measurements, but for a constant.
    strain
        The same with the squared defects; infinite if the coefficients cannot be evaluated.
    """

    states: tuple[Floats, ...]
    coefficients: Floats
    misfit: float = np.inf
    strain: float = np.inf


def fit(problem: Problem, start: Estimate, support: Bools, tolerances: Sequence[float], steps: int = 12) -> Estimate:
    """Return the estimate of largest likelihood, by Gauss-Newton steps, tolerance after tolerance.

    Parameters
    ----------
    problem
        The object.
    start
        Where to begin.
    support
        The coefficients that are free, shape (equations, terms); the others stay.
    tolerances
        Of the law, relative to the noise, from large to small.
    steps
        At most so many for each tolerance.
    """
    found = start
    for tolerance in tolerances:
        found = _judged(problem, found, tolerance)
        for _ in range(steps):
            better = _step(problem, found, support, tolerance)
            if better is None:
                break
            gain = found.strain - better.strain
            found = better
            if gain < _GAIN * (1 + 1e-3 * found.strain):
                break
    return found


def _judged(problem: Problem, estimate: Estimate, tolerance: float) -> Estimate:
    """Return the estimate with its misfit and strain at a tolerance."""
    misfit = strain = 0.0
    with np.errstate(all="ignore"):
        for mesh, states in zip(problem.meshes, estimate.states, strict=True):
            misfit += problem.measurement.misfit(problem.gaps(mesh, states))
            defects = problem.dynamics.defects(mesh, states, estimate.coefficients)
            strain += float(np.sum(defects**2 * problem.stiffness(mesh, tolerance)))
    strain += misfit
    return replace(estimate, misfit=misfit, strain=strain if np.isfinite(strain) else np.inf)


def _reduced(problem: Problem, estimate: Estimate, support: Bools, tolerance: float) -> list[Reduced]:
    found = []
    with np.errstate(all="ignore"):
        for mesh, states in zip(problem.meshes, estimate.states, strict=True):
            slopes = problem.dynamics.slopes(mesh, states, estimate.coefficients, support)
            gaps = problem.gaps(mesh, states)
            weights = problem.measurement.weights(gaps)
            found.append(reduce(slopes, problem.stiffness(mesh, tolerance), weights, gaps))
    return found


def _step(problem: Problem, estimate: Estimate, support: Bools, tolerance: float) -> Estimate | None:
    """Return the estimate after one Gauss-Newton step, shortened until it is better; None if none is."""
    try:
        parts = _reduced(problem, estimate, support, tolerance)
        total = np.sum([each.information for each in parts], axis=0)
        own = _solve(total, -np.sum([each.gradient for each in parts], axis=0))
    except (NotPositiveError, np.linalg.LinAlgError):
        return None
    directions = [each.shift + each.follow @ own for each in parts]
    share = 1.0
    while share > _SHORTEST:
        coefficients = estimate.coefficients.copy()
        coefficients[support] += share * own
        states = tuple(z + share * step for z, step in zip(estimate.states, directions, strict=True))
        found = _judged(problem, Estimate(states, coefficients), tolerance)
        if found.strain < estimate.strain:
            return found
        share *= 0.4
    return None


def _solve(matrix: Floats, right: Floats) -> Floats:
    """Return the solution of least norm, in units in which the matrix has a diagonal of ones."""
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    with np.errstate(over="ignore"):
        relative = matrix / np.outer(scale, scale)
    if not np.isfinite(relative).all():
        raise NotPositiveError
    return np.asarray(np.linalg.lstsq(relative, right / scale, rcond=1e-13)[0] / scale)
