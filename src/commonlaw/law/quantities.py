"""Quantities that are quoted of laws of known forms: half-lives, carrying capacities, periods, reproduction numbers."""

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from itertools import permutations
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.law.equilibria import Quantity, equilibria, modes
from commonlaw.law.law import Law
from commonlaw.law.parameters import Parameters, named_parameters, reach_of_equations
from commonlaw.law.parse import GivenEquations, read_equations
from commonlaw.law.provenance import WITHOUT_QUANTITIES
from commonlaw.law.quantiles import Estimate, Function, propagated
from commonlaw.library import Variables, order_of_each, term_unit, with_rates
from commonlaw.library.bounds import Bound
from commonlaw.library.equation import Equation, split_equations
from commonlaw.library.expansion import Traced, summands
from commonlaw.library.grammar import evaluate
from commonlaw.library.term import Term, parse_term
from commonlaw.runtime.files import read_file
from commonlaw.runtime.forking import cached_property
from commonlaw.trials import Schema
from commonlaw.trials.headers import parse_unit
from commonlaw.trials.trial import property_names

if TYPE_CHECKING:
    import pandas as pd
    import pint


@dataclass(frozen=True)
class Form:
    """Equations that a law may have up to names, and quantities of these; the file of forms explains the fields."""

    title: str
    equations: tuple[str, ...]
    quantities: tuple[tuple[str, ...], ...]
    inputs: tuple[str, ...] = ()
    forced: bool = False
    doses: bool = False
    bolus: str = ""
    measured: str = ""
    units: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@cache
def forms() -> tuple[Form, ...]:
    """Return all forms."""
    tables = tomllib.loads(read_file(Path(__file__).with_name("quantities.toml")).decode())
    return tuple(msgspec.convert(form, Form) for form in tables["form"])


class Entry(NamedTuple):
    """A term of an equation of a form, without parameters that are its factors: a number and their powers before it."""

    equation: int
    term: Term
    number: float
    powers: Mapping[str, int]


class _Pattern(NamedTuple):
    """One way to write a form: its terms over its own names, the parameters inside them, and bounds."""

    form: Form
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    orders: tuple[int, ...]
    variables: Variables
    entries: tuple[Entry, ...]
    inside: tuple[str, ...]
    bounds: Mapping[str, Bound]


@cache
def _patterns() -> tuple[_Pattern, ...]:
    return tuple(_pattern(form, text) for form in forms() for text in form.equations)


def _pattern(form: Form, text: str) -> _Pattern:
    equations = split_equations(text)
    states, orders = zip(*((equation.state, equation.order) for equation in equations), strict=True)
    inputs = tuple(name for name in form.inputs if re.search(rf"\b{name}\b", text))
    given = read_equations(text, Schema(states, inputs))
    variables, entries = given.terms.variables, entries_of(given)
    inside = tuple(_inside([entry.term for entry in entries], variables))
    bounds = {bound.name: bound for bound in given.bounds}
    return _Pattern(form, states, inputs, orders, variables, entries, inside, bounds)


def variables_in(law: Law, equations: str, inputs: tuple[str, ...]) -> Iterator[Mapping[str, str]]:
    """Yield the variables of a law by those of equations that it has as a whole, within their bounds.

    The mean of the coefficients of the objects decides.
    """
    mean = law.coefficients.mean(axis=0, keepdims=True)
    for match in _matches(law, [_pattern(Form("", (equations,), (), inputs), equations)]):
        if len(match.equations) == len(law.schema.states) and match.holds(mean):
            yield match.names


