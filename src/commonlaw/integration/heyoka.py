"""Integration by adaptive Taylor series, compiled by the library heyoka (Biscani and Izzo 2021)."""

import math
import operator
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, NoReturn

import heyoka
import numpy as np

from commonlaw.array_types import Floats
from commonlaw.diagnostics import Outcome, note
from commonlaw.integration.problem import (
    MAX_RELATIVE_STATE,
    AbstractIntegrator,
    EventFunctions,
    InitialValueProblem,
    OutputOptions,
    Trajectory,
    diverged,
    largest_state,
    occurrences,
    step_limit,
)
from commonlaw.integration.vector_field import VectorField
from commonlaw.library import Term
from commonlaw.library.grammar import SHORT_NAMES, Algebra, evaluate

_FUNCTIONS = ("sqrt", "exp", "log", "sin", "cos", "tan", "sinh", "cosh", "tanh", "erf", "erfc")
"""Functions that are analytic in their domain, besides inverse functions and other logarithms."""


class UnsupportedError(Exception):
    """A law or an event that is not analytic; the text is the reason."""


def translated(term: Term, variables: Sequence[Any]) -> Any:
    """Return a term as an expression of heyoka in these variables.

    Raises `UnsupportedError` if it contains a function without Taylor series.
    """
    return evaluate(term.code, variables, _ALGEBRA)


def _power(base: Any, exponent: Any) -> Any:
    """Return a power; an integer one as a product, since the power function of heyoka divides by the base."""
    try:  # Without variables an expression is written as a number
        number = float(str(exponent))
    except ValueError:
        return base**exponent
    if not number.is_integer():
        return base**number
    result = math.prod([base] * abs(int(number)), start=heyoka.expression(1.0))
    return result if number >= 0 else 1.0 / result


def _refused(name: str, _: Any) -> NoReturn:
    raise UnsupportedError(f"{name} has no Taylor series where it jumps or bends")


_OPERATIONS: Mapping[str, Callable[..., Any]] = {
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "divide": operator.truediv,
    "power": _power,
    "negate": operator.neg,
    "log2": lambda x: heyoka.log(x) / math.log(2),
    "log10": lambda x: heyoka.log(x) / math.log(10),
    **{name: getattr(heyoka, short) for short, name in SHORT_NAMES.items()},
    **{name: getattr(heyoka, name) for name in _FUNCTIONS},
    **{name: partial(_refused, name) for name in ("abs", "sign", "step", "floor", "ceil")},
}
_ALGEBRA = Algebra(lambda number: heyoka.expression(float(number)), _OPERATIONS)


# No warning if the home directory, and so the disk cache of heyoka, is not writable
heyoka.set_logger_level_error()

Occurred = list[tuple[int, float, Floats]]


@dataclass(frozen=True)
class Structure:
    """The compiled part of a problem, the same for all objects of a law.

    It has the terms of the equations; the pair of equation and term of each coefficient; which coefficients have
    sensitivities (`free`), and which are nonlinear parameters (`inside`, None for one that is zero); the number of
    equations, the indices of those of second order, and of log-scaled states; the number of inputs, and of the
    coefficients of their polynomials (`powers`); expression, direction and terminality of events.
    """

    terms: tuple[Term, ...]
    pairs: tuple[tuple[int, int], ...]
    free: tuple[int, ...]
    inside: tuple[int | None, ...]
    equations: int
    second: tuple[int, ...]
    inputs: int
    logarithmic: tuple[int, ...]
    powers: int
    events: tuple[tuple[Term, int, bool], ...]
    tolerance: float
    sensitivities: bool

    @property
    def width(self) -> int:
        """Number of states and rates."""
        return self.equations + len(self.second)

    @classmethod
    def of(cls, vector_field: VectorField, options: OutputOptions) -> "Structure":
        used = np.flatnonzero(vector_field.kept.any(axis=0))
        columns = np.argwhere(vector_field.kept)[:, 1].tolist()
        events = EventFunctions(options.events, vector_field).terms.terms
        free = np.flatnonzero(vector_field.parameter_mask[vector_field.kept] & options.sensitivities)
        return cls(
            tuple(vector_field.terms.terms[k] for k in used),
            tuple((int(j), int(k)) for j, k in np.argwhere(vector_field.kept[:, used])),
            tuple(int(i) for i in free),
            tuple(columns.index(k) if k in columns else None for k in vector_field.terms.parameters),
            len(vector_field.coefficients),
            tuple(vector_field.second.tolist()),
            len(vector_field.terms.variables.inputs),
            vector_field.terms.variables.logarithmic_columns,
            0 if vector_field.inputs is None else vector_field.inputs.powers,
            tuple((term, event.sign, event.terminal) for term, event in zip(events, options.events, strict=True)),
            max(options.tolerance, float(np.finfo(float).eps)),
            options.sensitivities,
        )


