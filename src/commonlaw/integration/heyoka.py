"""The back end of the library heyoka: Taylor series, compiled (Biscani and Izzo 2021)."""

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
from commonlaw.integration.problem import (
    FAR,
    AbstractIntegrator,
    EventFunctions,
    InitialValueProblem,
    OutputOptions,
    Trajectory,
    diverged,
    largest_state,
    not_integrated,
    occurrences,
    step_limit,
)
from commonlaw.integration.vector_field import VectorField
from commonlaw.library import Term
from commonlaw.library.grammar import Algebra, evaluate
from commonlaw.outcomes import Outcome

_FUNCTIONS = ("sqrt", "exp", "log", "sin", "cos", "tan", "sinh", "cosh", "tanh")
"""Functions that have Taylor series wherever they are defined, besides arctan; abs, sign and step have none at 0."""


class UnsupportedError(Exception):
    """A law or an event that heyoka does not take; the text says why."""


def translated(term: Term, variables: Sequence[Any]) -> Any:
    """Return a term as an expression of heyoka in these variables.

    Raises `UnsupportedError` if it holds a function without Taylor series.
    """
    return evaluate(term.code, variables, _ALGEBRA)


def _power(base: Any, exponent: Any) -> Any:
    """Return a power; a whole one as products, since heyoka's own power divides by the base."""
    try:  # Without variables an expression is written as a number
        number = float(str(exponent))
    except ValueError:
        return base**exponent
    if not number.is_integer():
        return base**number
    result = math.prod([base] * abs(int(number)), start=heyoka.expression(1.0))
    return result if number >= 0 else 1.0 / result


def _refused(name: str, _: Any) -> NoReturn:
    raise UnsupportedError(f"{name} has no Taylor series at 0")


_OPERATIONS: Mapping[str, Callable[..., Any]] = {
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "divide": operator.truediv,
    "power": _power,
    "negate": operator.neg,
    "arctan": heyoka.atan,
    **{name: getattr(heyoka, name) for name in _FUNCTIONS},
    **{name: partial(_refused, name) for name in ("abs", "sign", "step")},
}
_ALGEBRA = Algebra(lambda number: heyoka.expression(float(number)), _OPERATIONS)


# A home that cannot be written to costs heyoka its cache on disk, and is nothing to tell a user of each time.
heyoka.set_logger_level_error()

Found = list[tuple[int, float, Floats]]