def _summands(term: Term, variables: Variables) -> Iterator[tuple[float, Term, dict[str, int]]]:
    """Yield the summands of a term, multiplied out: numbers, terms without parameters as factors, powers of these."""
    plain = tuple(f"x{i}" for i in range(len(variables.names)))
    pieces = [(1.0, term)]
    if any(factor.is_sum and power > 0 for factor, power in term.powers):
        with suppress(CommonlawError):  # Of powers with parameters, which stay as they are
            parts = summands(Traced(term.expression(plain)), plain)
            pieces = [(number, parse_term(text, _over(plain, variables))) for number, text in parts]
    first = len(variables.measured)
    for number, part in pieces:
        outer = {factor: n for factor, n in part.powers if factor.column is not None and factor.column >= first}
        powers = {variables.names[factor.column or 0]: n for factor, n in outer.items()}
        yield number, Term(tuple(power for power in part.powers if power[0] not in outer)), powers


def _over(names: Sequence[str], variables: Variables) -> Variables:
    """Return variables of other names in the same columns."""
    count = len(variables.measured)
    return Variables(tuple(names[: count - 1]), time=names[count - 1], parameters=tuple(names[count:]))


def entries_of(given: GivenEquations) -> tuple[Entry, ...]:
    """Return the terms of equations, multiplied out."""
    products, result = {(product.equation, product.term): product for product in given.products}, list[Entry]()
    for j, k in np.argwhere((given.known != 0) & given.terms.is_factor).tolist():
        number, before = given.known[j, k], list[tuple[str, int]]()
        if (product := products.get((j, k))) is not None:
            number, before = product.factor, [*product.coefficients]
        for factor, term, powers in _summands(given.terms.terms[k], given.terms.variables):
            for name, power in before:
                powers[name] = powers.get(name, 0) + power
            result.append(Entry(j, term, float(number) * factor, powers))
    return tuple(result)


class _Place(NamedTuple):
    """A coefficient of a law by equation and term, and what multiplies it: a number, powers of terms of parameters."""

    equation: int
    term: int
    factor: float = 1.0
    powers: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True, eq=False)
class _Match:
    """A form that some equations of a law have, the variables of the law by those of the form, and its parameters.

    For each term of the form `places` has the coefficients that are added before it, and `inner` the terms of the
    law that are parameters inside terms; `inputs` are the coefficients of inputs that a forced form may have, and
    `volume` is the term of a volume, with the name of the dose.
    """

    pattern: _Pattern
    law: Law
    names: Mapping[str, str]
    equations: tuple[int, ...]
    places: tuple[tuple[_Place, ...], ...]
    inner: Mapping[str, int]
    inputs: Mapping[str, _Place]
    volume: tuple[int, str] | None

    @property
    def title(self) -> str:
        """What the form is called, with its states where it is that of a part of the equations."""
        states = [self.law.schema.states[j] for j in self.equations]
        part = f" of {', '.join(states)}" if len(states) < len(self.law.schema.states) else ""
        return f"{self.pattern.form.title}{part}"

    @cached_property
    def unknown(self) -> tuple[str, ...]:
        """Parameters that are factors of terms."""
        names = dict.fromkeys(name for entry in self.pattern.entries for name in entry.powers)
        return tuple(name for name in names if name not in self.inner)

    @cached_property
    def solution(self) -> tuple[list[int], Floats, Floats]:
        """Entries that determine these, powers of them that they are, and their powers in all entries."""
        powers = np.array(
            [[entry.powers.get(name, 0) for name in self.unknown] for entry in self.pattern.entries], dtype=float
        )
        powers = powers.reshape(len(self.pattern.entries), len(self.unknown))
        chosen = list[int]()
        for i in range(len(powers)):
            if np.linalg.matrix_rank(powers[[*chosen, i]]) > len(chosen):
                chosen.append(i)
        return chosen, np.linalg.pinv(powers[chosen]), powers

    def values(self, coefficients: Floats) -> dict[str, Floats]:
        """Return the parameters of the form from coefficients of the law, shape (n, equations, terms)."""
        whole = coefficients.sum(axis=1)  # A parameter inside terms has one coefficient, in whatever equation
        result = {name: whole[:, term] for name, term in self.inner.items()}
        chosen, inverse, _ = self.solution
        sizes = self._sizes(coefficients, chosen)
        with np.errstate(all="ignore"):
            for name, row in zip(self.unknown, inverse, strict=True):
                result[name] = np.prod(sizes ** np.rint(row)[:, np.newaxis], axis=0)
        if self.volume is not None:
            result[self.pattern.form.bolus] = whole[:, self.volume[0]]
        return result

    def _sizes(self, coefficients: Floats, entries: Sequence[int]) -> Floats:
        """Return the products of unknown parameters before some entries, shape (entries, n)."""
        whole, sizes = coefficients.sum(axis=1), np.zeros((len(entries), len(coefficients)))
        with np.errstate(all="ignore"):
            for row, i in zip(sizes, entries, strict=True):
                entry = self.pattern.entries[i]
                row += sum(_value(coefficients, whole, place) for place in self.places[i]) / entry.number
                for name, power in entry.powers.items():
                    row /= whole[:, self.inner[name]] ** power if name in self.inner else 1.0
        return sizes

    @property
    def part(self) -> str:
        """What follows the names of quantities of one equation of several."""
        states = self.law.schema.states
        return f" of {states[self.equations[0]]}" if len(self.equations) == 1 < len(states) else ""

    def holds(self, coefficients: Floats) -> bool:
        """Return whether the coefficients of one object, shape (1, equations, terms), have the form."""
        values, (_, _, powers) = self.values(coefficients), self.solution
        columns = np.array([values[name] for name in self.unknown]).reshape(len(self.unknown), -1)
        with np.errstate(all="ignore"):
            expected = np.prod(columns ** powers[:, :, np.newaxis], axis=1)
            # Some parameters stand in several entries
            sizes = self._sizes(coefficients, range(len(self.pattern.entries)))
            agree = np.isclose(expected, sizes, rtol=1e-9, atol=0.0)
        inside = (
            np.all((values[name] > bound.low) & (values[name] < bound.high))
            for name, bound in self.pattern.bounds.items()
        )
        # A dose that is added to a state as it is makes the state an amount, which has no volume
        is_amount = self.pattern.form.doses and bool(np.all(values["V"] == 1))
        finite = all(np.isfinite(value).all() for value in values.values())
        return bool(agree.all()) and finite and all(inside) and not is_amount


