"""Relations of coefficients to properties of objects, their exponents, and the units of both."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from functools import cache
from itertools import combinations, product
from typing import TYPE_CHECKING, Any

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.library import Order, Terms, order_of_each, term_unit, units_of_parameters, with_rates
from commonlaw.trials import Schema
from commonlaw.trials.headers import known_unit, parse_unit, registry

if TYPE_CHECKING:
    import pint


_MAX_BITS = (9, 12, 10)
"""Largest cost in bits of the exponents of one, two and three properties together; more properties are not tried."""

MAX_DENOMINATOR = 4
"""Of exponents."""

ONE_MORE = 0.5
"""How probable one more property is."""


@dataclass(frozen=True, eq=False)
class ExponentSets:
    """Sets of exponents, and how probable each is before anything is measured, among all.

    Exponents have the shape (sets, properties), the logarithms of the probabilities (sets,).
    """

    exponents: Floats
    log_prior: Floats


@cache
def exponent_sets(properties: int, most: int) -> ExponentSets:
    """Return the sets of exponents of so many properties, at most so many of them not zero.

    An exponent p/q, of at most 4, costs p + q bits, so that simple ones are more probable. Sets of the same number of
    properties share one probability, whichever these are: the more properties are offered, the less probable is each.
    """
    fractions = {Fraction(p, q) for q in range(1, MAX_DENOMINATOR + 1) for p in range(1, 4 * q + 1)}
    costs = [(fraction.numerator + fraction.denominator, float(fraction)) for fraction in sorted(fractions)]
    signed = [(bits, sign * value) for bits, value in costs if bits <= _MAX_BITS[0] for sign in (1, -1)]
    bits, values = np.array(signed).T
    norm = np.log2(np.sum(2.0**-bits))
    exponents, log_prior = [np.empty((0, properties))], [np.empty(0)]
    for size in range(1, min(most, properties, len(_MAX_BITS)) + 1):
        limit = _MAX_BITS[size - 1]
        few = bits <= limit - 2 * (size - 1)
        indices = np.array(list(product(np.flatnonzero(few), repeat=size)))
        cost = bits[indices].sum(axis=1)
        indices, cost = indices[cost <= limit], cost[cost <= limit]
        chosen = list(combinations(range(properties), size))
        if len(chosen) * len(indices) > 200_000:  # Three of more than ten properties, or two of more than 25
            break
        for columns in chosen:
            rows = np.zeros((len(indices), properties))
            rows[:, columns] = values[indices]
            exponents.append(rows)
            log_prior.append(np.log(2) * -(cost + size * norm) + (size - 1) * np.log(ONE_MORE) - np.log(len(chosen)))
    weights = np.concatenate(log_prior)
    total = np.logaddexp.reduce(weights) if len(weights) else 0.0
    return ExponentSets(np.concatenate(exponents), weights - total)


class RelationKind(StrEnum):
    """What decides a coefficient; each is also its text."""

    UNIVERSAL = "universal"
    """It is the same for all objects."""
    POWER_LAW = "power law"
    """It is a factor times powers of properties."""
    AFFINE = "affine"
    """It is a number and properties times numbers: for coefficients whose sign is not that of all."""
    OWN = "own"
    """It is each object's own, about a typical value."""