@dataclass(frozen=True, eq=False)
class Compiled:
    """A compiled integrator of `width` states, with parameters, state and time.

    Its parameters are the `constants` (coefficients, then levels of events), and the polynomials of the inputs.
    `terminal` are the indices of terminal events; others append to `occurred`. Initial sensitivities are flattened,
    empty without.
    """

    stepper: Any
    width: int
    constants: int
    terminal: list[int]
    occurred: Occurred
    initial_sensitivities: Floats

    def start(self, problem: InitialValueProblem, levels: Floats) -> None:
        """Set parameters, state and time to the start of a problem."""
        self.stepper.pars[: self.constants] = np.concatenate([problem.field.coefficients[problem.field.kept], levels])
        self.reset(problem.start, np.concatenate([problem.initial, self.initial_sensitivities]))

    def reset(self, time: float, row: Floats) -> None:
        """Set time and state, and clear events."""
        self.stepper.time = time
        self.stepper.state[:] = row
        self.occurred.clear()
        if self.terminal:
            self.stepper.reset_cooldowns()

    def follow(self, problem: InitialValueProblem) -> float:
        """Set the polynomials of the inputs at the present time; return the time up to which they hold."""
        time, stops, inputs = self.stepper.time, problem.stops, problem.field.inputs
        if inputs is not None:
            piece = inputs.piece(time)
            # heyoka has no parameters after the last one that the law uses
            parameters = self.stepper.pars[self.constants :]
            parameters[:] = np.append(inputs.knots[piece], inputs.coefficients[piece])[: len(parameters)]
        following = stops.searchsorted(time, side="right")
        return float(stops[following]) if following < len(stops) else np.inf


@lru_cache(maxsize=32)
def compiled(structure: Structure, _thread: int) -> Compiled:
    """Return the integrator of a structure, one for each thread, as it has state."""
    states = heyoka.make_vars(*[f"v{i}" for i in range(structure.width)], "unused")[:-1]
    parameters, constants = len(structure.pairs), len(structure.pairs) + len(structure.events)
    natural = [heyoka.exp(state) if j in structure.logarithmic else state for j, state in enumerate(states)]
    inside = [heyoka.expression(0.0) if i is None else heyoka.par[i] for i in structure.inside]
    # Inputs are polynomials, whose knot and coefficients are the parameters after the constants
    since, inputs = heyoka.time - heyoka.par[constants], [heyoka.expression(0.0)] * structure.inputs
    for power in reversed(range(structure.powers)):
        first = constants + 1 + power * structure.inputs
        inputs = [value * since + heyoka.par[first + j] for j, value in enumerate(inputs)]
    variables = [*natural, *inputs, heyoka.time, *inside]
    terms = [translated(term, variables) for term in structure.terms]
    sums: list[list[Any]] = [[] for _ in range(structure.equations)]
    for i, (equation, index) in enumerate(structure.pairs):
        if i not in structure.inside:
            sums[equation].append(heyoka.par[i] * terms[index])
    highest = [heyoka.sum(summands) if summands else heyoka.expression(0.0) for summands in sums]
    highest = [rate / natural[j] if j in structure.logarithmic else rate for j, rate in enumerate(highest)]
    rates = [*highest, *(highest[j] for j in structure.second)]
    for j, rate in zip(structure.second, states[structure.equations :], strict=True):
        rates[j] = rate
    system: Any = list(zip(states, rates, strict=True))
    initial_sensitivities = np.empty(0)
    if structure.sensitivities:
        system = heyoka.var_ode_sys(system, [*(heyoka.par[i] for i in structure.free), *states])
        initial_sensitivities = np.eye(len(states), len(structure.free) + len(states), len(structure.free)).ravel()
    terminal, occurred, events = _events(structure, variables)
    large = structure.sensitivities or parameters > 100  # These in heyoka's compact mode
    settings = {"tol": structure.tolerance, "compact_mode": large, "opt_level": int(large)}
    stepper = heyoka.taylor_adaptive(system, np.zeros(len(states)), **settings, **events)
    return Compiled(stepper, len(states), constants, terminal, occurred, initial_sensitivities)


