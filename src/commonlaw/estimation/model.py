"""Equations, observation equations and initial values as programs over states, inputs, time and parameters."""

import ast
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import cast

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.formulation import law_variables
from commonlaw.law.observation import STEADY, Initial
from commonlaw.law.parse import event_equations, event_expressions, meanings_of, observation_equation
from commonlaw.library import Order, Variables, highest_columns, one_order, with_rates
from commonlaw.library.bounds import EVENT, Bound, bounds_in, is_bound, parts_of, split_outside
from commonlaw.library.equation import DERIVATIVE, check_length, split_equations
from commonlaw.library.grammar import FUNCTION_NAMES, JUMPING, STAIRS, columns_in, read, tree_of, write
from commonlaw.library.notation import NAME, quoted, unquoted
from commonlaw.library.program import Program
from commonlaw.library.term import Factor
from commonlaw.runtime.forking import cached_property
from commonlaw.trials import Schema, Trial

_DELAYED = re.compile(rf"(?<![^\W\d])(?P<name>{NAME})\s*\(\s*(?:t|time)\s*-\s*(?P<delay>{NAME})\s*\)|`(?:[^`]|``)+`")
_NAMED = re.compile(r"`((?:[^`]|``)+?)(\(t - (?:`(?:[^`]|``)+`|\w+)\))`")
_CALLED = re.compile(rf"{_DELAYED.pattern}|(?P<jump>(?<!\w)(?:{'|'.join(JUMPING)})\s*\(|[<>])")
_INITIAL = re.compile(rf"(?P<name>{NAME})(?P<rate>')?\s*\(\s*0\s*\)\s*=(?P<right>.*)", re.DOTALL)
_OBSERVED = re.compile(rf"(?P<name>{NAME})\s*=(?P<right>.*)", re.DOTALL)
_CHANGED = re.compile(rf"(?P<name>{NAME})(?P<rate>'?)\s*=(?P<right>.+)", re.DOTALL)


@dataclass(frozen=True)
class ModelText:
    """What is written of a model: differential equations, observation equations, initial values, events and bounds.

    Initial values, events and functions are as in `Observation`.
    """

    equations: tuple[str, ...]
    observed: Mapping[str, str]
    initial: Mapping[str, Initial]
    bounds: tuple[Bound, ...] = ()
    events: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    functions: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @classmethod
    def of(cls, texts: str | Sequence[str], observe: Mapping[str, str] | None = None) -> "ModelText":
        """Return what equations, in one text or several, and observation equations by name say together."""
        equations, bounds, observed, known = list[str](), list[str](), dict(observe or {}), dict[str, Initial]()
        events = dict[str, dict[str, str]]()
        for part in parts_of(texts):
            if is_bound(part) and not DERIVATIVE.search(part):
                bounds.append(part)
                continue
            if match := EVENT.fullmatch(part):
                changes = events.setdefault(match["condition"].strip(), {})
                for change in split_outside(match["changes"]):
                    changed = _CHANGED.fullmatch(change.strip())
                    name = unquoted(changed["name"]) + changed["rate"] if changed else ""
                    if changed is None or name in changes:
                        raise CommonlawError("equation-event-syntax", text=part)
                    changes[name] = changed["right"].strip()
            elif match := _INITIAL.fullmatch(part):
                name = unquoted(match["name"]) + (match["rate"] or "")
                known[name] = _with_start(known.get(name), name, match["right"].strip())
            elif match := _OBSERVED.fullmatch(part):
                observed[unquoted(match["name"])] = match["right"].strip()
            else:
                check_length(part)
                equations.append(part)
        return cls(tuple(equations), observed, known, bounds_in(bounds), events)

    @property
    def named(self) -> tuple[str, ...]:
        """The states of the equations, and what was observed."""
        return (*(equation.state for equation in split_equations(self.equations)), *self.observed)

    @property
    def beyond_equations(self) -> list[str]:
        """What there is besides differential equations and bounds, in words."""
        calls = (match for text in self.equations for match in _CALLED.finditer(text))
        special = any(match["jump"] or (match["name"] and match["name"] not in FUNCTION_NAMES) for match in calls)
        parts = {
            "observation equations": self.observed,
            "initial values": self.initial,
            "events": self.events,
            "jumps or delays": special,
        }
        return [name for name, is_there in parts.items() if is_there]


