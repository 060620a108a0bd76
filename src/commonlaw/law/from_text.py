"""From equations in a text to terms, coefficients that are known, and names of those that are not."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypedDict, Unpack

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.formulation import law_variables
from commonlaw.law.provenance import Provenance
from commonlaw.law.uncertainty import Uncertainty
from commonlaw.library import AbstractTerm, Terms, Variables
from commonlaw.library.equation import split_equations
from commonlaw.trials import Schema


class Coefficient(NamedTuple):
    """A coefficient by the name that a user knows it by: before the term stand a factor and a power of it.

    In ``x'' = -2 x/m`` the factor of m is -2 and the power is -1.
    """

    name: str
    equation: int
    term: int
    factor: float = 1.0
    power: int = 1

    def value(self, coefficient: Floats) -> Floats:
        """Return what the name stands for, from the whole number before the term; infinite where it divides by 0."""
        with np.errstate(divide="ignore"):
            return np.asarray((coefficient / self.factor) ** np.float64(self.power))

    def error(self, coefficient: Floats, error: Floats) -> Floats:
        """Return its standard error, to first order, from that of the whole number before the term."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.abs(self.value(coefficient) / coefficient) * error)


class Names(TypedDict, total=False):
    """What a `Schema` holds besides states, as far as laws know it."""

    inputs: tuple[str, ...]
    time: str
    units: Mapping[str, str]


class GivenEquations(NamedTuple):
    """What the text of equations says.

    `known` has the shape (equations, terms): the coefficients that are numbers, zero where there is no such term, NaN
    where one is to be found.
    """

    texts: tuple[str, ...]
    terms: Terms
    order: int
    known: Floats
    coefficients: tuple[Coefficient, ...]


def read_equations(texts: str | Sequence[str], schema: Schema, variables: Variables | None = None) -> GivenEquations:
    """Return what equations say about the states of a schema, in variables that follow from it if none are given.

    Raises
    ------
    CommonlawError
        If a text cannot be read, a state has no equation, or one coefficient stands before two terms.
    """
    equations = split_equations(texts)
    by_state = {each.state: each for each in equations}
    _check_states(tuple(by_state), schema)
    variables = variables or law_variables(schema, equations[0].order)
    state_rates = list(zip(schema.states, variables.states[len(schema.states) :], strict=False))
    rows = [by_state[state].summands(variables, state_rates) for state in schema.states]
    listed: list[AbstractTerm] = list(dict.fromkeys(each.term for row in rows for each in row))
    known = np.zeros((len(rows), len(listed)))
    coefficients = []
    for j, row in enumerate(rows):
        for each in row:
            k = listed.index(each.term)
            known[j, k] = each.factor if each.coefficient is None else np.nan
            if each.coefficient is not None:
                coefficients.append(Coefficient(each.coefficient, j, k, each.factor, each.power))
    _check_once([each.name for each in coefficients])
    ordered = tuple(by_state[state].text for state in schema.states)
    return GivenEquations(ordered, Terms(variables, tuple(listed)), equations[0].order, known, tuple(coefficients))


def stated_law(
    equations: str | Sequence[str], values: Mapping[str, float | Mapping[str, float]], **names: Unpack[Names]
) -> tuple[Terms, Schema, int, tuple[str, ...], Floats, Uncertainty, Provenance]:
    """Return what the law of equations is made of, all of whose coefficients have values, see `Law.from_text`."""
    schema = Schema(tuple(each.state for each in split_equations(equations)), **names)
    given = read_equations(equations, schema)
    letters = [each.name for each in given.coefficients]
    for name in values:
        check_choice("coefficient", name, letters)
    missing = [name for name in letters if name not in values]
    if missing:
        raise CommonlawError(
            f"the coefficients {', '.join(missing)} have no value: give values={{{missing[0]!r}: ...}}, or have them "
            "found in trials by commonlaw.fit"
        )
    by_object = [each for each in values.values() if isinstance(each, Mapping)]
    objects = tuple(dict.fromkeys(name for each in by_object for name in each)) or ("object",)
    coefficients = np.tile(given.known, (len(objects), 1, 1))
    for each in given.coefficients:
        value = values[each.name]
        own = value if isinstance(value, Mapping) else dict.fromkeys(objects, value)
        lacking = [name for name in objects if name not in own]
        if lacking:
            raise CommonlawError(f"the coefficient {each.name} has no value for {', '.join(lacking)}: give each one")
        with np.errstate(divide="ignore"):
            values_of = np.array([own[name] for name in objects], dtype=np.float64) ** each.power
        coefficients[:, each.equation, each.term] = each.factor * values_of
    provenance = Provenance(equations=given.texts)
    return given.terms, schema, given.order, objects, coefficients, Uncertainty(), provenance


def _check_states(given: tuple[str, ...], schema: Schema) -> None:
    missing = [name for name in schema.states if name not in given]
    others = [name for name in given if name not in schema.states]
    if missing or others:
        raise CommonlawError(
            f"the equations are of {', '.join(given)}, the states are {', '.join(schema.states)}: give each state one "
            "equation, and name columns that have none as inputs"
        )


def _check_once(names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise CommonlawError(
                f"the coefficient {name} stands before {names.count(name)} terms, and each term has one of its own: "
                "give them different names"
            )