def _events(structure: Structure, variables: list[Any]) -> tuple[list[int], Occurred, dict[str, list[Any]]]:
    """Return the indices of terminal events, the list to which others append, and the arguments of heyoka."""
    occurred: Occurred = []
    width = structure.width

    def writer(index: int) -> Callable[[Any, float, int], None]:
        def write(stepper: Any, time: float, _: int) -> None:
            stepper.update_d_output(time)
            occurred.append((index, time, stepper.d_output[:width].copy()))

        return write

    passing, terminal, indices = [], [], []
    for i, (term, sign, ends) in enumerate(structure.events):
        crossed = translated(term, variables) - heyoka.par[len(structure.pairs) + i]
        if ends:
            terminal.append(heyoka.t_event(crossed, direction=heyoka.event_direction(sign)))
            indices.append(i)
        else:
            passing.append(heyoka.nt_event(crossed, writer(i), direction=heyoka.event_direction(sign)))
    lists = {"t_events": terminal, "nt_events": passing}
    return indices, occurred, {name: items for name, items in lists.items() if items}


Dense = Callable[[Floats], Floats]

_NOT_FINITE = "a state is not finite"


@dataclass(frozen=True)
class HeyokaIntegrator(AbstractIntegrator):
    """Taylor series, compiled for all vector fields of one structure."""

    options: OutputOptions
    compiled: Compiled

    @classmethod
    def of(cls, vector_field: VectorField, options: OutputOptions) -> "HeyokaIntegrator":
        """Return the integrator for vector fields of this one's terms, order and support, see `translated`."""
        return cls(options, compiled(Structure.of(vector_field, options), threading.get_ident()))

    def integrate(self, problem: InitialValueProblem) -> Trajectory:
        """Return the trajectory of a problem; with the outcome "not integrated" another integrator is needed."""
        width = len(problem.initial)
        with np.errstate(all="ignore"):
            self.compiled.start(problem, self._levels(problem))
            path = _propagate(self.compiled, problem, self.options)
            rows = np.full((len(problem.times), path.rows.shape[1]), np.nan)
            reached, states = len(path.rows), np.abs(path.rows[:, :width])
            # Most states are small relative to the initial ones: then rates are not needed
            if self.options.limit is not None or not states.max() <= MAX_RELATIVE_STATE * np.abs(problem.initial).max():
                within = (states <= largest_state(problem, self.options)).all(axis=1)
                reached = int(np.logical_and.accumulate(within).sum())
            rows[:reached] = path.rows[:reached]
            ended, outcome = path.ended, None
            if path.has_diverged or reached < len(path.rows):
                last = rows[reached - 1], float(problem.times[reached - 1])
                ended, outcome = _divergence(self.compiled, problem, self.options, *last)
            elif ended is not None and path.failure:
                outcome = note("not-integrated", problem.where, time=ended, reason=path.failure)
        occurred = [occurrence for occurrence in path.occurred if ended is None or occurrence[1] <= ended]
        sensitivities = rows[:, width:].reshape(len(rows), width, -1) if self.options.sensitivities else None
        events = occurrences(self.options.events, occurred, width)
        return Trajectory(problem.times, rows[:, :width], outcome, ended, events, sensitivities, path.dense, "heyoka")

    def _levels(self, problem: InitialValueProblem) -> Floats:
        """Return the levels of the events, shifted by rounding where the initial state is on one."""
        functions = EventFunctions(self.options.events, problem.field)
        if not functions.events:
            return functions.levels
        before = functions(problem.start, problem.initial)
        after = functions.at_start(problem.start, problem.initial, float(np.ptp(problem.times)))
        values = functions.levels + before
        aside = values - np.sign(after) * np.maximum(np.spacing(np.abs(values)), 1e-300)
        return np.where(before == after, functions.levels, aside)


@dataclass(frozen=True, eq=False)
class _Path:
    """The integrated part: rows at the first times, at least one, the events, and dense output.

    `ended` is the time of a terminal event or of the step limit, `failure` the reason why it is incomplete, `diverged`
    whether a state was not finite or exceeded the limit.
    """

    rows: Floats
    occurred: Occurred
    dense: Dense | None
    ended: float | None = None
    failure: str = ""
    has_diverged: bool = False


