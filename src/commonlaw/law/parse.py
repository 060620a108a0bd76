"""From equations in a text to terms, coefficients that are known, and names of those that are not."""

import ast
from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, TypedDict, Unpack

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.diagnostics import Diagnostic
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.formulation import law_variables, plain_rates
from commonlaw.law.observation import STEADY
from commonlaw.law.provenance import Provenance
from commonlaw.law.text import Addend
from commonlaw.law.uncertainty import Uncertainty
from commonlaw.library import Order, Term, Terms, Variables, one_order, with_rates
from commonlaw.library.bounds import Bound, bounds_in
from commonlaw.library.equation import Equation, Meanings, only_product, split_equations, with_parameters
from commonlaw.library.functions import Function
from commonlaw.library.grammar import write
from commonlaw.library.term import parse_term
from commonlaw.trials import Schema


class Part(NamedTuple):
    """A power of a coefficient of the law, divided by a number, as it stands in what a name means."""

    equation: int
    term: int
    factor: float = 1.0
    power: int = 1


class Coefficient(NamedTuple):
    """A coefficient by the name that a user knows it by, as a product of powers of coefficients of terms.

    In ``x'' = -2 x/m`` it is -2 over that of x. In ``T' = -k (T - a)``, multiplied out ``-k T + k a``, a is the
    coefficient of 1 over minus that of T. A parameter inside terms is the coefficient of its own, see
    `Terms.parameters`.
    """

    name: str
    parts: tuple[Part, ...]

    @property
    def equation(self) -> int:
        """The equation where it stands first."""
        return self.parts[0].equation

    @property
    def term(self) -> int:
        """The term that it stands before first."""
        return self.parts[0].term

    def value(self, wholes: Sequence[Floats]) -> Floats:
        """Return what the name stands for, from the whole number before each of its terms; infinite over 0."""
        result = np.ones_like(wholes[0])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for part, whole in zip(self.parts, wholes, strict=True):
                result = result * (whole / part.factor) ** np.float64(part.power)
        return np.asarray(result)

    def of(self, coefficients: Floats) -> Floats:
        """Return what it stands for, from coefficients whose last axes are equations and terms."""
        return self.value([coefficients[..., part.equation, part.term] for part in self.parts])

    def gradient(self, coefficients: Floats) -> Floats:
        """Return its derivatives by the coefficients of its parts, shape (objects, parts)."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            wholes = [coefficients[:, part.equation, part.term] for part in self.parts]
            shares = [part.power / whole for part, whole in zip(self.parts, wholes, strict=True)]
            return np.asarray(self.value(wholes)[:, np.newaxis] * np.stack(shares, axis=1))


class Product(NamedTuple):
    """What stands before a term: a number and coefficients with their powers of 1 or -1, by name."""

    equation: int
    term: int
    factor: float
    coefficients: tuple[tuple[str, int], ...]

    def value(self, values: Mapping[str, Floats]) -> Floats:
        """Return it, from values by name."""
        result = np.asarray(self.factor, dtype=np.float64)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for name, power in self.coefficients:
                result = result * np.asarray(values[name], dtype=np.float64) ** power
        return np.asarray(result)

    def slopes(self, values: Mapping[str, Floats]) -> dict[str, float]:
        """Return its derivatives by coefficients, by name."""
        result = dict.fromkeys((name for name, _ in self.coefficients), 0.0)
        for i, (name, power) in enumerate(self.coefficients):
            others = self._replace(coefficients=self.coefficients[:i] + self.coefficients[i + 1 :])
            result[name] += float(others.value(values)) * power * float(values[name]) ** (power - 1)
        return result


class Names(TypedDict, total=False):
    """What a `Schema` holds besides states, as far as laws know it."""

    inputs: tuple[str, ...]
    time: str
    units: Mapping[str, str]


class GivenEquations(NamedTuple):
    """What the text of equations says.

    `known` has the shape (equations, terms): coefficients that are numbers, zero without the term, NaN if to be found.
    """

    texts: tuple[str, ...]
    terms: Terms
    order: Order
    known: Floats
    coefficients: tuple[Coefficient, ...]
    products: tuple[Product, ...]
    bounds: tuple[Bound, ...] = ()


def read_equations(
    given: str | Sequence[str],
    schema: Schema,
    variables: Variables | None = None,
    properties: Sequence[str] = (),
    functions: tuple[Function, ...] = (),
    determined: Container[str] = (),
) -> GivenEquations:
    """Return what equations say about the states of a schema, in variables that follow from it if none are given.

    A property of the objects that stands before a term with other names, as K in ``r x (1 - x/K)``, is a parameter
    inside this term, and so are names of which the equations give only a product if more determines them, such as a
    prior. Terms may call functions of Python.
    """
    equations = split_equations(given)
    by_state = {equation.state: equation for equation in equations}
    missing = [name for name in schema.states if name not in by_state]
    others = [name for name in by_state if name not in schema.states]
    if missing or others:
        remedy = Diagnostic("equation-or-input", {"inputs": missing})
        if schema.wide and len(others) == 1:
            remedy = Diagnostic("columns-of-objects", {"name": others[0]})
        raise CommonlawError("equations-of-other-states", equations=(*by_state,), states=schema.states, remedy=remedy)
    ordered = tuple(by_state[state] for state in schema.states)
    order = one_order([equation.order for equation in ordered])
    plain = variables or replace(law_variables(schema, order), functions=functions)
    # Those of a law that was read before, perhaps by an earlier version, are clear
    meanings = meanings_of(schema, order, plain, are_clear=variables is not None)
    variables = with_parameters(plain, ordered, meanings)
    while True:
        rows = [equation.summands(variables, meanings) for equation in ordered]
        listed = list(dict.fromkeys(summand.term for row in rows for summand in row)) or [parse_term("1", variables)]
        products = [
            Product(j, listed.index(summand.term), summand.factor, summand.coefficients)
            for j, row in enumerate(rows)
            for summand in row
            if summand.coefficients
        ]
        together = [name for product in products if len(product.coefficients) > 1 for name, _ in product.coefficients]
        if inside := [name for name in dict.fromkeys(together) if name in properties]:
            variables = replace(variables, parameters=(*variables.parameters, *inside))
            continue
        coefficients = _solved(products)
        if coefficients is not None and not any(len({summand.term for summand in row}) < len(row) for row in rows):
            break
        # What stands before several terms is one number all the same: a constant of these
        names = [name for product in products for name, _ in product.coefficients]
        shared = [name for name in dict.fromkeys(names) if names.count(name) > 1 and len(products) > len({*names})]
        shared = shared or [name for name in dict.fromkeys(together) if name in determined]
        if not shared:
            for equation, row in zip(ordered, rows, strict=True):
                equation.check_apart(row, variables, meanings)
            product = next(product for product in products if len(product.coefficients) > 1)
            problem = only_product(product.coefficients)
            ordered[product.equation].refuse(product.coefficients[1][0], problem, variables, meanings)
        variables = replace(variables, parameters=(*variables.parameters, *shared))
    known = np.zeros((len(rows), len(listed)))
    for j, row in enumerate(rows):
        for summand in row:
            known[j, listed.index(summand.term)] = np.nan if summand.coefficients else summand.factor
    used = [frozenset().union(*(summand.term.columns() for summand in row)) for row in rows]
    columns = {name: variables.index(name) for name in variables.parameters}
    # The first equation in whose terms each parameter stands
    owners = {name: next((j for j, indices in enumerate(used) if i in indices), 0) for name, i in columns.items()}
    inner = [Product(j, len(listed) + i, 1.0, ((name, 1),)) for i, (name, j) in enumerate(owners.items())]
    coefficients += tuple(
        Coefficient(name, (Part(product.equation, product.term),)) for name, product in zip(owners, inner, strict=True)
    )
    known = np.column_stack([known, *(np.where(np.arange(len(rows)) == j, np.nan, 0.0) for j in owners.values())])
    terms = Terms(variables, (*listed, *(Term(parameter=variables.index(name)) for name in owners)))
    texts = tuple(equation.text for equation in ordered)
    bounds = bounds_in(given)
    for bound in bounds:
        check_choice("coefficient", bound.name, [coefficient.name for coefficient in coefficients])
    return GivenEquations(texts, terms, order, known, coefficients, (*products, *inner), bounds)


def latex_summands(
    given: Sequence[str], schema: Schema, variables: Variables, observed: Mapping[str, str]
) -> tuple[tuple[Addend, ...], ...]:
    """Return the summands of the equations of a law in LaTeX, as they are written.

    Those of observation equations, by name, follow.
    """
    equations = split_equations(given)
    order = one_order([equation.order for equation in equations])
    meanings = meanings_of(schema, order, variables, are_clear=True)
    written = (*equations, *(observation_equation(name, right) for name, right in observed.items()))
    rows = (
        ((False, rf"\text{{{equation.right_hand_side}}}"),)
        if STEADY.fullmatch(equation.right_hand_side)
        else equation.latex(variables, meanings)
        for equation in written
    )
    return tuple(tuple(Addend(negative, "", latex) for negative, latex in row) for row in rows)


def observation_equation(name: str, right: str) -> Equation:
    """Return the equation of a measured quantity, or of an initial value, which gives no derivative."""
    return Equation(f"{name} = {right}", name, -1, len(name) + 2)


def event_equations(
    events: Mapping[str, Mapping[str, str]], meanings: Meanings
) -> tuple[tuple[Equation, Mapping[str, Equation]], ...]:
    """Return of each event, see `Observation`, the equation that is one where its condition is true, and new values."""
    rate_of = {f"{state}'": rate for state, rate in meanings.rates.items()}
    return tuple(
        (
            observation_equation("event", condition),
            {rate_of.get(name, name): observation_equation(name, new) for name, new in changes.items()},
        )
        for condition, changes in events.items()
    )


def event_expressions(
    events: Sequence[tuple[Equation, Mapping[str, Equation]]], variables: Variables, meanings: Meanings
) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return what is positive where the condition of each event is true, and the states and rates after it.

    They are expressions over columns, see `Equation.expression`; raises `CommonlawError` if a condition is none.
    """
    expressions = list[tuple[str, tuple[str, ...]]]()
    for condition, changes in events:
        match ast.parse(condition.expression(variables, meanings)[0], mode="eval").body:
            case ast.UnaryOp(ast.UAdd(), ast.Call(ast.Name("step"), [decided])):
                new = {name: change.expression(variables, meanings)[0] for name, change in changes.items()}
                after = tuple(new.get(name, f"v{j}") for j, name in enumerate(variables.states))
                expressions.append((write(decided), after))
            case _:
                raise CommonlawError("equation-event-syntax", text=condition.right_hand_side)
    return tuple(expressions)


