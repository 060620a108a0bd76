"""Functions of several coordinates beside each other, by their evidence."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.discrepancy.coordinates import basis_of
from commonlaw.discrepancy.setting import Setting
from commonlaw.discrepancy.smooth_basis import SmoothBasis
from commonlaw.discrepancy.trajectories import FunctionFit, annealed, best, fit_about
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.inference.fit.fit import NO_ERROR
from commonlaw.likelihood import NotPositiveError


@dataclass(frozen=True, eq=False)
class CandidateFunction:
    """A function of a coordinate in an equation, and the value that its evidence has about the law alone."""

    basis: SmoothBasis
    equation: int
    value: float


def candidates(
    setting: Setting, coordinates: Sequence[str], times: str, equations: Sequence[int], zero_at: float | str | None
) -> list[CandidateFunction]:
    """Return functions of coordinates in equations, that of largest evidence first."""
    found, reasons = [], []
    for coordinate in coordinates:
        try:
            basis = basis_of(setting.visited, coordinate, times)
        except CommonlawError as error:
            reasons.append(error)
            continue
        found += [CandidateFunction(basis, equation, 0.0) for equation in equations]
    if not found:
        raise CommonlawError("several", messages=reasons)
    if len(found) == 1:
        return found
    alone = best(annealed(setting.problem, setting.alone))
    valued = [replace(each, value=_value(setting, alone, each, zero_at)) for each in found]
    return sorted(valued, key=lambda each: each.value)


def _value(setting: Setting, alone: FunctionFit, candidate: CandidateFunction, zero_at: float | str | None) -> float:
    model = setting.with_function(candidate.basis, candidate.equation, zero_at)
    more = ((0, 0), (0, len(candidate.basis)))
    estimates = tuple(replace(each, coefficients=np.pad(each.coefficients, more)) for each in alone.estimates)
    found = [np.inf]
    for model_error in {alone.model_error, NO_ERROR}:
        with suppress(NotPositiveError):
            found.append(fit_about(setting.problem, model, estimates, model_error).value)
    return min(found)


def equations_of(setting: Setting, equation: str | None) -> list[int]:
    """Return the equations that a function may stand in: the given one, or those with coefficients to be found."""
    states = setting.law.states
    if equation is not None:
        check_choice("equation", equation, states)
        return [states.index(equation)]
    return np.flatnonzero(setting.own.any(axis=1)).tolist() or list(range(len(states)))