@dataclass(frozen=True)
class Relation:
    """The model of one coefficient over objects.

    Parameters
    ----------
    kind
        What the coefficient depends on.
    factors, errors
        The factor C of ``C p^a q^b``, the shared or the typical value, or constant and slopes of an affine function;
        and their standard errors.
    properties, exponents
        Those that it depends on, and in a power law their exponents.
    scatter, scatter_error
        Standard deviation over objects of the coefficient's logarithm, or if the scatter is not relative, of the
        coefficient itself (in a power law at the typical object, elsewhere in proportion), and its standard error.
    relative
        Whether the scatter is that of the logarithm.
    probability
        Posterior probability among the relations that were compared.
    typical
        Product of the powers of the properties at their geometric means: 1 without any.
    """

    kind: RelationKind
    factors: tuple[float, ...]
    errors: tuple[float, ...]
    properties: tuple[str, ...] = ()
    exponents: tuple[Fraction, ...] = ()
    scatter: float = 0.0
    scatter_error: float = 0.0
    relative: bool = True
    probability: float = 1.0
    typical: float = 1.0

    def columns(self, values: Floats) -> Floats:
        """Return the regressors of the factors, shape (objects, factors), from values of `properties`."""
        ones = np.ones((len(values), 1))
        if self.kind is RelationKind.AFFINE:
            return np.concatenate([ones, values], axis=1)
        powers = np.prod(values ** np.array([float(exponent) for exponent in self.exponents]), axis=1, keepdims=True)
        return np.asarray(ones * powers)


@dataclass(frozen=True, eq=False)
class Dimensions:
    """Exponents of base dimensions (length, time, mass, ...), as far as they are known.

    Of each coefficient, shape (dimensions,) or None, of properties by name, and of physical constants, shape
    (constants, dimensions).
    """

    coefficients: Sequence[Floats | None]
    properties: Mapping[str, Floats]
    constants: Floats

    def log_odds(self, index: int, names: Sequence[str], exponents: Floats) -> Floats:
        """Return the logarithms of how much more probable sets of exponents of these properties are, shape (sets,).

        Ten times, if they leave a factor without a unit, and three times, if it has that of a known constant.
        """
        dimension = self.coefficients[index]
        if dimension is None:
            return np.zeros(len(exponents))
        known, none = np.array([name in self.properties for name in names], dtype=np.bool_), np.zeros_like(dimension)
        used = np.array([self.properties.get(name, none) for name in names]).reshape(len(names), len(dimension))
        rest = dimension - exponents @ used
        constant = np.any([_same(rest, constant) for constant in self.constants], axis=0)
        odds = np.where(_same(rest, none), np.log(10), np.where(constant, np.log(3), 0.0))
        return np.where((exponents[:, ~known] != 0).any(axis=1), 0.0, odds)


def _same(left: Floats, right: Floats) -> Bools:
    return np.asarray(abs(left - right).max(axis=1, initial=0.0) < 1e-9)


@dataclass(frozen=True, eq=False)
class PropertyTable:
    """Numbers that objects carry: names of the properties, values of shape (objects, properties), known dimensions."""

    names: tuple[str, ...]
    values: Floats
    dimensions: Dimensions | None = None

    @property
    def varying(self) -> "PropertyTable":
        """Those that differ between objects; others explain nothing."""
        return self.choose([i for i, column in enumerate(self.values.T) if np.ptp(column) > 0])

    def choose(self, indices: Sequence[int]) -> "PropertyTable":
        """Return some of them."""
        return PropertyTable(tuple(self.names[i] for i in indices), self.values[:, list(indices)], self.dimensions)

    @property
    def standardized(self) -> Floats:
        """Their values in standard deviations from the means over objects."""
        return np.asarray((self.values - self.values.mean(axis=0)) / self.values.std(axis=0))


CONSTANTS = {
    "a speed": "m/s",
    "an acceleration": "m/s^2",
    "a density": "kg/m^3",
    "a viscosity": "Pa s",
    "a kinematic viscosity or diffusivity": "m^2/s",
    "a surface tension or stiffness": "N/m",
    "a damping coefficient or mass flow": "kg/s",
    "a pressure or modulus": "Pa",
    "a heat transfer coefficient": "W/m^2/K",
    "a thermal conductivity": "W/m/K",
    "a specific heat": "J/kg/K",
    "a gravitational constant": "m^3/kg/s^2",
}
"""Constants that a factor may be, by their units."""