def meanings_of(schema: Schema, order: Order, variables: Variables, are_clear: bool = False) -> Meanings:
    """Return what names in equations mean that are no variables, and, unless all are clear, which mean two things."""
    second = with_rates(order, len(schema.states)).tolist()
    rates = dict(zip((schema.states[j] for j in second), variables.states[len(schema.states) :], strict=False))
    others = {name: schema.time for name in ("t", "time") if name not in (schema.time, *schema.states, *schema.inputs)}
    measured, unclear = (*schema.states, *schema.inputs), dict[str, Diagnostic]()
    if "e" not in (*measured, schema.time):
        unclear["e"] = Diagnostic("letter-e")
    plain = plain_rates(schema)
    for j in second:
        if plain[j] in measured:
            names = {"name": plain[j], "state": schema.states[j], "quoted": f"`{plain[j]}`"}
            unclear[plain[j]] = Diagnostic("rate-or-column", names)
    return Meanings(others, {} if are_clear else unclear, rates)


def _solved(products: Sequence[Product]) -> tuple[Coefficient, ...] | None:
    """Return the named coefficients by the coefficients of terms, none if these do not determine them one by one."""
    names = list(dict.fromkeys(name for product in products for name, _ in product.coefficients))
    powers = np.array(
        [[dict(product.coefficients).get(name, 0) for name in names] for product in products], dtype=np.float64
    )
    if len(names) != len(products) or (names and not np.isclose(abs(np.linalg.det(powers)), 1.0)):
        return None
    inverse = np.rint(np.linalg.inv(powers)).astype(int) if names else np.empty((0, 0), dtype=int)
    return tuple(
        Coefficient(
            name,
            tuple(
                Part(product.equation, product.term, product.factor, power)
                for product, power in zip(products, row, strict=True)
                if power
            ),
        )
        for name, row in zip(names, inverse.tolist(), strict=True)
    )