@dataclass(frozen=True)
class Structure:
    """Everything that is compiled, and so nothing that differs between objects.

    The terms that are in some equation; for each coefficient, in their order, its `pair`: the equation and the index of
    the term; the indices of those that sensitivities are wanted of, if any (`free`), and of those that are the values
    of parameters `inside` of terms, None for one that is zero; how many `inputs` there are, the indices of the states
    that are `logarithmic`, and how many powers the polynomials of inputs have; each event's expression, direction and
    whether it is terminal.
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
        """How many states and rates there are."""
        return self.equations + len(self.second)

    @classmethod
    def of(cls, vector_field: VectorField, options: OutputOptions) -> "Structure":
        """Return the structure of a vector field."""
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
    """What heyoka made of a structure: its integrator, which holds parameters, state and time, for `width` states.

    Its parameters are coefficients and levels of events, so many `constants`, and then the polynomials of the inputs.
    `terminal` are the indices of the terminal events; the others write to `found`. Initial sensitivities are row by
    row, empty without.
    """

    stepper: Any
    width: int
    constants: int
    terminal: list[int]
    found: Found
    initial_sensitivities: Floats

    def start(self, problem: InitialValueProblem, levels: Floats) -> None:
        """Set parameters, state and time to the start of a problem."""
        self.stepper.pars[: self.constants] = np.concatenate([problem.field.coefficients[problem.field.kept], levels])
        self.reset(problem.start, np.concatenate([problem.initial, self.initial_sensitivities]))

    def reset(self, time: float, row: Floats) -> None:
        """Set time and state, and forget what was found."""
        self.stepper.time = time
        self.stepper.state[:] = row
        self.found.clear()
        if self.terminal:
            self.stepper.reset_cooldowns()

    def follow(self, problem: InitialValueProblem) -> float:
        """Set the inputs to what holds from the present time on; return until when."""
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
    """Return what is compiled for a structure and one thread, as an integrator holds its own state."""
    states = heyoka.make_vars(*[f"v{i}" for i in range(structure.width)], "unused")[:-1]
    parameters, constants = len(structure.pairs), len(structure.pairs) + len(structure.events)
    natural = [heyoka.exp(state) if j in structure.logarithmic else state for j, state in enumerate(states)]
    inside = [heyoka.expression(0.0) if i is None else heyoka.par[i] for i in structure.inside]
    variables = [*natural, *_inputs(structure, constants), heyoka.time, *inside]
    terms = [translated(term, variables) for term in structure.terms]
    sums: list[list[Any]] = [[] for _ in range(structure.equations)]
    for i, (equation, index) in enumerate(structure.pairs):
        if i not in structure.inside:
            sums[equation].append(heyoka.par[i] * terms[index])
    highest = [heyoka.sum(summands) if summands else heyoka.expression(0.0) for summands in sums]
    highest = [
        derivative / natural[j] if j in structure.logarithmic else derivative for j, derivative in enumerate(highest)
    ]
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
    stepper = heyoka.taylor_adaptive(
        system,
        np.zeros(len(states)),
        tol=structure.tolerance,
        compact_mode=large,
        opt_level=1 if large else 0,
        **events,
    )
    return Compiled(stepper, len(states), constants, terminal, occurred, initial_sensitivities)


def _inputs(structure: Structure, first: int) -> list[Any]:
    """Return the inputs as polynomials, whose knot and coefficients are parameters from the index `first` on."""
    since, inputs = heyoka.time - heyoka.par[first], []
    for j in range(structure.inputs):
        value = heyoka.expression(0.0)
        for power in reversed(range(structure.powers)):
            value = value * since + heyoka.par[first + 1 + power * structure.inputs + j]
        inputs.append(value)
    return inputs


def _events(structure: Structure, variables: list[Any]) -> tuple[list[int], Found, dict[str, list[Any]]]:
    """Return the indices of terminal events, the list that others write to, and both as heyoka takes them."""
    occurred: Found = []
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
    """The fast back end, compiled for all vector fields of one structure."""

    options: OutputOptions
    compiled: Compiled

    @classmethod
    def of(cls, vector_field: VectorField, options: OutputOptions) -> "HeyokaIntegrator":
        """Return the integrator for vector fields of this one's terms, order and support, see `translated`."""
        return cls(options, compiled(Structure.of(vector_field, options), threading.get_ident()))

    def integrate(self, problem: InitialValueProblem) -> Trajectory:
        """Return the trajectory of a problem; the outcome "not integrated" calls for another integrator."""
        width = len(problem.initial)
        with np.errstate(all="ignore"):
            self.compiled.start(problem, self._levels(problem))
            path = _propagate(self.compiled, problem, self.options)
            rows = np.full((len(problem.times), path.rows.shape[1]), np.nan)
            reached = _before_runaway(problem, self.options, path.rows[:, :width])
            rows[:reached] = path.rows[:reached]
            ended, outcome = path.ended, None
            if path.broke or reached < len(path.rows):
                last = rows[reached - 1], float(problem.times[reached - 1])
                ended, outcome = _runaway(self.compiled, problem, self.options, *last)
            elif ended is not None and path.failure:
                outcome = not_integrated(ended, path.failure, problem.where)
        occurred = [occurrence for occurrence in path.found if ended is None or occurrence[1] <= ended]
        sensitivities = rows[:, width:].reshape(len(rows), width, -1) if self.options.sensitivities else None
        events = occurrences(self.options.events, occurred, width)
        return Trajectory(problem.times, rows[:, :width], outcome, ended, events, sensitivities, path.dense, "heyoka")

    def _levels(self, problem: InitialValueProblem) -> Floats:
        """Return the levels of the events."""
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
    """How far heyoka came: rows at the first times (at least at the first), what happened, and the states at any time.

    `ended` says when a terminal event or want of steps ended it early, `failure` why it is not integrated to the end,
    `broke` whether a state was not finite, or ran away.
    """

    rows: Floats
    found: Found
    dense: Dense | None
    ended: float | None = None
    failure: str = ""
    broke: bool = False


