"""Integration by LSODA (Petzold 1983) of SciPy, for stiff and nonstiff problems, and any function of the states.

Sensitivities S solve the linear variational equations ``S' = J S + df/dp`` along a trajectory, by Radau IIA of order 5
(Hairer and Wanner 1996, Solving Ordinary Differential Equations II, table IV.5.6), which is stable for stiff laws, for
all steps at once; steps are halved until the two halves agree with the whole.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import NamedTuple

import numpy as np
from scipy.integrate import LSODA, DenseOutput, OdeSolution
from scipy.optimize import brentq

from commonlaw.array_types import Floats
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
    """Affine maps ``S -> by_states S + added`` of sensitivities over steps from `starts` to `ends`, shape (m,).

    `by_states` has shape (m, D, D), `added` (m, D, p). They are composed of two halves; `off_by_states` and `off_added`
    are the differences to one step, the error estimate.
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
    # Relative to the sizes of states and parameters
    sizes = np.abs(problem.field.parameters) / (np.max(np.abs(problem.initial)) or 1.0)
    scale = np.concatenate([np.where(sizes == 0, 1.0, sizes), np.ones(width)])
    steps = _halved(problem, path, edges[:-1], edges[1:])
    for round_ in range(_ROUNDS + 1):
        path_slopes = _along(steps, slopes[0])
        with np.errstate(all="ignore"):  # Steps with an error above the tolerance
            residuals = steps.off_by_states @ path_slopes[:-1]
            residuals[:, :, :size] += steps.off_added
            error, after = (np.abs(array).max(axis=1) * scale for array in (residuals, path_slopes[1:]))
            coarse = (error > tolerance * np.maximum(1.0, after)).any(axis=1)
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
    """Return the first sensitivities, shape (D, p + D), and those after each of m steps, shape (m + 1, D, p + D)."""
    slopes, size = np.empty((len(steps.starts) + 1, *first.shape)), steps.added.shape[2]
    slopes[0] = first
    with np.errstate(all="ignore"):
        for k, (by_states, added) in enumerate(zip(steps.by_states, steps.added, strict=True), 1):
            np.matmul(by_states, slopes[k - 1], out=slopes[k])
            slopes[k, :, :size] += added
    return slopes


def _halved(problem: InitialValueProblem, path: Callable[[Floats], Floats], starts: Floats, ends: Floats) -> _Steps:
    """Return steps between times, each composed of two halves."""
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
    """Return the affine maps of single Radau steps, without knots of inputs in between."""
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


_STALLED_STEPS, _STALLED_SHARE = 5000, 1e-6
"""Number of steps that must cover at least this share of the time span; else the integration ends."""
_ABSOLUTE = 1e-3
"""Absolute tolerance over the relative one, in scales of the states."""


@dataclass(frozen=True)
class LsodaIntegrator(AbstractIntegrator):
    """LSODA, for every law."""

    options: OutputOptions

    def integrate(self, problem: InitialValueProblem) -> Trajectory:
        """Return the trajectory of a problem; sensitivities solve the variational equations along it."""
        options, vector_field, search = self.options, problem.field, None
        if options.events:
            functions = EventFunctions(options.events, vector_field)
            first = functions.at_start(problem.start, problem.initial, float(np.ptp(problem.times)))
            search = _EventSearch(functions, problem.start, first)
        rhs, dense = RightHandSide(vector_field, vector_field.jacobian), options.dense or options.sensitivities
        arguments = problem.initial, problem.times, options.tolerance, problem.where, search, dense, problem.stops
        result = solve(rhs, *arguments, options.limit)
        crossings = search.crossings if search else []
        result = replace(result, events=occurrences(options.events, crossings, len(problem.initial)))
        if not options.sensitivities:
            return result
        assert isinstance(result.dense, _DenseOutput)
        # Sensitivity steps of four steps of the states
        knots, reached = np.array(result.dense.knots[::4]), int(np.isfinite(result.states[:, 0]).sum())
        derivatives = sensitivities(problem, result.dense, knots, reached, options.tolerance)
        return replace(result, sensitivities=derivatives, dense=result.dense if options.dense else None)


@dataclass(frozen=True)
class RightHandSide:
    """Derivatives, and their Jacobian or None."""

    derivatives: Function
    jacobian: Function | None

    def until(self, last: float) -> "RightHandSide":
        """Return the right-hand side with time limited to `last`."""
        derivatives, jacobian = self.derivatives, self.jacobian
        return RightHandSide(
            lambda t, y: derivatives(min(t, last), y),
            None if jacobian is None else lambda t, y: jacobian(min(t, last), y),
        )