def _value(coefficients: Floats, parameters: Floats, place: _Place) -> Floats:
    result = coefficients[:, place.equation, place.term] * place.factor
    for term, power in place.powers:
        result = result * parameters[:, term] ** power
    return np.asarray(result)


def _matches(law: Law, patterns: Sequence[_Pattern]) -> list[_Match]:
    """Return the patterns that equations of a law may have, by their terms."""
    states, orders, result = law.schema.states, order_of_each(law.order, len(law.schema.states)), list[_Match]()
    for pattern in patterns:
        inputs = [name for name in law.schema.inputs if (name in law.schema.doses) == pattern.form.doses]
        for chosen in permutations(range(len(states)), len(pattern.states)):
            if tuple(orders[j] for j in chosen) == pattern.orders:
                for given in permutations(inputs, len(pattern.inputs)):
                    names = zip((*pattern.states, *pattern.inputs), (*(states[j] for j in chosen), *given), strict=True)
                    match = _matched(law, pattern, chosen, dict(names))
                    if match is not None and _may_have_units(match):
                        result.append(match)
    return result


def _matched(law: Law, pattern: _Pattern, chosen: tuple[int, ...], names: Mapping[str, str]) -> _Match | None:
    """Return the match of some equations of a law, if they have the terms of a form with these names of variables."""
    variables, states, form = law.terms.variables, law.schema.states, pattern.form
    rates = dict(zip(with_rates(law.order, len(states)).tolist(), variables.states[len(states) :], strict=True))
    own_rates = [rates[j] for j in chosen if j in rates]
    dynamic = {variables.index(name) for name in (*(states[j] for j in chosen), *own_rates)}
    others = {*range(len(variables.states))} - dynamic
    places, forcing = dict[tuple[int, Term], list[_Place]](), list[tuple[Term, _Place]]()
    for i, j in enumerate(chosen):
        for k in np.flatnonzero(law.support[j] & law.terms.is_factor).tolist():
            if law.terms.terms[k].columns() & others:
                return None
            for factor, term, powers in _summands(law.terms.terms[k], variables):
                before = ((law.terms.parameters[variables.parameters.index(name)], n) for name, n in powers.items())
                if form.forced and not term.columns() & dynamic:
                    forcing.append((term, _Place(j, k, factor, tuple(before))))
                else:
                    places.setdefault((i, term), []).append(_Place(j, k, factor, tuple(before)))
    inside = _inside([term for _, term in places], variables)
    if len(places) != len(pattern.entries) or len(inside) != len(pattern.inside):
        return None
    # Over plain names, as those of a law may be any
    plain = dict(zip(variables.names, (f"x{i}" for i in range(len(variables.names))), strict=True))
    over = _over([*plain.values()], variables)
    in_law = {**names, **dict(zip(pattern.variables.states[len(pattern.states) :], own_rates, strict=True))}
    for order in permutations(inside):
        known = in_law | dict(zip(pattern.inside, order, strict=True))
        columns_of_form = [plain.get(known.get(name, ""), "unused") for name in pattern.variables.names]
        keys = [(entry.equation, parse_term(entry.term.expression(columns_of_form), over)) for entry in pattern.entries]
        if {*keys} != {*places}:
            continue
        # What an observation equation scales is no concentration: its volume stands there
        if form.measured and not _is_measured(law, names[form.measured]):
            return None
        volume = _volume(law, names[pattern.states[0]]) if form.bolus else None
        if form.bolus and volume is None:
            return None
        names_of = {term: term.text(variables.names) for term, _ in forcing}
        inputs = [name for name in law.schema.inputs if name not in law.schema.doses]
        return _Match(
            pattern,
            law,
            names,
            chosen,
            tuple(tuple(places[key]) for key in keys),
            {
                name: law.terms.parameters[variables.parameters.index(of_law)]
                for name, of_law in zip(pattern.inside, order, strict=True)
            },
            {names_of[term]: place for term, place in forcing if names_of[term] in inputs},
            volume,
        )
    return None


