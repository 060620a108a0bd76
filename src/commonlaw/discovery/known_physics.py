"""Known physics as a base of a law: equations as text, another law, or a function of Python."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.discovery.method import Known
from commonlaw.errors import CommonlawError
from commonlaw.formulation import law_variables
from commonlaw.law import Law, Provenance, Uncertainty
from commonlaw.law.law import object_index
from commonlaw.law.parse import GivenEquations, read_equations
from commonlaw.law.population import with_objects_of
from commonlaw.law.restrictions import Restrictions
from commonlaw.law.text import left_hand_sides, order_in_words
from commonlaw.library import AbstractLibrary, ExpressionLibrary, Order
from commonlaw.library.expansion import summands, traced
from commonlaw.trials import Trials
from commonlaw.trials.transformations import number_of
from commonlaw.trials.trial import property_names

Base = Known | str | Law | Callable[..., Any]
"""What is known of a law: coefficients by term, equations with numbers, a law, or a function of variables and
properties that gives the highest derivatives."""

Numbers = dict[tuple[str, str], dict[str, float]]
"""Known coefficients by state and term, and by object."""


def with_base(library: AbstractLibrary, base: Base, order: Order, trials: Trials) -> tuple[AbstractLibrary, Known]:
    """Return a library with the terms of what is known, and their coefficients.

    Raises `CommonlawError` if what is known cannot be read, is of another order or other states, or lacks a property.
    """
    if isinstance(base, Mapping):
        return library, base
    if isinstance(base, Law):
        numbers = _of_law(base, order, trials)
    elif callable(base):
        numbers = _of_function(base, order, trials)
    else:
        numbers = _of_text(base, order, trials)
    texts = list(dict.fromkeys(term for _, term in numbers))
    if not texts:
        raise CommonlawError("known-physics-empty")
    variables = law_variables(trials.schema, order)
    whole = Numbers()
    for (state, text), values in numbers.items():
        (term,) = ExpressionLibrary(text).bind(variables).names
        by_object = whole.setdefault((state, term), dict.fromkeys(trials.objects, 0.0))
        for name, value in values.items():
            by_object[name] += value
    return library + ExpressionLibrary(*texts), dict(whole.items())


def order_of_base(base: str | Law | Callable[..., Any], trials: Trials) -> Order:
    """Return the order of the law that known physics is a part of.

    Raises `CommonlawError` if it does not say that, or cannot be read.
    """
    if isinstance(base, Law):
        return base.order
    if isinstance(base, str) and "=" in base:
        return read_equations(base, trials.schema).order
    raise CommonlawError("known-physics-order-missing")


def _of_law(law: Law, order: Order, trials: Trials) -> Numbers:
    states = trials.schema.states
    if law.order != order or law.schema.states != states:
        known_order, sought = order_in_words(law.order, law.schema.states), order_in_words(order, states)
        raise CommonlawError(
            "known-physics-order", order=known_order, known_states=law.schema.states, sought=sought, states=states
        )
    rates = [k for k, term in enumerate(law.terms.terms) if term.parameter is None]
    if any(column >= len(law.terms.variables.measured) for k in rates for column in law.terms.terms[k].columns()):
        raise CommonlawError("known-physics-parameters")
    law, names = with_objects_of(law, trials)[0], law.terms.variables.names
    return {
        (state, law.terms.terms[k].expression(names)): {
            name: float(law.coefficients[object_index(law, name)][j, k]) for name in trials.objects
        }
        for j, state in enumerate(law.schema.states)
        for k in rates
        if law.support[j, k]
    }


def _of_text(text: str, order: Order, trials: Trials) -> Numbers:
    schema = trials.schema
    if "=" not in text and len(schema.states) == 1:
        text = f"{left_hand_sides(schema.states, order)[0]} = {text}"
    given = read_equations(text, schema)
    if given.terms.parameters:
        raise CommonlawError(
            "known-physics-variables",
            parameters=given.terms.variables.parameters,
            variables=given.terms.variables.measured,
        )
    if given.order != order:
        both = [order_in_words(stated, schema.states) for stated in (given.order, order)]
        raise CommonlawError("known-physics-order-given", order=both[0], sought=both[1])
    for name in (name for product in given.products for name, _ in product.coefficients):
        for owner in trials.objects:
            _property_of(trials, owner, name)  # Other names have no number
    numbers, names = known_coefficients(given, trials), given.terms.variables.names
    return {
        (schema.states[j], given.terms.terms[k].expression(names)): dict(
            zip(trials.objects, numbers[:, j, k].tolist(), strict=True)
        )
        for j, k in np.argwhere(numbers.any(axis=0)).tolist()
    }


def known_coefficients(given: GivenEquations, trials: Trials) -> Floats:
    """Return coefficients that are known, shape (objects, equations, terms), NaN where one is to be found.

    They are numbers, or the objects' properties.
    """
    result, properties = np.tile(given.known, (len(trials.objects), 1, 1)), property_names(trials.properties)
    for product in given.products:
        names = [name for name, _ in product.coefficients]
        if names and all(name in properties for name in names):
            values = {name: np.array([number_of(name, owner, trials) for owner in trials.objects]) for name in names}
            result[:, product.equation, product.term] = product.value(values)
    return result


def _of_function(function: Callable[..., Any], order: Order, trials: Trials) -> Numbers:
    schema, names = trials.schema, law_variables(trials.schema, order).names
    numbers = Numbers()
    for owner in trials.objects:
        wanted = inspect.signature(function).parameters
        values = {name: None if name in names else _property_of(trials, owner, name) for name in wanted}
        for state, result in zip(schema.states, _by_state(traced(function, values), schema.states), strict=True):
            for number, term in summands(result, names):
                by_object = numbers.setdefault((state, term), {})
                by_object[owner] = by_object.get(owner, 0.0) + number
    return numbers


def _by_state(result: Any, states: Sequence[str]) -> Iterable[Any]:
    if len(states) == 1:
        return [result]
    if not isinstance(result, Sequence) or len(result) != len(states):
        raise CommonlawError("known-function-size", states=states)
    return result


def _property_of(trials: Trials, owner: str, name: str) -> float:
    value = trials.properties.get(owner, {}).get(name)
    if isinstance(value, float):
        return value
    known = ", ".join((*law_variables(trials.schema, 2).names, *property_names(trials.properties)))
    raise CommonlawError("known-physics-names", name=name, object=owner, known=known)


def unfitted(given: GivenEquations, trials: Trials, provenance: Provenance, restrictions: Restrictions) -> Law:
    """Return the law of given equations; coefficients that are to be found are 1 or -1, and only they have an error.

    They have the signs of the text.
    """
    known = known_coefficients(given, trials)
    signs = np.ones(known.shape[1:])
    for product in given.products:
        signs[product.equation, product.term] = np.sign(product.factor)
    coefficients = np.where(np.isnan(known), signs, known)
    uncertainty = unit_uncertainty(np.isnan(known)[:, np.any(coefficients != 0, axis=0)])
    return Law(
        given.terms,
        trials.schema,
        given.order,
        trials.objects,
        coefficients,
        uncertainty,
        provenance=provenance,
        restrictions=restrictions,
    )


def unit_uncertainty(free: Bools) -> Uncertainty:
    """Return a standard error of one for free coefficients, shape (objects, parameters), and of zero for others."""
    return Uncertainty(free[:, :, np.newaxis] * np.eye(free.shape[1]))
