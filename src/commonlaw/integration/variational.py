"""Derivatives of a trajectory by parameters and initial states: linear equations along it, for all steps at once.

Radau IIA of order 5 (Hairer and Wanner 1996, Solving Ordinary Differential Equations II, table IV.5.6), which is stable
for stiff laws; steps are halved until two halves do with the derivatives what the whole does.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.integration.problem import InitialValueProblem

_ROOT, _ROUNDS = np.sqrt(6), 20
_NODES = np.array([(4 - _ROOT) / 10, (4 + _ROOT) / 10, 1.0])
_WEIGHTS = np.array(
    [
        [(88 - 7 * _ROOT) / 360, (296 - 169 * _ROOT) / 1800, (-2 + 3 * _ROOT) / 225],
        [(296 + 169 * _ROOT) / 1800, (88 + 7 * _ROOT) / 360, (-2 - 3 * _ROOT) / 225],
        [(16 - _ROOT) / 36, (16 + _ROOT) / 36, 1 / 9],
    ]
)


class _Steps(NamedTuple):
    """From `starts` to `ends`, shape (m,), derivatives are multiplied by (m, D, D) and have (m, D, p) added to them.

    Each step is made in two halves; the last two say how far off it is if made at once.
    """

    starts: Floats
    ends: Floats
    by_states: Floats
    added: Floats
    off_by_states: Floats
    off_added: Floats


def sensitivities(
    problem: InitialValueProblem, path: Callable[[Floats], Floats], knots: Floats, reached: int, tolerance: float
) -> Floats:
    """Return derivatives of the states by parameters and then by the initial states, shape (n, D, p + D).

    The path is what was integrated: from times, shape (m,), to states, (m, D), a few steps of the integrator between
    the knots, shape (k,). It reached so many of the n times; derivatives are NaN after these. The tolerance is the
    relative error of a step.
    """
    times, width, size = problem.times[:reached], len(problem.initial), len(problem.field.parameters)
    found = np.full((len(problem.times), width, size + width), np.nan)
    found[0] = np.eye(width, size + width, size)
    if reached == 1:
        return found
    edges = np.unique(np.concatenate([times, problem.stops, knots]))
    edges = edges[(edges >= times[0]) & (edges <= times[-1])]
    # What a parameter is worth changes the states by their size if it doubles
    sizes = np.abs(problem.field.parameters) / (np.max(np.abs(problem.initial)) or 1.0)
    scale = np.concatenate([np.where(sizes == 0, 1.0, sizes), np.ones(width)])
    steps = _halved(problem, path, edges[:-1], edges[1:])
    for round_ in range(_ROUNDS + 1):
        own = _along(steps, found[0])
        coarse = _coarse(steps, own, scale, tolerance)
        if not coarse.any() or round_ == _ROUNDS or len(coarse) > 300_000:
            break
        starts, ends = steps.starts[coarse], steps.ends[coarse]
        middles = (starts + ends) / 2
        finer = _halved(problem, path, np.concatenate([starts, middles]), np.concatenate([middles, ends]))
        order = np.argsort(np.concatenate([steps.starts[~coarse], finer.starts]))
        pairs = zip(steps, finer, strict=True)
        steps = _Steps(*(np.concatenate([old[~coarse], new])[order] for old, new in pairs))
    found[1:reached] = own[1:][np.searchsorted(steps.ends, times[1:])]
    return found


def _along(steps: _Steps, first: Floats) -> Floats:
    """Return the first derivatives, shape (D, p + D), and those after each of m steps, shape (m + 1, D, p + D)."""
    own, size = np.empty((len(steps.starts) + 1, *first.shape)), steps.added.shape[2]
    own[0] = first
    with np.errstate(all="ignore"):
        for k, (by_states, added) in enumerate(zip(steps.by_states, steps.added, strict=True), 1):
            np.matmul(by_states, own[k - 1], out=own[k])
            own[k, :, :size] += added
    return own


def _coarse(steps: _Steps, own: Floats, scale: Floats, tolerance: float) -> Bools:
    """Return which steps are not exact enough for the derivatives that they start from, shape (m,)."""
    with np.errstate(all="ignore"):
        residuals = steps.off_by_states @ own[:-1]
        residuals[:, :, : steps.off_added.shape[2]] += steps.off_added
        error, after = (np.abs(each).max(axis=1) * scale for each in (residuals, own[1:]))
        return np.asarray((error > tolerance * np.maximum(1.0, after)).any(axis=1))


def _halved(problem: InitialValueProblem, path: Callable[[Floats], Floats], starts: Floats, ends: Floats) -> _Steps:
    """Return steps between times."""
    parts, together = [], 20_000  # More would fill memory
    for first in range(0, len(starts), together):
        some, until = starts[first : first + together], ends[first : first + together]
        middles = (some + until) / 2
        spans = (some, middles), (middles, until), (some, until)
        (left, more), (right, last), (whole, added) = (_radau(problem, path, *span) for span in spans)
        with np.errstate(all="ignore"):
            halves = right @ left, right @ more + last
            parts.append((*halves, whole - halves[0], added - halves[1]))
    return _Steps(starts, ends, *(np.concatenate(each) for each in zip(*parts, strict=True)))


def _radau(
    problem: InitialValueProblem, path: Callable[[Floats], Floats], starts: Floats, ends: Floats
) -> tuple[Floats, Floats]:
    """Return what one step multiplies derivatives by, and what it adds, where inputs do not change their course."""
    field, count, lengths = problem.field, len(starts), (ends - starts)[:, np.newaxis]
    # At the end itself the inputs are those before it
    times = np.minimum(starts[:, np.newaxis] + lengths * _NODES, np.nextafter(ends, starts)[:, np.newaxis]).ravel()
    inputs = np.empty((len(times), 0)) if field.inputs is None else field.inputs.at(times)
    with np.errstate(all="ignore"):
        _, by_states, by_parameters = field.linearize(np.column_stack([path(times), inputs, times]))
        width, nodes = by_states.shape[1], len(_NODES)
        shares = lengths[:, :, np.newaxis] * _WEIGHTS
        slopes = by_states.reshape(count, nodes, width, width)
        pushes = by_parameters.reshape(count, nodes, width, -1)
        matrix = np.eye(nodes * width) - np.einsum("mij,mjab->miajb", shares, slopes).reshape(count, nodes * width, -1)
        pushed = np.einsum("mij,mjap->miap", shares, pushes).reshape(count, nodes * width, -1)
        unit = np.broadcast_to(np.tile(np.eye(width), (nodes, 1)), (count, nodes * width, width))
        matrix[~np.isfinite(matrix).all(axis=(1, 2))] = np.nan
        columns = np.concatenate([unit, pushed], axis=2)
        try:
            solved = np.linalg.solve(matrix, columns)[:, -width:]
        except np.linalg.LinAlgError:
            solved = (np.linalg.pinv(np.nan_to_num(matrix)) @ columns)[:, -width:]
    return solved[:, :, :width], solved[:, :, width:]