def _inside(terms: Sequence[Term], variables: Variables) -> list[str]:
    """Return the parameters in terms."""
    used = frozenset[int]().union(*(term.columns() for term in terms))
    return [name for name in variables.parameters if variables.index(name) in used]


def _is_measured(law: Law, state: str) -> bool:
    """Return whether a state has a column of its name."""
    return state in law.observation.measured.measured and state not in law.observation.equations


def _volume(law: Law, state: str) -> tuple[int, str] | None:
    """Return the term of the parameter V, and the name of the dose, where a state begins at ``dose/V``."""
    start = law.observation.initial.get(state)
    parts = re.fullmatch(r"(\w+) */ *(\w+)", start) if isinstance(start, str) else None
    parameters = law.terms.variables.parameters
    if parts is None or parts[2] not in parameters or parts[1] not in property_names(law.properties):
        return None
    return law.terms.parameters[parameters.index(parts[2])], parts[1]


@cache
def _formula(text: str, names: tuple[str, ...]) -> str | None:
    """Return a formula over columns of these names, None if it has another name."""
    code, others = Equation(f"q = {text}", "q", -1, len("q =")).expression(Variables(names))
    return None if others else code


def _quantities_of(match: _Match, initial: Mapping[str, float]) -> Iterator[Quantity]:
    """Yield the quantities of a form that a law has."""
    form, support = match.pattern.form, match.law.support
    given = {f"{variable}0": initial[name] for variable, name in match.names.items() if name in initial}
    visited = match.law.provenance.domain.visited
    given |= {f"{variable}_max": visited.get(name, (0.0, 0.0))[1] for variable, name in match.names.items()}

    def function(formula: str, where: str, gain: _Place | None) -> Function | None:
        def values(rows: Floats) -> dict[str, Floats]:
            coefficients = np.zeros((len(rows), *support.shape))
            coefficients[:, support] = rows
            by_name = match.values(coefficients) | {name: np.full(len(rows), start) for name, start in given.items()}
            return by_name | ({"input": _value(coefficients, coefficients.sum(axis=1), gain)} if gain else {})

        names = tuple(values(np.ones((1, support.sum()))))
        code, condition = _formula(formula, names), _formula(where, names)
        if code is None or condition is None:
            return None

        def of(rows: Floats) -> Floats:
            columns = [*values(rows).values()]
            with np.errstate(all="ignore"):
                return np.where(evaluate(condition, columns) > 0, evaluate(code, columns), np.nan)

        return of

    for name, symbol, formula, unit, *where in form.quantities:
        gains = match.inputs.items() if "input" in formula else [("", None)]
        for source, place in gains:
            estimator = function(formula, where[0] if where else "1", place)
            if estimator is not None:
                known = _unit(match, unit, source)
                written = "" if known is None else f"{known:~P}"
                yield Quantity(f"{name} of {source}" if source else name, symbol, estimator, written)


