"""Units of what relations consist of: base dimensions, constants with a name, and what they say of a factor."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.hierarchy import Dimensions
from commonlaw.library import Order, Terms, order_of_each, term_unit, units_of_parameters, with_rates
from commonlaw.trials import Schema
from commonlaw.trials.headers import parse_unit, registry

if TYPE_CHECKING:
    import pint

CONSTANTS = {
    "a speed": "m/s",
    "an acceleration": "m/s^2",
    "a density": "kg/m^3",
    "a viscosity": "Pa s",
    "a kinematic viscosity or diffusivity": "m^2/s",
    "a surface tension or stiffness": "N/m",
    "a pressure or modulus": "Pa",
    "a heat transfer coefficient": "W/m^2/K",
    "a thermal conductivity": "W/m/K",
    "a specific heat": "J/kg/K",
    "a gravitational constant": "m^3/kg/s^2",
}
"""Constants that a factor may be, by their units."""


def dimensions_of(coefficients: Sequence[str | None], properties: Mapping[str, str]) -> Dimensions:
    """Return the base dimensions of coefficients and of properties, by the texts of their units."""
    units = [*(each for each in coefficients if each is not None), *properties.values(), *CONSTANTS.values()]
    bases = sorted({base for unit in units for base in parse_unit(unit).dimensionality})

    def powers(unit: str) -> Floats:
        own: Mapping[str, Any] = parse_unit(unit).dimensionality
        return np.array([own.get(base, 0) for base in bases], dtype=np.float64)

    return Dimensions(
        [None if each is None else powers(each) for each in coefficients],
        {name: powers(unit) for name, unit in properties.items()},
        np.array([powers(unit) for unit in CONSTANTS.values()]),
    )


def meaning(unit: str) -> str:
    """Return which constant has this unit; nothing if none has.

    >>> meaning("kg/m^3"), meaning("g/cm^3"), meaning("kg/s^7")
    ('a density', 'a density', '')
    """
    own = parse_unit(unit).dimensionality
    return next((name for name, each in CONSTANTS.items() if parse_unit(each).dimensionality == own), "")


def quotient_unit(unit: str, powers: Sequence[tuple[str, float]]) -> str:
    """Return a unit divided by powers of others, as short as it can be.

    >>> quotient_unit("1/s", [("ohm", -1.0), ("farad", -1.0)]), quotient_unit("1/m", [("m", 2.0), ("kg", -1.0)])
    ('1', 'kg/m³')
    """
    whole = parse_unit(unit)
    for other, power in powers:
        whole = whole / parse_unit(other) ** power
    size = registry().Quantity(1.0, whole).to_base_units().magnitude if whole.dimensionless else np.nan
    return "1" if abs(size - 1) < 1e-12 else f"{whole:~P}"


def is_number(unit: str) -> bool:
    """Return whether what has this unit is a number, such as ``m/km``."""
    return parse_unit(unit).dimensionless


def units_of_coefficients(
    terms: Terms, support: Bools, schema: Schema, order: Order
) -> "dict[tuple[int, int], pint.Unit]":
    """Return the unit of each coefficient in a support, shape (equations, terms), where those of variables tell it.

    A unit of a variable that is not known may cancel: k of ``x' = -k x`` has that of one over time, whatever x has. The
    unit of a coefficient is a product of powers of those of the variables; that of an unknown one is zero where
    the same comes out whatever takes its place. Variables that are added have one unit.
    """
    measured = (*schema.states, *schema.inputs, schema.time)
    known = {name: parse_unit(schema.units[name]) for name in measured if name in schema.units}
    if not known:
        return {}
    plain = {name: known.get(name, registry().dimensionless) for name in measured}
    some = {name: registry().Unit("candela") for name in measured if name not in known}
    added = {name: unit for name, unit in some.items() if name != schema.time}
    found, together, *alone = (
        _units_over(terms, support, schema, order, plain | given)
        for given in ({}, added, *({name: unit} for name, unit in some.items()))
    )
    return {key: unit for key, unit in found.items() if all(each.get(key, together.get(key)) == unit for each in alone)}


def _units_over(
    terms: Terms, support: Bools, schema: Schema, order: Order, units: "Mapping[str, pint.Unit]"
) -> "dict[tuple[int, int], pint.Unit]":
    """Return the same by the units of all measured variables."""
    states, found = schema.states, dict[tuple[int, int], "pint.Unit"]()
    time = units[schema.time]
    pairs = zip(terms.variables.states[len(states) :], with_rates(order, len(states)), strict=True)
    units = {**units, **{rate: units[states[j]] / time for rate, j in pairs}}
    orders = order_of_each(order, len(states))
    parameters = units_of_parameters(terms, units) if terms.parameters else {}
    units |= parameters
    for j, k in np.argwhere(support).tolist():
        name, below = terms.parameter_name(k), term_unit(terms.terms[k], terms.variables, units)
        if name in parameters:
            found[j, k] = parameters[name]
        elif name is None and below is not None:
            found[j, k] = units[states[j]] / time ** orders[j] / below
    return found