def stated_law(
    equations: str | Sequence[str], values: Mapping[str, float | Mapping[str, float]], **names: Unpack[Names]
) -> tuple[Terms, Schema, Order, tuple[str, ...], Floats, Uncertainty, Provenance]:
    """Return what the law of equations is made of, all of whose coefficients have values, see `Law.from_text`."""
    schema = Schema(tuple(equation.state for equation in split_equations(equations)), **names)
    given = read_equations(equations, schema)
    parameters = [coefficient.name for coefficient in given.coefficients]
    for name in values:
        check_choice("coefficient", name, parameters)
    missing = [name for name in parameters if name not in values]
    if missing:
        raise CommonlawError("parameter-values-missing", parameters=missing, first=missing[0])
    by_object = [value for value in values.values() if isinstance(value, Mapping)]
    objects = tuple(dict.fromkeys(name for value in by_object for name in value)) or ("object",)
    coefficients = np.tile(given.known, (len(objects), 1, 1))
    by_name = dict[str, Floats]()
    for name in parameters:
        given_values = values[name]
        numbers = given_values if isinstance(given_values, Mapping) else dict.fromkeys(objects, given_values)
        if missing := [owner for owner in objects if owner not in numbers]:
            raise CommonlawError("parameter-value-of-objects", name=name, objects=missing)
        by_name[name] = np.array([numbers[owner] for owner in objects], dtype=np.float64)
    for product in given.products:
        coefficients[:, product.equation, product.term] = product.value(by_name)
    for bound in given.bounds:
        if not bound.holds(by_name[bound.name]):
            raise CommonlawError("parameter-out-of-bounds", name=bound.name, bound=bound.text)
    provenance = Provenance(equations=given.texts)
    return given.terms, schema, given.order, objects, coefficients, Uncertainty(), provenance