def _may_have_units(match: _Match) -> bool:
    """Return whether units that are known have the dimensions that the form asks for: glucose has no terminal speed."""
    return all(
        (unit := _unit(match, text)) is None
        or unit.dimensionality in [parse_unit(name).dimensionality for name in units]
        for text, units in match.pattern.form.units.items()
    )


def _unit(match: _Match, text: str, source: str = "") -> "pint.Unit | None":
    """Return the unit of a product of variables of a form, None if it is unknown."""
    variables = Variables(tuple(dict.fromkeys([*re.findall(r"[A-Za-z]+", text), "t"]))[:-1] or ("x",))
    return term_unit(parse_term(text, variables), variables, _units(match, source))


def _units(match: _Match, source: str) -> dict[str, str]:
    """Return the units of the variables of a form, as far as they are known; u is an input of a gain."""
    names = {**match.names, "t": match.law.schema.time, "u": source}
    if match.volume:
        names["dose"] = match.volume[1]
    units = {**match.law.observation.measured.units, **match.law.schema.units}
    return {variable: units[name] for variable, name in names.items() if name in units}


def _most_specific(matches: Sequence[_Match]) -> list[_Match]:
    """Return the first of several ways to write a form, and none that another one says more of.

    That is a form of more equations, these among them, or one of the same terms with fewer parameters.
    """
    by_form = {(match.pattern.form.title, frozenset(match.equations)): match for match in reversed(matches)}

    def is_less(match: _Match, other: _Match) -> bool:
        here, there = ({*matched.equations} for matched in (match, other))
        fewer = len(other.unknown) < len(match.unknown) and len(other.pattern.entries) == len(match.pattern.entries)
        return here < there or (here == there and fewer)

    specific = [
        match for match in by_form.values() if not any(is_less(match, candidate) for candidate in by_form.values())
    ]
    return specific[::-1]


def _limited(function: Function, parameters: Parameters, o: int) -> Estimate | None:
    """Return a quantity of an object with its only limit, if it depends on one parameter that has only a limit.

    A monotonic quantity is on one side of its value at the limit of the parameter. One of several such parameters, as a
    ratio of both, may have two limits.
    """
    support, law, limited = parameters.law.support, parameters.law, list[Estimate]()
    for ends in parameters.beyond_limits(law.objects[o]):
        with np.errstate(all="ignore"):
            end, beyond = (float(function(coefficients[support][np.newaxis])[0]) for coefficients in ends)
        if np.isfinite(end) and not np.isclose(end, beyond, rtol=1e-6, atol=0.0):
            interval = (end, np.inf) if beyond > end else (-np.inf, end)
            limited.append(Estimate(float(function(law.coefficients[o, support][np.newaxis])[0]), np.nan, *interval))
    return limited[0] if len(limited) == 1 else None


