"""Integration by SciPy: LSODA (Petzold 1983), for stiff problems and others, and for any function of the states."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np
from scipy.integrate import LSODA, DenseOutput, OdeSolution
from scipy.optimize import brentq

from commonlaw.array_types import Floats
from commonlaw.integration.base import FAR, MAX_STEPS, AbstractIntegrator, Function, state_scale
from commonlaw.integration.event import EventFunctions, occurrences
from commonlaw.integration.initial_value_problem import InitialValueProblem, OutputOptions
from commonlaw.integration.trajectory import Trajectory, diverged
from commonlaw.integration.vector_field import VectorField

_LOOKS = 8
"""How often events are looked for in a step; steps are short, and a pair of crossings between two looks is shorter."""


@dataclass(frozen=True)
class LsodaIntegrator(AbstractIntegrator):
    """The back end that is always there, and takes every law."""

    options: OutputOptions

    def integrate(self, problem: InitialValueProblem) -> Trajectory:
        """Return the trajectory of a problem; sensitivities solve the variational equations beside it."""
        options, vector_field, width = self.options, problem.field, len(problem.initial)
        rhs, start, scales = (
            RightHandSide(vector_field, vector_field.jacobian, width),
            problem.initial,
            np.empty((width, 0)),
        )
        search, sensitivities = None, None
        if options.events:
            functions = EventFunctions(options.events, vector_field)
            first = functions.at_start(problem.start, problem.initial, float(np.ptp(problem.times)))
            search = _EventSearch(functions, problem.start, first)
        if options.sensitivities:
            rhs, scales = _variational(vector_field, width), _sensitivity_scales(problem)
            start = np.concatenate([start, np.eye(*scales.shape, scales.shape[1] - width).ravel()])
        times, where = problem.times, problem.where
        result = solve(
            rhs, start, times, options.tolerance, where, scales.ravel(), search, options.dense, problem.stops
        )
        found = occurrences(options.events, search.found if search else [], width)
        if options.sensitivities:
            sensitivities = result.states[:, width:].reshape(len(times), *scales.shape)
        return replace(result, states=result.states[:, :width], events=found, sensitivities=sensitivities)


@dataclass(frozen=True)
class RightHandSide:
    """What LSODA integrates: derivatives, their Jacobian or nothing, and how many of the first numbers are states."""

    derivatives: Function
    jacobian: Function | None
    width: int

    def until(self, last: float) -> "RightHandSide":
        """Return the same with whatever depends on time as it is at the `last` one from there on."""
        derivatives, jacobian = self.derivatives, self.jacobian
        return RightHandSide(
            lambda t, y: derivatives(min(t, last), y),
            None if jacobian is None else lambda t, y: jacobian(min(t, last), y),
            self.width,
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
        for t in np.linspace(self.time, until, _LOOKS + 1)[1:]:
            now = self.functions(t, interpolant(t)[:width])
            for i in np.flatnonzero(now * np.sign(self.last) < 0):
                if self.functions.events[i].sign * now[i] >= 0:
                    met.append((int(i), *self._crossing(interpolant, int(i), float(t), width)))
            self.last, self.time = np.where(now == 0, self.last, now), float(t)
        stops = [t for i, t, _ in met if self.functions.events[i].terminal]
        end = min(stops, default=None)
        self.found += [each for each in met if end is None or each[1] <= end]
        return end

    def _crossing(self, interpolant: DenseOutput, i: int, until: float, width: int) -> tuple[float, Floats]:
        before, sign = self.time, np.sign(self.last[i])

        def value(t: float) -> float:
            found = float(self.functions(t, interpolant(t)[:width])[i])
            # On the level itself, or off it by rounding, the side that it came from counts.
            return sign * np.finfo(float).tiny if t == before and found * sign <= 0 else found

        t = float(brentq(value, before, until, xtol=4e-16 * max(abs(until), until - before), rtol=1e-15))
        return t, interpolant(t)[:width].copy()


def solve(
    rhs: RightHandSide,
    start: Floats,
    times: Floats,
    tolerance: float,
    where: str,
    other_scales: Floats | tuple[()] = (),
    search: _EventSearch | None = None,
    dense: bool = False,
    stops: Floats | None = None,
) -> Trajectory:
    """Integrate from `start`, checked before, shape (d,), and return what `integrate` describes.

    The absolute tolerance is a thousandth of the relative one times the size of the states, which come first, and times
    a scale of each other number. No step goes past one of the `stops`, the last of which is the last time.
    """
    states, width = np.full((len(times), len(start)), np.nan), rhs.width
    states[0] = start
    track = _Track(start[:width], [float(times[0])]) if dense else None
    if len(times) == 1:
        return Trajectory(times, states, dense=track)
    with np.errstate(all="ignore"):
        if not np.all(np.isfinite(rhs.derivatives(times[0], start))):
            ended = float(times[0])
            return Trajectory(times, states, diverged(ended, "the law is not finite there", where), ended, dense=track)
        others = start[width:]
        size = state_scale(start[:width], lambda t, y: rhs.derivatives(t, np.concatenate([y, others]))[:width], times)
        absolute = 1e-3 * tolerance * np.concatenate([np.full(width, size), other_scales])
        # Not solve_ivp: it counts a start on the level of an event as a crossing, misses two crossings in one step,
        # takes steps without end before a blow-up, and calls it a success where states have become infinite.
        steps = _steps(rhs, start, times[0], times[-1:] if stops is None else stops, tolerance, absolute)
        reached, stop, why = 1, None, f"{MAX_STEPS} steps were not enough"
        for solver in islice(steps, MAX_STEPS):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)
                bad = solver.step() or _runaway(solver.y[:width], size)
            if bad:
                why = bad
                break
            if search or dense or solver.t >= times[reached]:
                interpolant = solver.dense_output()
                stop = search.look(interpolant, solver.t, width) if search else None
                until = int(np.searchsorted(times, solver.t if stop is None else stop, side="right"))
                if until > reached:
                    states[reached:until] = interpolant(times[reached:until]).T
                    reached = until
                if track is not None:
                    track.interpolants.append(interpolant)
                    track.knots.append(float(solver.t))
            if stop is not None:
                return Trajectory(times, states, None, stop, dense=track)
            if solver.t >= times[-1]:
                return Trajectory(times, states, dense=track)
    ended = float(solver.t)
    return Trajectory(times, states, diverged(ended, why, where), ended, dense=track)


def _steps(
    rhs: RightHandSide, states: Floats, time: float, stops: Floats, relative: float, absolute: Floats
) -> Iterator[LSODA]:
    """Yield the solver before each of its steps, a new one after each stop."""
    for stop in stops:
        # At the stop itself what follows it would hold
        own = rhs.until(np.nextafter(stop, time)) if len(stops) > 1 else rhs
        solver = LSODA(own.derivatives, time, states, stop, rtol=relative, atol=absolute, jac=own.jacobian)
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
        return np.asarray(whole(np.minimum(times, self.knots[-1])).T[:, : len(self.start)])


def _variational(vector_field: VectorField, width: int) -> RightHandSide:
    """Return the states together with their derivatives by parameters and initial states, row by row."""

    def derivatives(t: float, y: Floats) -> Floats:
        states, matrix = y[:width], y[width:].reshape(width, -1)
        (change,), (by_states,), (by_parameters,) = vector_field.linearize(vector_field.point(t, states))
        carried = by_states @ matrix
        carried[:, : by_parameters.shape[1]] += by_parameters
        return np.concatenate([change, carried.ravel()])

    def jacobian(t: float, y: Floats) -> Floats:
        # How the sensitivities feel the states is left out: it steers Newton's iteration only, not the result.
        own = vector_field.jacobian(t, y[:width])
        result = np.zeros((len(y), len(y)))
        result[:width, :width] = own
        result[width:, width:] = np.kron(own, np.eye(len(y) // width - 1))
        return result

    return RightHandSide(derivatives, jacobian, width)


def _sensitivity_scales(problem: InitialValueProblem) -> Floats:
    """Return the size of each sensitivity, in its own unit, shape (states, parameters + states)."""
    parameters, width = problem.field.parameters, len(problem.initial)
    size = np.max(np.abs(problem.initial)) or 1.0
    row = np.concatenate([size / np.where(parameters == 0, 1.0, np.abs(parameters)), np.ones(width)])
    return np.tile(row, (width, 1))


def _runaway(states: Floats, size: float) -> str | None:
    if not np.all(np.isfinite(states)):
        return "a state is not finite"
    if np.max(np.abs(states)) > FAR * size:
        return f"a state reached {np.max(np.abs(states)):.3g}"
    return None
