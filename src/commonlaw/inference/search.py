"""The search for the supports of a law, from many terms to few, while the trajectories become solutions of it.

At each tolerance the likelihood is linearised about the trajectories and coefficients so far, the supports of largest
evidence are chosen on it, and both are fitted again. Supports and tolerances are compared by their evidence: where the
measurements obey a law of the library, the smallest tolerance wins; where they do not, one wins that leaves the law an
error of its own, a random walk that pushes the states off their course (weak constraint; Evensen 2009, chapter 7).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.errors import CommonlawError
from commonlaw.inference.objects import Objects
from commonlaw.likelihood import Estimate, NotPositiveError, fit, linearize
from commonlaw.selection import Joint
from commonlaw.solvers import AbstractSolver

SCHEDULES = ((3.0, 1.0, 0.3, 0.1, 0.03), (0.3, 0.03), (0.1, 0.03))
"""Tolerances, relative to the noise, at which supports are chosen. Different ways find different supports; the best is
kept."""

ERRORS = (10.0, 3.0, 1.0, 0.3, 0.1)
"""Tolerances that are compared as errors of a law."""

OBEYED = 0.03
"""Tolerance at and below which a law counts as obeyed."""

FINAL = (0.03, 0.003, 0.0003)
"""Tolerances down to which laws that are obeyed are fitted. The last times the number of samples of a trial should be
below one: what is tolerated in each step adds up, and coefficients would be less accurate than the data allow."""

_ROUNDS = 6
"""How often supports are chosen and fitted at one tolerance at the end."""


@dataclass(frozen=True, eq=False)
class Found:
    """Supports, and the estimates of all objects with them.

    Parameters
    ----------
    supports
        Shape (equations, terms).
    estimates
        One for each object.
    tolerance
        Of the law, relative to the noise.
    value
        Minus twice the log-evidence, but for a constant.
    """

    supports: Bools
    estimates: tuple[Estimate, ...]
    tolerance: float
    value: float

    @property
    def obeyed(self) -> bool:
        """Whether the measurements obey the law, up to their noise."""
        return self.tolerance <= OBEYED

    @property
    def finest(self) -> float:
        """The tolerance at which the estimates were fitted."""
        return FINAL[-1] if self.obeyed else self.tolerance


def search(objects: Objects, solver: AbstractSolver, progress: Callable[[str], None]) -> Found:
    """Return the supports and tolerance of largest evidence that are found, and the estimates with them.

    Parameters
    ----------
    objects
        Where to look.
    solver
        Whose path lists candidates.
    progress
        Takes what is being done.

    Raises
    ------
    CommonlawError
        If the likelihood cannot be computed on any way.
    """
    found = []
    for number, tolerances in enumerate(SCHEDULES, start=1):
        progress(f"choosing terms, way {number} of {len(SCHEDULES)}")
        found += _anneal(objects, solver, tolerances)
    return _best(found)


def settle(
    objects: Objects, supports: Bools, estimates: Sequence[Estimate], tolerance: float, solver: AbstractSolver
) -> Found:
    """Choose and fit at one tolerance until nothing gets better.

    Raises
    ------
    NotPositiveError
        If numbers are not finite, or too far apart.
    """
    best: Found | None = None
    for _ in range(_ROUNDS):
        estimates = _fitted(objects, estimates, supports, FINAL if tolerance <= OBEYED else (tolerance,))
        linear = _linearised(objects, estimates, tolerance)
        found = Found(supports, tuple(estimates), tolerance, linear.joint.value(supports) + linear.volume)
        if best is not None and not found.value < best.value:
            break
        best = found
        chosen = linear.joint.choose(supports, solver)
        if np.array_equal(chosen, supports):
            break
        supports, estimates = chosen, _restricted(objects, linear.joint, estimates, chosen)
    assert best is not None
    return best


def with_supports(objects: Objects, supports: Bools, tolerances: Sequence[float] = ERRORS) -> Found:
    """Return the estimates with these supports, and with the error of the law that has the largest evidence.

    Parameters
    ----------
    objects
        What was measured.
    supports
        Shape (equations, terms).
    tolerances
        The errors of the law that are compared.

    Raises
    ------
    CommonlawError
        If the likelihood cannot be computed.
    """
    found: list[Found] = []
    estimates: tuple[Estimate, ...] = objects.starts
    for tolerance in tolerances:
        try:
            linear = _linearised(objects, estimates, tolerance)
            estimates = _restricted(objects, linear.joint, estimates, supports)
            estimates = _fitted(objects, estimates, supports, FINAL if tolerance <= OBEYED else (tolerance,))
            linear = _linearised(objects, estimates, tolerance)
        except NotPositiveError:
            break
        found.append(Found(supports, estimates, tolerance, linear.joint.value(supports) + linear.volume))
    return _best(found)


def rivals(objects: Objects, found: Found) -> list[list[tuple[Bools, float]]]:
    """Return the supports next to those found, equation by equation, see `Joint.rivals`."""
    return _linearised(objects, found.estimates, found.tolerance).joint.rivals(found.supports)


def _anneal(objects: Objects, solver: AbstractSolver, tolerances: Sequence[float]) -> list[Found]:
    """Choose and fit, tolerance after tolerance; return what was found at each, as far as it can be computed."""
    supports: Bools = objects.allowed
    estimates: tuple[Estimate, ...] = objects.starts
    found: list[Found] = []
    for tolerance in tolerances:
        try:
            linear = _linearised(objects, estimates, tolerance)
            chosen = linear.joint.choose(supports, solver)
            if not np.array_equal(chosen, supports):
                supports, estimates = chosen, _restricted(objects, linear.joint, estimates, chosen)
            if tolerance > OBEYED:
                estimates = _fitted(objects, estimates, supports, (tolerance,))
                linear = _linearised(objects, estimates, tolerance)
                found.append(Found(supports, estimates, tolerance, linear.joint.value(supports) + linear.volume))
            else:
                found.append(settle(objects, supports, estimates, tolerance, solver))
        except NotPositiveError:
            break
    return found


def _best(found: Sequence[Found]) -> Found:
    if not found:
        raise CommonlawError(
            "no law was found whose trajectories stay near the measurements: these may be too noisy or too far apart "
            "for this library; try fewer terms, or choose by rates with formulation='rates'"
        )
    return min(found, key=lambda each: each.value)


@dataclass(frozen=True, eq=False)
class _Linear:
    """The linearised likelihood of all objects, and what its tolerance adds to minus twice its logarithm."""

    joint: Joint
    volume: float


def _linearised(objects: Objects, estimates: Sequence[Estimate], tolerance: float) -> _Linear:
    pairs = zip(objects.models, estimates, strict=True)
    linearizations = [linearize(model, estimate, tolerance) for model, estimate in pairs]
    known = np.nan_to_num(objects.known)
    problems = [each.problem.subtract(own.reshape(1, -1)) for each, own in zip(linearizations, known, strict=True)]
    joint = Joint(problems, objects.allowed, sum(objects.measured), objects.most_terms)
    # An error of the law is one more number to be found, at the price of any (BIC)
    price = 0.0 if tolerance <= OBEYED else float(np.log(joint.measured))
    return _Linear(joint, sum(each.log_determinant for each in linearizations) + price)


def _restricted(objects: Objects, joint: Joint, estimates: Sequence[Estimate], supports: Bools) -> tuple[Estimate, ...]:
    """Return the estimates with the coefficients that the linearised likelihood gives for these supports."""
    coefficients = joint.coefficients(supports) + np.nan_to_num(objects.known)
    return tuple(replace(each, coefficients=own) for each, own in zip(estimates, coefficients, strict=True))


def _fitted(
    objects: Objects, estimates: Sequence[Estimate], supports: Bools, tolerances: Sequence[float]
) -> tuple[Estimate, ...]:
    pairs = zip(objects.models, estimates, strict=True)
    return tuple(fit(model, estimate, supports, tolerances) for model, estimate in pairs)