def _differs(quantity: Quantity, parameters: Parameters, o: int) -> bool:
    """Return whether the symbol of a quantity is that of a parameter of another value."""
    if quantity.symbol not in parameters.names:
        return False
    law = parameters.law
    value = quantity.function(law.coefficients[o, law.support][np.newaxis])[0]
    return not np.isclose(value, parameters.values[o, parameters.names.index(quantity.symbol)], rtol=1e-6, atol=0.0)


def _as_parameter(parameters: Parameters, named: Sequence[Estimate], o: int, state: Estimate) -> Estimate:
    """Return the estimate of a state of rest of an object, that of the parameter that it is, as a carrying capacity."""
    values, errors = parameters.values[o], parameters.errors[o]
    same = np.isclose(values, state.value, rtol=1e-6, atol=0.0) & np.isclose(errors, state.error, rtol=1e-3, atol=0.0)
    places = np.flatnonzero(same & ~parameters.limited[o] & (values != 0))
    return named[places[0]] if len(places) else state


def quantity_frame(law: Law, level: float, initial: Mapping[str, float] | None) -> "pd.DataFrame":
    """Return what is quoted of the forms that a law has, and its equilibria, see `Law.quantities`."""
    import pandas as pd

    for name in initial or {}:
        check_choice("state", name, law.schema.states)
    reach = float(reach_of_equations(law, level).max())
    matches, known = _matches(law, _patterns()) if law.order != 0 else [], named_parameters(law)
    rows, tabulated = list[tuple[object, ...]](), (known.values, known.tabulated_errors, *known.intervals(level))
    is_solved = WITHOUT_QUANTITIES.isdisjoint(outcome.kind for outcome in law.diagnostics)
    for i, owner in enumerate(law.objects if law.order != 0 and is_solved else ()):
        parameters = law.coefficients[i, law.support]
        named = [Estimate(*row) for row in np.stack([numbers[i] for numbers in tabulated], axis=1).tolist()]
        covariance = None if known.covariance_given_limits is None else known.covariance_given_limits[i]
        specific = _most_specific([match for match in matches if match.holds(law.coefficients[[i]])])
        quantities = list[tuple[str, Quantity]]()
        for match in specific:
            by_form = [*_quantities_of(match, initial or {})]
            differing = {quantity.symbol for quantity in by_form if _differs(quantity, known, i)}
            if differing and match.pattern.form.measured:  # As V/F, where the law has V
                continue
            for quantity in by_form:
                symbol = "" if quantity.symbol in differing else quantity.symbol
                quantities.append((match.title, quantity._replace(name=quantity.name + match.part, symbol=symbol)))
        if not specific:
            quantities += [("Linear system", quantity) for quantity in modes(law, parameters)]
        for title, quantity in quantities:
            estimate = _limited(quantity.function, known, i) or propagated(
                quantity.function, parameters, covariance, reach
            )
            if quantity.symbol in known.names and not known.limited[i, p := known.names.index(quantity.symbol)]:
                estimate = named[p]
            if np.isfinite(estimate.value):
                rows.append((owner, title, quantity.name, quantity.symbol, *estimate, quantity.unit))
        points = [*equilibria(law, parameters, covariance, reach)]
        if len(points) == 1 and not points[0].states.any():  # The origin of an equation without a constant
            continue
        for number, point in enumerate(points, 1):
            name = f"equilibrium {number}, {point.kind}" if len(points) > 1 else f"equilibrium, {point.kind}"
            for state, value, error in zip(law.schema.states, point.states, point.errors, strict=True):
                ends = float(value - reach * error), float(value + reach * error)
                estimate = _as_parameter(known, named, i, Estimate(float(value), float(error), *ends))
                unit = law.schema.units.get(state, "")
                rows.append((owner, "Equilibria", name, f"{state}*", *estimate, unit))
    columns = ["object", "form", "quantity", "symbol", "estimate", "standard error", "low", "high", "unit"]
    return pd.DataFrame(rows, columns=columns)
