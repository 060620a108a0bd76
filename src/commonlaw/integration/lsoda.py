"""Integration by LSODA (Petzold 1983) of SciPy, for stiff and nonstiff problems, and any function of the states.

Sensitivities S solve the variational equations ``S' = J S + df/dp`` together with the states.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count as counter, islice

import numpy as np
from scipy.integrate import LSODA, DenseOutput, OdeSolution
from scipy.optimize import brentq

from commonlaw.array_types import Floats
from commonlaw.integration.problem import (
    ABSOLUTE_TOLERANCE,
    MAX_RELATIVE_STATE,
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
from commonlaw.integration.vector_field import VectorField
from commonlaw.runtime.packages import quiet

_STALLED_STEPS = 5000
"""Number of steps that must cover at least a millionth of the time span; else the integration ends."""
_RESTART_STEPS = 100
"""Number of steps that must cover a millionth of the span; else LSODA starts again, as it never forgets the largest
slope: that of ``-sqrt(max(x, 0))`` grows without limit, and is zero where x is."""
_MAX_RESTARTS = 5
"""How often in a row; else the integration ends."""


@dataclass(frozen=True)
class LsodaIntegrator(AbstractIntegrator):
    """LSODA, for every law."""

    options: OutputOptions

    def integrate(self, problem: InitialValueProblem) -> Trajectory:
        options, vector_field, start, search = self.options, problem.field, problem.initial, None
        if options.events:
            functions = EventFunctions(options.events, vector_field)
            first = functions.at_start(problem.start, start, float(np.ptp(problem.times)))
            search = _EventSearch(functions, problem.start, first)
        rhs, width = RightHandSide(vector_field, vector_field.jacobian), len(start)
        # Sensitivities are multiplied with these, so that they have the size of the states
        size = np.max(np.abs(start)) or 1.0
        scale = np.append(np.abs(vector_field.parameters), np.full(width, size))
        scale[scale == 0] = size
        if options.sensitivities:
            rhs = _with_sensitivities(vector_field, scale)
            start = np.concatenate([start, np.eye(width, len(scale), len(scale) - width).T.ravel() * size])
        arguments = rhs, start, problem.times, options.tolerance, problem.where, width
        result = solve(*arguments, search, options.dense, problem.stops, options.limit)
        result = replace(result, events=occurrences(options.events, search.crossings if search else [], width))
        if not options.sensitivities:
            return result
        slopes = result.states[:, width:].reshape(-1, len(scale), width).swapaxes(1, 2) / scale
        return replace(result, states=result.states[:, :width], sensitivities=slopes)


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


def _with_sensitivities(field: VectorField, scale: Floats) -> RightHandSide:
    """Return the right-hand side of the states followed by their derivatives by each parameter and initial state.

    Derivatives are multiplied with their `scale`. The Jacobian leaves out how J changes with the states.
    """
    copies, size = len(scale) + 1, len(field.parameters)

    def derivatives(t: float, y: Floats) -> Floats:
        columns = y.reshape(copies, -1).T
        rates, by_states, by_parameters = (array[0] for array in field.linearize(field.point(t, columns[:, 0])))
        slopes = by_states @ columns[:, 1:]
        slopes[:, :size] += by_parameters * scale[:size]
        return np.column_stack([rates, slopes]).T.ravel()

    def jacobian(t: float, y: Floats) -> Floats:
        return np.asarray(np.kron(np.eye(copies), field.jacobian(t, y[: len(y) // copies])))

    return RightHandSide(derivatives, jacobian)


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
        end = min((t for i, t, _ in met if self.functions.events[i].terminal), default=None)
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
    width: int,
    search: _EventSearch | None = None,
    dense: bool = False,
    stops: Floats | None = None,
    limit: float | None = None,
) -> Trajectory:
    """Return the trajectory from a valid `start`, shape (d,), see `integrate`.

    Its first `width` numbers are states, which events and divergences are of. The absolute tolerance is 1/1000 of the
    relative one times the scale of the states. No step passes one of the `stops`, the last of which is the last time. A
    state above the limit diverges.
    """
    states = np.full((len(times), len(start)), np.nan)
    states[0] = start
    dense_output = _DenseOutput(start[:width], [float(times[0])]) if dense else None
    if len(times) == 1:
        return Trajectory(times, states, dense=dense_output)
    with np.errstate(all="ignore"), quiet(UserWarning):
        if not np.all(np.isfinite(rhs.derivatives(times[0], start))):
            ended = float(times[0])
            outcome = diverged(ended, "the law is not finite there", where)
            return Trajectory(times, states, outcome, ended, dense=dense_output)
        size = state_scale(start[:width], lambda t, _: rhs.derivatives(t, start)[:width], times)
        # Not solve_ivp: it counts an initial state on the level of an event as a crossing, misses two crossings in one
        # step, has no limit of steps before a blow-up, and returns infinite states as a success
        stops = times[-1:] if stops is None else stops
        first, largest = min(times[1], stops[0]), MAX_RELATIVE_STATE * size if limit is None else limit
        scale = ABSOLUTE_TOLERANCE * _size_reached(rhs, start, times[0], first, tolerance, size, width)
        steps = _steps(rhs, start, times[0], stops, tolerance, tolerance * scale)
        reached, stop, how, why = 1, None, "ends", "the steps lead nowhere"
        least, mark = 1e-6 * (times[-1] - times[0]), -np.inf
        for count, solver in enumerate(steps):
            if count == step_limit(stops):
                why = f"{count} steps were not enough"
                break
            if count % _STALLED_STEPS == 0:
                if solver.t - mark < least:
                    break
                mark = solver.t
            before = solver.t
            if bad := solver.step() or _divergence(solver.y[:width], largest):
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


def _size_reached(
    rhs: RightHandSide, start: Floats, time: float, until: float, tolerance: float, size: float, width: int
) -> float:
    """Return the scale of the states up to the first sample, at most that from their initial rates."""
    reached = np.max(np.abs(start[:width]))
    while size * ABSOLUTE_TOLERANCE > reached:
        steps = _steps(rhs, start, time, np.array([until]), tolerance, ABSOLUTE_TOLERANCE * tolerance * size)
        for solver in islice(steps, _STALLED_STEPS):
            solver.step()
            reached = np.fmax(reached, np.max(np.abs(solver.y[:width])))
        if not 0 < reached < size * ABSOLUTE_TOLERANCE:
            return size
        size, reached = reached, np.max(np.abs(start[:width]))
    return size


def _steps(rhs: RightHandSide, states: Floats, time: float, stops: Floats, rtol: float, atol: float) -> Iterator[LSODA]:
    """Yield the solver before each step, a new one after each stop."""
    least = 1e-6 * (stops[-1] - time)
    for stop in stops:
        # At the stop itself, inputs are those after it
        piece = rhs.until(np.nextafter(stop, time)) if len(stops) > 1 else rhs
        begin = partial(LSODA, piece.derivatives, t_bound=stop, jac=piece.jacobian, rtol=rtol, atol=atol)
        solver, mark, restarts = begin(time, states), -np.inf, 0
        for count in counter(1):
            if solver.status != "running":
                break
            yield solver
            if count % _RESTART_STEPS == 0:
                restarts = restarts + 1 if solver.t - mark < least and solver.status == "running" else 0
                if restarts > _MAX_RESTARTS or not np.isfinite(solver.y).all():
                    return
                if restarts:
                    solver = begin(solver.t, solver.y)
                mark = solver.t
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
        return np.asarray(whole(np.minimum(times, self.knots[-1])).T[:, : len(self.start)])


def _divergence(states: Floats, limit: float) -> str | None:
    largest = np.abs(states).max()
    if largest <= limit:
        return None
    return f"a state reached {largest:.3g}" if np.isfinite(largest) else "a state is not finite"
