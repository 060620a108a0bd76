"""Integration by SciPy: LSODA (Petzold 1983), for stiff problems and others, and for any function of the states.

Derivatives of a trajectory by parameters and initial states are linear equations along it, solved for all steps at once
by Radau IIA of order 5 (Hairer and Wanner 1996, Solving Ordinary Differential Equations II, table IV.5.6), which is
stable for stiff laws; steps are halved until two halves do with the derivatives what the whole does.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import NamedTuple

import numpy as np
from scipy.integrate import LSODA, DenseOutput, OdeSolution
from scipy.optimize import brentq

from commonlaw.array_types import Bools, Floats
from commonlaw.integration.problem import (
    FAR,
    AbstractIntegrator,
    EventFunctions,
    Function,
    InitialValueProblem,
    OutputOptions,
    Trajectory,
    diverged,
    occurrences,
    state_scale,
    step_limit,
)
from commonlaw.runtime.packages import quiet

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
    slopes = np.full((len(problem.times), width, size + width), np.nan)
    slopes[0] = np.eye(width, size + width, size)
    if reached == 1:
        return slopes
    edges = np.unique(np.concatenate([times, problem.stops, knots]))
    edges = edges[(edges >= times[0]) & (edges <= times[-1])]
    # What a parameter is worth changes the states by their size if it doubles
    sizes = np.abs(problem.field.parameters) / (np.max(np.abs(problem.initial)) or 1.0)
    scale = np.concatenate([np.where(sizes == 0, 1.0, sizes), np.ones(width)])
    steps = _halved(problem, path, edges[:-1], edges[1:])
    for round_ in range(_ROUNDS + 1):
        path_slopes = _along(steps, slopes[0])
        coarse = _coarse(steps, path_slopes, scale, tolerance)
        if not coarse.any() or round_ == _ROUNDS or len(coarse) > 300_000:
            break
        starts, ends = steps.starts[coarse], steps.ends[coarse]
        middles = (starts + ends) / 2
        finer = _halved(problem, path, np.concatenate([starts, middles]), np.concatenate([middles, ends]))
        order = np.argsort(np.concatenate([steps.starts[~coarse], finer.starts]))
        pairs = zip(steps, finer, strict=True)
        steps = _Steps(*(np.concatenate([old[~coarse], new])[order] for old, new in pairs))
    slopes[1:reached] = path_slopes[1:][np.searchsorted(steps.ends, times[1:])]
    return slopes


def _along(steps: _Steps, first: Floats) -> Floats:
    """Return the first derivatives, shape (D, p + D), and those after each of m steps, shape (m + 1, D, p + D)."""
    slopes, size = np.empty((len(steps.starts) + 1, *first.shape)), steps.added.shape[2]
    slopes[0] = first
    with np.errstate(all="ignore"):
        for k, (by_states, added) in enumerate(zip(steps.by_states, steps.added, strict=True), 1):
            np.matmul(by_states, slopes[k - 1], out=slopes[k])
            slopes[k, :, :size] += added
    return slopes


def _coarse(steps: _Steps, slopes: Floats, scale: Floats, tolerance: float) -> Bools:
    """Return which steps are not exact enough for the derivatives that they start from, shape (m,)."""
    with np.errstate(all="ignore"):
        residuals = steps.off_by_states @ slopes[:-1]
        residuals[:, :, : steps.off_added.shape[2]] += steps.off_added
        error, after = (np.abs(array).max(axis=1) * scale for array in (residuals, slopes[1:]))
        return np.asarray((error > tolerance * np.maximum(1.0, after)).any(axis=1))


def _halved(problem: InitialValueProblem, path: Callable[[Floats], Floats], starts: Floats, ends: Floats) -> _Steps:
    """Return steps between times."""
    parts, together = [], 20_000  # More would fill memory
    for first in range(0, len(starts), together):
        some, until = starts[first : first + together], ends[first : first + together]
        middles = (some + until) / 2
        spans = (some, middles), (middles, until), (some, until)
        (first_half, more), (right, last), (whole, added) = (_radau(problem, path, *span) for span in spans)
        with np.errstate(all="ignore"):
            halves = right @ first_half, right @ more + last
            parts.append((*halves, whole - halves[0], added - halves[1]))
    return _Steps(starts, ends, *(np.concatenate(blocks) for blocks in zip(*parts, strict=True)))


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


_MANY, _NOWHERE = 5000, 1e-6
"""So many steps that together pass less than this share of the time are where the law does not lead out of."""
_TOLERANCES = 1e-3
"""The absolute tolerance by the relative one times the size of the states; a size wrong by more would hide them."""


@dataclass(frozen=True)
class LsodaIntegrator(AbstractIntegrator):
    """The back end that is always there, and takes every law."""

    options: OutputOptions

    def integrate(self, problem: InitialValueProblem) -> Trajectory:
        """Return the trajectory of a problem; sensitivities solve the variational equations along it."""
        options, vector_field, width = self.options, problem.field, len(problem.initial)
        search = None
        if options.events:
            functions = EventFunctions(options.events, vector_field)
            first = functions.at_start(problem.start, problem.initial, float(np.ptp(problem.times)))
            search = _EventSearch(functions, problem.start, first)
        dense = options.dense or options.sensitivities
        arguments = (
            problem.initial,
            problem.times,
            options.tolerance,
            problem.where,
            search,
            dense,
            problem.stops,
            options.limit,
        )
        result = solve(RightHandSide(vector_field, vector_field.jacobian), *arguments)
        events = occurrences(options.events, search.found if search else [], width)
        result = replace(result, events=events)
        if not options.sensitivities:
            return result
        assert isinstance(result.dense, _Track)
        # Derivatives begin anew after four steps of the states
        knots, reached = np.array(result.dense.knots[::4]), int(np.isfinite(result.states[:, 0]).sum())
        derivatives = sensitivities(problem, result.dense, knots, reached, options.tolerance)
        return replace(result, sensitivities=derivatives, dense=result.dense if options.dense else None)


@dataclass(frozen=True)
class RightHandSide:
    """What LSODA integrates: derivatives, and their Jacobian or nothing."""

    derivatives: Function
    jacobian: Function | None

    def until(self, last: float) -> "RightHandSide":
        """Return the same with whatever depends on time as it is at the `last` one from there on."""
        derivatives, jacobian = self.derivatives, self.jacobian
        return RightHandSide(
            lambda t, y: derivatives(min(t, last), y),
            None if jacobian is None else lambda t, y: jacobian(min(t, last), y),
        )


@dataclass
class _EventSearch:
    """Looks for events along the steps, and keeps what it finds."""

    functions: EventFunctions
    time: float
    last: Floats
    found: list[tuple[int, float, Floats]] = field(default_factory=list)

    def look(self, interpolant: DenseOutput, until: float, width: int) -> float | None:
        """Look at a step, given by its dense output; return when a terminal event ended the trajectory, if so."""
        met: list[tuple[int, float, Floats]] = []
        for t in np.linspace(self.time, until, 9)[1:]:  # Steps are short, and a pair of crossings in an eighth shorter
            now = self.functions(t, interpolant(t)[:width])
            for i in np.flatnonzero(now * np.sign(self.last) < 0):
                if self.functions.events[i].sign * now[i] >= 0:
                    met.append((int(i), *self._crossing(interpolant, int(i), float(t), width)))
            self.last, self.time = np.where(now == 0, self.last, now), float(t)
        stops = [t for i, t, _ in met if self.functions.events[i].terminal]
        end = min(stops, default=None)
        self.found += [crossing for crossing in met if end is None or crossing[1] <= end]
        return end

    def _crossing(self, interpolant: DenseOutput, i: int, until: float, width: int) -> tuple[float, Floats]:
        before, sign = self.time, np.sign(self.last[i])

        def value(t: float) -> float:
            difference = float(self.functions(t, interpolant(t)[:width])[i])
            # On the level itself, or off it by rounding, the side that it came from counts.
            return sign * np.finfo(float).tiny if t == before and difference * sign <= 0 else difference

        t = float(brentq(value, before, until, xtol=4e-16 * max(abs(until), until - before), rtol=1e-15))
        return t, interpolant(t)[:width].copy()


def solve(
    rhs: RightHandSide,
    start: Floats,
    times: Floats,
    tolerance: float,
    where: str,
    search: _EventSearch | None = None,
    dense: bool = False,
    stops: Floats | None = None,
    limit: float | None = None,
) -> Trajectory:
    """Integrate from `start`, checked before, shape (d,), and return what `integrate` describes.

    The absolute tolerance is a thousandth of the relative one times the size of the states. No step goes past one of
    the `stops`, the last of which is the last time. A state that is larger than the limit ran away.
    """
    states, width = np.full((len(times), len(start)), np.nan), len(start)
    states[0] = start
    track = _Track(start, [float(times[0])]) if dense else None
    if len(times) == 1:
        return Trajectory(times, states, dense=track)
    with np.errstate(all="ignore"):
        if not np.all(np.isfinite(rhs.derivatives(times[0], start))):
            ended = float(times[0])
            return Trajectory(times, states, diverged(ended, "the law is not finite there", where), ended, dense=track)
        size = state_scale(start, rhs.derivatives, times)
        # Not solve_ivp: it counts a start on the level of an event as a crossing, misses two crossings in one step,
        # takes steps without end before a blow-up, and calls it a success where states have become infinite.
        stops = times[-1:] if stops is None else stops
        scale = _TOLERANCES * _size_reached(rhs, start, times[0], min(times[1], stops[0]), tolerance, size)
        steps = _steps(rhs, start, times[0], stops, tolerance, tolerance * scale)
        reached, stop, how, why = 1, None, "ends", f"{step_limit(stops)} steps were not enough"
        least, mark = _NOWHERE * (times[-1] - times[0]), -np.inf
        for count, solver in enumerate(islice(steps, step_limit(stops))):
            if count % _MANY == 0:
                if solver.t - mark < least:
                    why = f"{_MANY} steps lead nowhere"
                    break
                mark = solver.t
            before = solver.t
            with quiet(UserWarning):
                bad = solver.step() or _runaway(solver.y, FAR * size if limit is None else limit)
            if bad:
                how, why = "ran away", bad
                break
            if search or dense or solver.t >= times[reached]:
                interpolant = solver.dense_output()
                stop = search.look(interpolant, solver.t, width) if search else None
                until = int(np.searchsorted(times, solver.t if stop is None else stop, side="right"))
                if until > reached:
                    states[reached:until] = interpolant(times[reached:until]).T
                    reached = until
                if track is not None and solver.t > before:
                    track.interpolants.append(interpolant)
                    track.knots.append(float(solver.t))
            if stop is not None:
                return Trajectory(times, states, None, stop, dense=track)
            if solver.t >= times[-1]:
                return Trajectory(times, states, dense=track)
    ended = float(solver.t)
    return Trajectory(times, states, diverged(ended, why, where, how), ended, dense=track)


def _size_reached(rhs: RightHandSide, start: Floats, time: float, until: float, tolerance: float, size: float) -> float:
    """Return the size of the states until the first sample, at most that which their first rates let expect."""
    reached = np.max(np.abs(start))
    while size * _TOLERANCES > reached:
        steps = _steps(rhs, start, time, np.array([until]), tolerance, _TOLERANCES * tolerance * size)
        for solver in islice(steps, _MANY):
            with quiet(UserWarning):
                solver.step()
            reached = np.fmax(reached, np.max(np.abs(solver.y)))
        if not 0 < reached < size * _TOLERANCES:
            return size
        size, reached = reached, np.max(np.abs(start))
    return size


def _steps(rhs: RightHandSide, states: Floats, time: float, stops: Floats, rtol: float, atol: float) -> Iterator[LSODA]:
    """Yield the solver before each of its steps, a new one after each stop."""
    for stop in stops:
        # At the stop itself what follows it would hold
        piece = rhs.until(np.nextafter(stop, time)) if len(stops) > 1 else rhs
        solver = LSODA(piece.derivatives, time, states, stop, jac=piece.jacobian, rtol=rtol, atol=atol)
        while solver.status == "running":
            yield solver
        time, states = solver.t, solver.y


@dataclass
class _Track:
    """The steps of a trajectory, each with its interpolation; called with times, it gives the states."""

    start: Floats
    knots: list[float]
    interpolants: list[DenseOutput] = field(default_factory=list)

    def __call__(self, times: Floats) -> Floats:
        """Return the states, shape (m, d); after the last step those at its end."""
        if not self.interpolants:
            return np.tile(self.start, (len(times), 1))
        whole = OdeSolution(self.knots, self.interpolants)
        return np.asarray(whole(np.minimum(times, self.knots[-1])).T)


def _runaway(states: Floats, limit: float) -> str | None:
    largest = np.abs(states).max()
    if largest <= limit:
        return None
    return f"a state reached {largest:.3g}" if np.isfinite(largest) else "a state is not finite"