def dimensions_of(coefficients: Sequence[str | None], properties: Mapping[str, str]) -> Dimensions | None:
    """Return the base dimensions of coefficients and of properties, by the texts of their units.

    None if no coefficient has a unit, where those of the others say nothing.
    """
    if all(coefficient is None for coefficient in coefficients):
        return None
    units = [*filter(None, coefficients), *properties.values(), *CONSTANTS.values()]
    bases = sorted({base for unit in units for base in parse_unit(unit).dimensionality})

    def powers(unit: str) -> Floats:
        dimension: Mapping[str, Any] = parse_unit(unit).dimensionality
        return np.array([dimension.get(base, 0) for base in bases], dtype=np.float64)

    return Dimensions(
        [None if coefficient is None else powers(coefficient) for coefficient in coefficients],
        {name: powers(unit) for name, unit in properties.items()},
        np.array([powers(unit) for unit in CONSTANTS.values()]),
    )


def meaning(unit: str) -> str:
    """Return which constant has this unit; nothing if none has.

    >>> meaning("kg/m^3"), meaning("g/cm^3"), meaning("kg/s^7")
    ('a density', 'a density', '')
    """
    dimension = parse_unit(unit).dimensionality
    return next((name for name, constant in CONSTANTS.items() if parse_unit(constant).dimensionality == dimension), "")


def quotient_unit(unit: str, powers: Sequence[tuple[str, float]]) -> str:
    """Return a unit divided by powers of others, as short as it can be.

    >>> quotient_unit("1/s", [("ohm", -1.0), ("farad", -1.0)]), quotient_unit("1/m", [("m", 2.0), ("kg", -1.0)])
    ('1', 'kg/m³')
    """
    whole = parse_unit(unit)
    for divisor, power in powers:
        whole = whole / parse_unit(divisor) ** power
    size = registry().Quantity(1.0, whole).to_base_units().magnitude if whole.dimensionless else np.nan
    return "1" if abs(size - 1) < 1e-12 else f"{whole:~P}"


def units_of_coefficients(
    terms: Terms, support: Bools, schema: Schema, order: Order
) -> "dict[tuple[int, int], pint.Unit]":
    """Return the unit of each coefficient in a support, shape (equations, terms), where those of variables tell it.

    A unit of a variable that is not known may cancel: k of ``x' = -k x`` has that of one over time, whatever x has. The
    unit of a coefficient is a product of powers of those of the variables; that of an unknown one is zero where
    the same comes out whatever takes its place. Variables that are added have one unit.
    """
    measured = (*schema.states, *schema.inputs, schema.time)
    # A text that is no unit, as in the file of a law, is shown and not computed with
    parsed = {name: known_unit(text or "1") for name, text in schema.units.items() if name in measured}
    known = {name: unit for name, unit in parsed.items() if unit is not None}
    if not known:
        return {}
    plain = {name: known.get(name, registry().dimensionless) for name in measured}
    some = {name: registry().Unit("candela") for name in measured if name not in known}
    added = {name: unit for name, unit in some.items() if name != schema.time}
    units, together, *alone = (
        _units_over(terms, support, schema, order, plain | given)
        for given in ({}, added, *({name: unit} for name, unit in some.items()))
    )
    return {key: unit for key, unit in units.items() if all(case.get(key, together.get(key)) == unit for case in alone)}


def _units_over(
    terms: Terms, support: Bools, schema: Schema, order: Order, units: "Mapping[str, pint.Unit]"
) -> "dict[tuple[int, int], pint.Unit]":
    """Return the same by the units of all measured variables."""
    states, result = schema.states, dict[tuple[int, int], "pint.Unit"]()
    time = units[schema.time]
    pairs = zip(terms.variables.states[len(states) :], with_rates(order, len(states)), strict=True)
    units = {**units, **{rate: units[states[j]] / time for rate, j in pairs}}
    orders = order_of_each(order, len(states))
    parameters = units_of_parameters(terms, units) if terms.parameters else {}
    units |= parameters
    for j, k in np.argwhere(support).tolist():
        name, below = terms.parameter_name(k), term_unit(terms.terms[k], terms.variables, units)
        if name in parameters:
            result[j, k] = parameters[name]
        elif name is None and below is not None:
            result[j, k] = units[states[j]] / time ** orders[j] / below
    return result
