"""Integration by SciPy: LSODA (Petzold 1983), for stiff problems and others, and for any function of the states."""

import warnings
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.integrate import LSODA, DenseOutput, OdeSolution
from scipy.optimize import brentq

from commonlaw.array_types import Floats
from commonlaw.integration.base import FAR, MAX_STEPS, AbstractIntegrator, Function, state_scale
from commonlaw.integration.event import EventFunctions, event_terms, occurrences
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
        search = _event_search(problem, options) if options.events else None
        rhs = RightHandSide(vector_field, vector_field.jacobian, width)
        start, absolute = problem.initial, np.zeros(width)
        if options.sensitivities:
            rhs = _variational(vector_field, width)
            start, absolute = _variational_start(problem, options.tolerance)
        times, tolerance = problem.times, options.tolerance
        result = solve(rhs, start, times, tolerance, absolute, problem.where, search=search, dense=options.dense)
        found = occurrences(options.events, [] if search is None else search.found, width)
        sensitivities = None
        if options.sensitivities:
            sensitivities = result.states[:, width:].reshape(len(times), width, -1)
        return replace(result, states=result.states[:, :width], events=found, sensitivities=sensitivities)


@dataclass(frozen=True)
class RightHandSide:
    """What LSODA integrates: derivatives, their Jacobian or nothing, and how many of the first numbers are states."""

    derivatives: Function
    jacobian: Function | None
    width: int


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
    absolute: Floats,
    where: str,
    *,
    search: _EventSearch | None = None,
    dense: bool = False,
) -> Trajectory:
    """Integrate from `start`, checked before, shape (d,), and return what `integrate` describes.

    Parameters
    ----------
    rhs
        What is integrated.
    start, times
        Shapes (d,) and (n,).
    tolerance, absolute
        The relative tolerance, and the absolute one of each number, shape (d,); for the states, which come first, it
        is set here.
    where
        For the outcome.
    search
        Looks for events.
    dense
        Whether to keep every step.
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
        absolute[:width] = 1e-3 * tolerance * size
        # Not solve_ivp: it counts a start on the level of an event as a crossing, misses two crossings in one step,
        # takes steps without end before a blow-up, and calls it a success where states have become infinite.
        span = times[0], start, times[-1]
        solver = LSODA(rhs.derivatives, *span, rtol=tolerance, atol=absolute, jac=rhs.jacobian)
        reached, stop, why = 1, None, f"{MAX_STEPS} steps were not enough"
        for _ in range(MAX_STEPS):
            bad = _step(solver) or _runaway(solver.y[:width], size)
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
                    track.add(interpolant, float(solver.t))
            if stop is not None:
                return Trajectory(times, states, None, stop, dense=track)
            if solver.status == "finished":
                return Trajectory(times, states, dense=track)
    ended = float(solver.t)
    return Trajectory(times, states, diverged(ended, why, where), ended, dense=track)


@dataclass
class _Track:
    """The steps of a trajectory, each with its interpolation; called with times, it gives the states."""

    start: Floats
    knots: list[float]
    interpolants: list[DenseOutput] = field(default_factory=list)

    def add(self, interpolant: DenseOutput, until: float) -> None:
        """Keep a step."""
        self.interpolants.append(interpolant)
        self.knots.append(until)

    def __call__(self, times: Floats) -> Floats:
        """Return the states, shape (m, d); after the last step those at its end."""
        if not self.interpolants:
            return np.tile(self.start, (len(times), 1))
        whole = OdeSolution(self.knots, self.interpolants)
        return np.asarray(whole(np.minimum(times, self.knots[-1])).T[:, : len(self.start)])


def _event_search(problem: InitialValueProblem, options: OutputOptions) -> _EventSearch:
    functions = EventFunctions(
        options.events, problem.field, event_terms(options.events, problem.field.terms.variables)
    )
    span = float(problem.times[-1] - problem.times[0])
    return _EventSearch(functions, problem.start, functions.at_start(problem.start, problem.initial, span))


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


def _variational_start(problem: InitialValueProblem, tolerance: float) -> tuple[Floats, Floats]:
    """Return the initial states and sensitivities, and absolute tolerances in the units of each sensitivity."""
    parameters, width = problem.field.parameters, len(problem.initial)
    matrix = np.hstack([np.zeros((width, len(parameters))), np.eye(width)])
    size = np.max(np.abs(problem.initial)) or 1.0
    scale = np.where(parameters == 0, 1.0, np.abs(parameters))
    rows = np.tile(np.concatenate([size / scale, np.ones(width)]), (width, 1))
    absolute = 1e-3 * tolerance * rows.ravel()
    return np.concatenate([problem.initial, matrix.ravel()]), np.concatenate([np.zeros(width), absolute])


def _step(solver: LSODA) -> str | None:
    """Take one step; return why it failed, or None."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return solver.step()


def _runaway(states: Floats, size: float) -> str | None:
    if not np.all(np.isfinite(states)):
        return "a state is not finite"
    if np.max(np.abs(states)) > FAR * size:
        return f"a state reached {np.max(np.abs(states)):.3g}"
    return None