def _propagate(law: Compiled, problem: InitialValueProblem, options: OutputOptions) -> _Path:
    """Integrate over the times from where the law was placed."""
    stepper, row, times, most = law.stepper, law.stepper.state.copy(), problem.times, step_limit(problem.stops)
    if len(times) == 1:
        return _Path(row[np.newaxis], [], _dense(None, row, law.width) if options.dense else None)
    if options.dense:
        result, _, _, _, output, _ = stepper.propagate_until(times[-1], max_steps=most, c_output=True)
        done = result == heyoka.taylor_outcome.time_limit
        rows = (
            np.empty((0, len(row))) if output is None else output(times if done else times[times <= output.bounds[1]])
        )
        states = _dense(output, row, law.width)
    else:
        result, rows = _rows(law, problem, options)
        states = None
    # A state that is not finite at once leaves no row at all.
    rows, occurred, time = rows if len(rows) else row[np.newaxis], list(law.found), float(stepper.time)
    match result:
        case heyoka.taylor_outcome.time_limit:
            return _Path(rows, occurred, states)
        case heyoka.taylor_outcome.err_nf_state:
            return _Path(rows, occurred, states, None, _NOT_FINITE, broke=True)
        case heyoka.taylor_outcome.step_limit:
            failure = f"{most} steps were not enough"
            return _Path(rows, occurred, states, time, failure, broke=_ran_away(law, problem, options))
    occurred.append((law.terminal[-1 - int(result)], time, stepper.state[: law.width].copy()))
    return _Path(rows, occurred, states, time)


def _rows(law: Compiled, problem: InitialValueProblem, options: OutputOptions) -> tuple[Any, Floats]:
    """Return how heyoka ended and the rows at the times, as far as it came; inputs change their course at stops."""
    stepper, times, remaining = law.stepper, problem.times, step_limit(problem.stops)
    parts, reached = [law.stepper.state.copy()[np.newaxis]], 1
    while True:
        stop = law.follow(problem)
        until = int(np.searchsorted(times, stop, side="right"))
        wanted = times[reached:until]
        grid = np.unique(np.concatenate([[stepper.time], wanted, [stop]]))
        # On the way of a state to infinity steps may become shorter without end
        result, _, _, steps, _, rows = stepper.propagate_grid(grid, max_steps=max(1, min(remaining, 1000)))
        if result == heyoka.taylor_outcome.step_limit and stepper.time >= stop:  # But for a rounding error of the time
            result, rows = heyoka.taylor_outcome.time_limit, np.concatenate([rows, stepper.state[np.newaxis]])
        parts.append(rows[1 : 1 + len(wanted)])
        remaining, reached = remaining - steps, reached + len(parts[-1])
        goes_on = remaining > 0 and result == heyoka.taylor_outcome.step_limit and not _ran_away(law, problem, options)
        if not goes_on and (result != heyoka.taylor_outcome.time_limit or stop == times[-1]):
            return result, np.concatenate(parts)


def _dense(output: Any, row: Floats, width: int) -> Dense:
    """Return the states at any time; heyoka gives no output where not even a first step was possible."""
    if output is None:
        return lambda times: np.tile(row[:width], (len(times), 1))
    # heyoka may write its next answer where this one is.
    return lambda times: np.array(output(np.minimum(times, output.bounds[1]))[:, :width])


def _ran_away(law: Compiled, problem: InitialValueProblem, options: OutputOptions) -> bool:
    """Whether a state is too far, or no number any more."""
    return not np.max(np.abs(law.stepper.state[: law.width])) <= largest_state(problem, options)


def _runaway(
    law: Compiled, problem: InitialValueProblem, options: OutputOptions, row: Floats, time: float
) -> tuple[float, Outcome]:
    """Go on from a row, step by step; return when a state ran away, or where heyoka can go no further."""
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
    return time, not_integrated(time, _NOT_FINITE, problem.where)


def _before_runaway(problem: InitialValueProblem, options: OutputOptions, states: Floats) -> int:
    """Return how many of the first rows are finite and not too far."""
    # The largest state of most trajectories is not even far from the initial ones: then the rates need not be known.
    if options.limit is None and np.max(np.abs(states)) <= FAR * np.max(np.abs(problem.initial)):
        return len(states)
    limit = largest_state(problem, options)
    return int(np.logical_and.accumulate((np.abs(states) <= limit).all(axis=1)).sum())