def _propagate(law: Compiled, problem: InitialValueProblem, options: OutputOptions) -> _Path:
    stepper, row, times, most = law.stepper, law.stepper.state.copy(), problem.times, step_limit(problem.stops)
    if len(times) == 1:
        return _Path(row[np.newaxis], [], _dense(None, row, law.width) if options.dense else None)
    if options.dense:
        result, _, _, _, output, _ = stepper.propagate_until(times[-1], max_steps=most, c_output=True)
        done = result == heyoka.taylor_outcome.time_limit
        wanted = times if done or output is None else times[times <= output.bounds[1]]
        rows = np.empty((0, len(row))) if output is None else output(wanted)
        states = _dense(output, row, law.width)
    else:
        result, rows = _rows(law, problem, options)
        states = None
    # Without a first finite step there is no row
    rows, occurred, time = rows if len(rows) else row[np.newaxis], list(law.occurred), float(stepper.time)
    match result:
        case heyoka.taylor_outcome.time_limit:
            return _Path(rows, occurred, states)
        case heyoka.taylor_outcome.err_nf_state:
            return _Path(rows, occurred, states, None, _NOT_FINITE, has_diverged=True)
        case heyoka.taylor_outcome.step_limit:
            failure = f"{most} steps were not enough"
            return _Path(rows, occurred, states, time, failure, has_diverged=_has_diverged(law, problem, options))
    occurred.append((law.terminal[-1 - int(result)], time, stepper.state[: law.width].copy()))
    return _Path(rows, occurred, states, time)


def _rows(law: Compiled, problem: InitialValueProblem, options: OutputOptions) -> tuple[Any, Floats]:
    """Return the outcome of heyoka and the rows at the times reached, piece by piece between changes of inputs."""
    stepper, times, remaining = law.stepper, problem.times, step_limit(problem.stops)
    parts, reached = [law.stepper.state.copy()[np.newaxis]], 1
    while True:
        stop = law.follow(problem)
        until = int(np.searchsorted(times, stop, side="right"))
        wanted = times[reached:until]
        grid = np.unique(np.concatenate([[stepper.time], wanted, [stop]]))
        # Steps may shrink without limit before a blow-up
        result, _, _, steps, _, rows = stepper.propagate_grid(grid, max_steps=max(1, min(remaining, 1000)))
        if result == heyoka.taylor_outcome.step_limit and stepper.time >= stop:  # But for a rounding error of the time
            result, rows = heyoka.taylor_outcome.time_limit, np.concatenate([rows, stepper.state[np.newaxis]])
        parts.append(rows[1 : 1 + len(wanted)])
        remaining, reached = remaining - steps, reached + len(parts[-1])
        # Steps too short for time to pass are not counted
        at_limit = min(remaining, steps) > 0 and result == heyoka.taylor_outcome.step_limit
        continues = at_limit and not _has_diverged(law, problem, options)
        if not continues and (result != heyoka.taylor_outcome.time_limit or stop == times[-1]):
            return result, np.concatenate(parts)


def _dense(output: Any, row: Floats, width: int) -> Dense:
    """Return the dense output; the initial state if no step was possible."""
    if output is None:
        return lambda times: np.tile(row[:width], (len(times), 1))
    # heyoka may overwrite its result
    return lambda times: np.array(output(np.minimum(times, output.bounds[1]))[:, :width])


def _has_diverged(law: Compiled, problem: InitialValueProblem, options: OutputOptions) -> bool:
    return not np.max(np.abs(law.stepper.state[: law.width])) <= largest_state(problem, options)


def _divergence(
    law: Compiled, problem: InitialValueProblem, options: OutputOptions, row: Floats, time: float
) -> tuple[float, Outcome]:
    """Return when a state exceeds the limit after a row, or where heyoka stops."""
    limit = largest_state(problem, options)
    law.reset(time, row)
    for _ in range(step_limit(problem.stops)):
        law.stepper.step(law.follow(problem) - law.stepper.time)
        peak = float(np.max(np.abs(law.stepper.state[: law.width])))
        if not np.isfinite(peak):
            break
        time = float(law.stepper.time)
        if peak > limit:
            return time, diverged(time, f"a state reached {peak:.3g}", problem.where)
    return time, note("not-integrated", problem.where, time=time, reason=_NOT_FINITE)