@dataclass
class _EventSearch:
    """Root finding of event functions along the steps."""

    functions: EventFunctions
    time: float
    last: Floats
    crossings: list[tuple[int, float, Floats]] = field(default_factory=list)

    def append_events(self, interpolant: DenseOutput, until: float, width: int) -> float | None:
        """Append the events in a step, given by its dense output; return the time of a terminal one, if any."""
        met: list[tuple[int, float, Floats]] = []
        for t in np.linspace(self.time, until, 9)[1:]:  # Pairs of crossings within an eighth of a step are missed
            now = self.functions(t, interpolant(t)[:width])
            for i in np.flatnonzero(now * np.sign(self.last) < 0):
                if self.functions.events[i].sign * now[i] >= 0:
                    met.append((int(i), *self._crossing(interpolant, int(i), float(t), width)))
            self.last, self.time = np.where(now == 0, self.last, now), float(t)
        stops = [t for i, t, _ in met if self.functions.events[i].terminal]
        end = min(stops, default=None)
        self.crossings += [crossing for crossing in met if end is None or crossing[1] <= end]
        return end

    def _crossing(self, interpolant: DenseOutput, i: int, until: float, width: int) -> tuple[float, Floats]:
        before, sign = self.time, np.sign(self.last[i])

        def value(t: float) -> float:
            difference = float(self.functions(t, interpolant(t)[:width])[i])
            # On the level, up to rounding, the side before counts
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
    """Return the trajectory from a valid `start`, shape (d,), see `integrate`.

    The absolute tolerance is 1/1000 of the relative one times the scale of the states. No step passes one of the
    `stops`, the last of which is the last time. A state above the limit diverges.
    """
    states, width = np.full((len(times), len(start)), np.nan), len(start)
    states[0] = start
    dense_output = _DenseOutput(start, [float(times[0])]) if dense else None
    if len(times) == 1:
        return Trajectory(times, states, dense=dense_output)
    with np.errstate(all="ignore"):
        if not np.all(np.isfinite(rhs.derivatives(times[0], start))):
            ended = float(times[0])
            return Trajectory(
                times, states, diverged(ended, "the law is not finite there", where), ended, dense=dense_output
            )
        size = state_scale(start, rhs.derivatives, times)
        # Not solve_ivp: it counts an initial state on the level of an event as a crossing, misses two crossings in one
        # step, has no limit of steps before a blow-up, and returns infinite states as a success
        stops = times[-1:] if stops is None else stops
        scale = _ABSOLUTE * _size_reached(rhs, start, times[0], min(times[1], stops[0]), tolerance, size)
        steps = _steps(rhs, start, times[0], stops, tolerance, tolerance * scale)
        reached, stop, how, why = 1, None, "ends", f"{step_limit(stops)} steps were not enough"
        least, mark = _STALLED_SHARE * (times[-1] - times[0]), -np.inf
        for count, solver in enumerate(islice(steps, step_limit(stops))):
            if count % _STALLED_STEPS == 0:
                if solver.t - mark < least:
                    why = f"{_STALLED_STEPS} steps lead nowhere"
                    break
                mark = solver.t
            before = solver.t
            with quiet(UserWarning):
                bad = solver.step() or _divergence(solver.y, FAR * size if limit is None else limit)
            if bad:
                how, why = "ran away", bad
                break
            if search or dense or solver.t >= times[reached]:
                interpolant = solver.dense_output()
                stop = search.append_events(interpolant, solver.t, width) if search else None
                until = int(np.searchsorted(times, solver.t if stop is None else stop, side="right"))
                if until > reached:
                    states[reached:until] = interpolant(times[reached:until]).T
                    reached = until
                if dense_output is not None and solver.t > before:
                    dense_output.interpolants.append(interpolant)
                    dense_output.knots.append(float(solver.t))
            if stop is not None:
                return Trajectory(times, states, None, stop, dense=dense_output)
            if solver.t >= times[-1]:
                return Trajectory(times, states, dense=dense_output)
    ended = float(solver.t)
    return Trajectory(times, states, diverged(ended, why, where, how), ended, dense=dense_output)


def _size_reached(rhs: RightHandSide, start: Floats, time: float, until: float, tolerance: float, size: float) -> float:
    """Return the scale of the states up to the first sample, at most that from their initial rates."""
    reached = np.max(np.abs(start))
    while size * _ABSOLUTE > reached:
        steps = _steps(rhs, start, time, np.array([until]), tolerance, _ABSOLUTE * tolerance * size)
        for solver in islice(steps, _STALLED_STEPS):
            with quiet(UserWarning):
                solver.step()
            reached = np.fmax(reached, np.max(np.abs(solver.y)))
        if not 0 < reached < size * _ABSOLUTE:
            return size
        size, reached = reached, np.max(np.abs(start))
    return size


def _steps(rhs: RightHandSide, states: Floats, time: float, stops: Floats, rtol: float, atol: float) -> Iterator[LSODA]:
    """Yield the solver before each step, a new one after each stop."""
    for stop in stops:
        # At the stop itself, inputs are those after it
        piece = rhs.until(np.nextafter(stop, time)) if len(stops) > 1 else rhs
        solver = LSODA(piece.derivatives, time, states, stop, jac=piece.jacobian, rtol=rtol, atol=atol)
        while solver.status == "running":
            yield solver
        time, states = solver.t, solver.y


@dataclass
class _DenseOutput:
    """Dense output: the interpolants of all steps."""

    start: Floats
    knots: list[float]
    interpolants: list[DenseOutput] = field(default_factory=list)

    def __call__(self, times: Floats) -> Floats:
        """Return the states at times, shape (m, d), constant after the last step."""
        if not self.interpolants:
            return np.tile(self.start, (len(times), 1))
        whole = OdeSolution(self.knots, self.interpolants)
        return np.asarray(whole(np.minimum(times, self.knots[-1])).T)


def _divergence(states: Floats, limit: float) -> str | None:
    largest = np.abs(states).max()
    if largest <= limit:
        return None
    return f"a state reached {largest:.3g}" if np.isfinite(largest) else "a state is not finite"