def _with_start(known: Initial | None, state: str, right: str) -> Initial:
    """Return the initial value of a state with a further one: an expression, or a number for some trials."""
    number, _, trials = right.partition("@")
    if not trials:
        if known is not None:
            raise CommonlawError("initial-value-twice", state=state)
        return right
    if known is not None and not isinstance(known, Mapping):
        raise CommonlawError("initial-value-twice", state=state)
    trials = trials.strip()  # The label of a trial has a comma, too
    names = [unquoted(name) for name in (split_outside(trials) if trials.startswith("`") else [trials])]
    if len({*names}) < len(names) or not (known or {}).keys().isdisjoint(names):
        raise CommonlawError("initial-value-twice", state=state)
    try:
        return {**(known or {}), **dict.fromkeys(names, float(number))}
    except ValueError:
        raise CommonlawError("initial-value-not-finite", state=state, value=number.strip(), object=names[0]) from None


@dataclass(frozen=True, eq=False)
class Model:
    """Given equations as programs.

    Parameters
    ----------
    text
        What was written; in its equations delayed inputs are names of their own.
    schema
        States of the equations, inputs (delayed ones among them) and time.
    order
        Of the equations.
    variables
        States, rates of those of second order, inputs and time, followed by the parameters.
    rates
        The derivatives of states and rates of the variables, shape (n, D); and `switched` the same with switches and
        events as further variables, followed by what decides them, see `commonlaw.integration.shooting.shoot`.
    observables, outputs
        Names of what is measured, and their values.
    initial
        For each state and rate its initial value over the variables (of which only parameters and inputs that are
        constant in each trial may be in it), or None for one that each trial determines; `known` has those of objects
        and trials that are numbers, and `expected` the mean and standard deviation of such values, by index of the
        state.
    steady
        The states and rates, by index, that begin in the steady state; and under which inputs, by index, each as an
        expression like an initial value.
    expressions, events
        Of the derivatives and outputs; and of each event what is positive where its condition is true, and the states
        and rates after it.
    column, delay
        For each input of the schema the column of the trials, and the parameter by which it comes later, or -1.
    """

    text: ModelText
    schema: Schema
    order: Order
    variables: Variables
    rates: Program
    switched: Program
    observables: tuple[str, ...]
    outputs: Program
    initial: tuple[str | None, ...]
    known: Mapping[int, Mapping[str, float]]
    expected: Mapping[int, tuple[float, float]]
    steady: tuple[int, ...]
    steady_inputs: Mapping[int, str]
    expressions: tuple[str, ...]
    events: tuple[tuple[str, tuple[str, ...]], ...]
    column: tuple[int, ...]
    delay: tuple[int, ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.variables.parameters

    @property
    def width(self) -> int:
        """The number of states and rates, D."""
        return len(self.variables.states)

    @property
    def first_parameter(self) -> int:
        """The column of the first parameter."""
        return len(self.variables.measured)

    @cached_property
    def starting_inputs(self) -> list[int]:
        """The inputs, by index, that initial values depend on."""
        columns = {column for start in self.initial if start is not None for column in columns_in(start)}
        return [i for i in range(len(self.column)) if self.width + i in columns]

    @cached_property
    def measured_states(self) -> list[int] | None:
        """The states and rates, by index, that are measured themselves; None if something else is."""
        registers: list[int] = self.outputs.outputs.tolist()  # The first ones are variables, of which states are first
        return registers if all(register < self.width for register in registers) else None

    @cached_property
    def starts(self) -> Program:
        """Initial values over the variables; zero where they are free."""
        return _program([start or "0.0" for start in self.initial], len(self.variables.names))

    @cached_property
    def before(self) -> Program:
        """Inputs of the steady state over the variables; zero where they are those at the initial time."""
        inputs = [self.steady_inputs.get(i, "0.0") for i in range(len(self.column))]
        return _program(inputs, len(self.variables.names))

    def initial_of(self, trial: Trial) -> Floats:
        """Return the initial values of a trial, or of its object, that are numbers, shape (D,), NaN for others."""
        numbers = [self.known.get(j, {}) for j in range(self.width)]
        return np.array([by_name.get(trial.label, by_name.get(trial.object, np.nan)) for by_name in numbers])

    def free_of(self, trial: Trial) -> list[int]:
        """Return the states and rates, by index, whose initial values a trial of an object determines."""
        known = self.initial_of(trial)
        return [j for j, start in enumerate(self.initial) if start is None and np.isnan(known[j])]

    def free_in(self, trial: Trial) -> list[int]:
        """Return the same in a trial: before a first dose all are zero but those that were measured with it."""
        free = self.free_of(trial)
        if not trial.begins_with_dose:
            return free
        measured = np.isfinite(trial.states[0]) | np.isfinite(trial.below[0])
        outputs = compress(self.expressions[self.width :], measured)
        columns = {column for output in outputs for column in columns_in(output)}
        count = len(self.schema.states)  # A rate is measured where its state is
        states = [*range(count), *with_rates(self.order, count).tolist()]
        return [j for j in free if columns & {j, states[j]}]

    def with_terms(self, equation: int, functions: Mapping[str, str], properties: Sequence[str]) -> "Model":
        """Return the model with functions in one equation, by the names of their weights.

        These and the properties in functions are further parameters.
        """
        terms, weights = [*functions.values()], [*functions]
        names = (*self.variables.names, *properties)
        properties = [
            name
            for name in properties
            if any(names.index(name) in columns_in(write(read(text, names))) for text in terms)
        ]
        names, total = (*self.variables.names, *properties), len(self.variables.names) + len(properties) + len(terms)
        rows, row = [*self.expressions[: self.width]], highest_columns(self.order, len(self.schema.states))[equation]
        added = (f"v{len(names) + i}*({write(read(text, names))})" for i, text in enumerate(terms))
        rows[row] = " + ".join([rows[row], *added])
        return replace(
            self,
            variables=replace(self.variables, parameters=(*self.parameters, *properties, *weights)),
            rates=_program(rows, total),
            switched=_with_switches(rows, self.events, total),
            outputs=self.outputs.with_variables(len(properties) + len(terms)),
            expressions=(*rows, *self.expressions[self.width :]),
        )

    def point(self, states: Floats, inputs: Floats, times: Floats, parameters: Floats) -> Floats:
        """Return the variables at n times, shape (n, variables)."""
        first = self.first_parameter
        rows = np.empty((len(times), first + len(parameters)))
        rows[:, : self.width], rows[:, self.width : first - 1] = states, inputs
        rows[:, first - 1], rows[:, first:] = times, parameters
        return rows


def _program(expressions: Sequence[str], variables: int) -> Program:
    return Program.of([((Factor(expression), 1),) for expression in expressions], variables)


class _Switches(ast.NodeTransformer):
    """Puts a variable in place of each unit step, and collects what decides it.

    ``max(g, 0)`` in a root or a power keeps its step behind the variable, as these have no value for negative g, where
    an integration step ends before the crossing is located.
    """

    def __init__(self, first: int) -> None:
        self.first, self.deciding, self.roots = first, list[str](), 0

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        is_power = isinstance(node.op, ast.Pow)
        if self.roots and isinstance(node.op, ast.Mult) and write(node.left) == f"step({write(node.right)})":
            return ast.BinOp(self._switch(write(node.right)), ast.Mult(), node)
        self.roots += is_power
        node.left = cast(ast.expr, self.visit(node.left))
        self.roots -= is_power
        node.right = cast(ast.expr, self.visit(node.right))
        return node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        is_root = isinstance(node.func, ast.Name) and node.func.id in ("sqrt", "log")
        self.roots += is_root
        self.generic_visit(node)
        self.roots -= is_root
        if not (isinstance(node.func, ast.Name) and node.func.id == "step"):
            return node
        return self._switch(write(node.args[0]))

    def _switch(self, deciding: str) -> ast.Name:
        if deciding not in self.deciding:
            self.deciding.append(deciding)
        return ast.Name(f"v{self.first + self.deciding.index(deciding)}", ast.Load())


def _with_switches(expressions: Sequence[str], events: Sequence[tuple[str, Sequence[str]]], variables: int) -> Program:
    """Return the program of rates, of what decides unit steps and events, variables of their own, and of changes."""
    switches = _Switches(variables)

    def without_steps(parts: Iterable[str]) -> list[str]:
        return [write(switches.visit(ast.parse(part, mode="eval").body)) for part in parts]

    rates, conditions = without_steps(expressions), without_steps(condition for condition, _ in events)
    changes = without_steps(change for _, states in events for change in states)
    count = variables + len(switches.deciding) + len(events)
    return _program([*rates, *switches.deciding, *conditions, *changes], count)


def _check_endless(text: str, event: tuple[str, tuple[str, ...]], variables: Variables) -> None:
    """Refuse an event that does no more than set a state to the threshold that it has just crossed."""
    decided, after = event
    changed = [j for j, new in enumerate(after) if new != f"v{j}"]
    if len(changed) != 1 or {j for j in columns_in(decided) if j < len(after)} != {*changed}:
        return
    (j,), points = changed, np.random.default_rng(0).uniform(0.5, 2.0, (3, len(variables.names)))
    program = _program([after[j], decided], len(variables.names))
    at, beyond = points.copy(), points.copy()
    at[:, j] = program.evaluate(points)[:, 0]
    beyond[:, j] = at[:, j] + 1.0
    if np.any(np.abs(program.evaluate(at)[:, 1]) > 1e-12 * (1 + np.abs(at[:, j]))):
        return
    side = "<" if (program.evaluate(beyond)[:, 1] > 0).all() else ">"
    parts = [f"`{line}`" for line in ("s' = 0 s", "s(0) = 0", f"{text}: s = 1", f"rate {side} 0: s = 0")]
    raise CommonlawError("equation-event-endless", text=text, name=variables.states[j], s=parts)


def _check_stairs(expressions: Iterable[str], variables: Variables) -> None:
    """Refuse a state inside of a function whose jumps are not located, so that derivatives by parameters are wrong."""
    for node in (node for expression in expressions for node in ast.walk(tree_of(expression))):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in STAIRS:
            column = min(columns_in(node), default=len(variables.states))
            if column < len(variables.states):
                raise CommonlawError("stairs-of-state", function=ast.unparse(node.func), state=variables.states[column])


def _steady_inputs(written: set[str], measured: Schema) -> dict[str, str]:
    """Return the inputs of the steady state as they are written in all of the initial values that are said to be it."""
    if len({"".join(start.split()) for start in written}) > 1:
        raise CommonlawError("steady-states-differ", written=sorted(written))
    match = STEADY.fullmatch(next(iter(written), "steady"))
    given = dict[str, str]()
    for assignment in (match["inputs"] or "" if match else "").split(","):
        if assignment.strip():
            name, _, value = (part.strip() for part in assignment.partition("="))
            check_choice("input", unquoted(name), measured.inputs)
            given[unquoted(name)] = value
    return given


def read_model(text: ModelText, measured: Schema, properties: Sequence[str]) -> Model:
    """Return the model that is written for trials of a schema, whose objects have these properties.

    Raises
    ------
    CommonlawError
        If a text cannot be read, a name means nothing, or something measured has neither a state nor an equation.
    """
    delays = list[tuple[str, str, str]]()

    def delayed(match: re.Match[str]) -> str:
        if not match["name"]:
            return match[0]
        name, delay = unquoted(match["name"]), unquoted(match["delay"])
        if name in FUNCTION_NAMES and name not in measured.inputs:
            return match[0]
        if name not in measured.inputs:
            raise CommonlawError("equation-with-delay", name=name)
        whole = f"{name}(t - {delay})"
        if whole not in [signal for signal, *_ in delays]:
            delays.append((whole, name, delay))
        return f"`{whole}`"

    def plain(name: re.Match[str]) -> str:
        is_column = unquoted(name[0]) in (*measured.states, *measured.inputs)
        return name[0] if is_column else f"{quoted(unquoted(f'`{name[1]}`'))}{name[2]}"

    # Those of a law have delayed inputs by their names
    undelayed = (_NAMED.sub(plain, equation) for equation in text.equations)
    equations = tuple(_DELAYED.sub(delayed, equation) for equation in undelayed)
    text = replace(text, equations=equations)
    parsed = split_equations(equations)
    states = tuple(equation.state for equation in parsed)
    for name in states:
        if name in measured.inputs:
            raise CommonlawError("equation-of-input", name=name)
    inputs = (*measured.inputs, *(whole for whole, *_ in delays))
    units = {name: unit for name, unit in measured.units.items() if name in (*states, *measured.inputs, measured.time)}
    rates = {state: rate for state, rate in measured.rates.items() if state in states}
    schema = Schema(
        states,
        inputs,
        measured.object,
        measured.trial,
        measured.time,
        units,
        input_interpolation=measured.input_interpolation,
        doses=measured.doses,
        rates=rates,
    )
    order = one_order([equation.order for equation in parsed])
    if order == 0:
        raise CommonlawError("observation-of-discrete-time")
    variables = law_variables(schema, order)
    meanings = meanings_of(schema, order, variables)

    for name in measured.states:
        if name not in text.observed and name not in variables.states:
            raise CommonlawError("measured-without-equation", name=name, states=variables.states)
    for name in text.observed:
        check_choice("measured quantity", name, measured.states)
    observed = [observation_equation(name, text.observed.get(name, f"`{name}`")) for name in measured.states]
    rate_of = {f"{state}'": rate for state, rate in meanings.rates.items()}
    given = {rate_of.get(name, name): start for name, start in text.initial.items()}
    for name in given:
        check_choice("state of the equations", name, variables.states)
    starts = {name: start for name, start in given.items() if isinstance(start, str)}
    steady = [name for name, start in starts.items() if STEADY.fullmatch(start)]
    before = _steady_inputs({starts.pop(name) for name in steady}, measured)
    others = {**{f"{name}(0)": start for name, start in starts.items()}, **before}
    written = [*parsed, *observed, *(observation_equation(name, right) for name, right in others.items())]
    occurring = event_equations(text.events, meanings)
    for (name, assignments), (condition, changes) in zip(text.events.items(), occurring, strict=True):
        if any(_DELAYED.search(part) for part in (name, *assignments.values())):
            raise CommonlawError("equation-event-delay", text=name)
        for changed in changes:
            check_choice("state of the equations", changed, variables.states)
        written += [condition, *changes.values()]
    named = dict.fromkeys(name for equation in written for name in equation.expression(variables, meanings)[1])
    named |= dict.fromkeys(delay for *_, delay in delays)
    variables = replace(variables, parameters=tuple(named))
    expressions = [equation.expression(variables, meanings)[0] for equation in written]
    second_order = with_rates(order, len(states)).tolist()
    rows = [""] * len(variables.states)
    for i, j in enumerate(second_order):
        rows[j] = f"v{len(states) + i}"
    for j, expression in zip(highest_columns(order, len(states)), expressions, strict=False):
        rows[j] = expression
    texts = dict(zip((*starts, *before), expressions[len(parsed) + len(observed) :], strict=False))
    _check_stairs(expressions, variables)
    events = event_expressions(occurring, variables, meanings)
    for name, event in zip(text.events, events, strict=True):
        _check_endless(name, event, variables)
    parameters, first = variables.parameters, len(variables.measured)
    known = range(len(variables.states), len(variables.states) + len(measured.inputs))
    for name, expression in texts.items():
        if any(i < first and not (i in known and name in starts) for i in columns_in(expression)):
            raise CommonlawError("initial-value-of-variables")
    initial = tuple("0.0" if name in steady else texts.get(name) for name in variables.states)
    outputs = expressions[len(parsed) : len(parsed) + len(observed)]
    column = (*range(len(measured.inputs)), *(measured.inputs.index(name) for _, name, _ in delays))
    delay = (*([-1] * len(measured.inputs)), *(parameters.index(delay) for *_, delay in delays))
    for name, output in zip(measured.states, outputs, strict=True):
        if min(columns_in(output), default=first) >= len(variables.states):
            raise CommonlawError("observation-without-state", name=name, states=variables.states)
    for bound in text.bounds:
        check_choice("parameter", bound.name, [name for name in parameters if name not in properties])
    model = Model(
        text,
        schema,
        order,
        variables,
        _program(rows, len(variables.names)),
        _with_switches(rows, events, len(variables.names)),
        measured.states,
        _program(outputs, len(variables.names)),
        initial,
        {variables.states.index(name): start for name, start in given.items() if isinstance(start, Mapping)},
        {variables.states.index(name): start for name, start in given.items() if isinstance(start, tuple)},
        tuple(variables.states.index(name) for name in steady),
        {i: texts[measured.inputs[j]] for i, j in enumerate(column) if measured.inputs[j] in before},
        (*rows, *outputs),
        events,
        column,
        delay,
    )
    for state, functions in text.functions.items():
        check_choice("state of the equations", state, states)
        more = [name for name in properties if name not in model.variables.names]
        model = model.with_terms(states.index(state), functions, more)
    return model
