"""The unit of a term."""

from collections.abc import Mapping
from functools import reduce
from operator import mul
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.library.expression import Expression
from commonlaw.library.grammar import NUMPY, compiled
from commonlaw.library.monomial import Monomial
from commonlaw.library.product import Product
from commonlaw.library.term import AbstractTerm
from commonlaw.library.terms import Variables
from commonlaw.trials.units import check_unit, parse_unit, registry

if TYPE_CHECKING:
    import pint


def term_unit(term: AbstractTerm, variables: Variables, units: "Mapping[str, str | pint.Unit]") -> "pint.Unit | None":
    """Return the unit of a term, from the units of the variables in it.

    There is none (`None`) when a variable in the term has no unit in `units`, and when the term joins what cannot be
    joined: the sine of a length, a length added to a number.

    Parameters
    ----------
    term
        The term.
    variables
        What it is a function of.
    units
        Unit of a variable by its name, of pint or in a form that pint reads: ``"m/s^2"``.

    Raises
    ------
    CommonlawError
        If pint does not know a unit.

    Examples
    --------
    >>> from commonlaw.library import parse_term
    >>> variables = Variables(("x", "v"))
    >>> print(term_unit(parse_term("x*v^2", variables), variables, {"x": "m", "v": "m/s"}))
    meter ** 3 / second ** 2
    """
    names = {column: variables.names[column] for column in term.columns()}
    if not all(name in units for name in names.values()):
        return None
    return _unit(term, {column: _of_variable(name, units[name]) for column, name in names.items()})


def _of_variable(name: str, unit: "str | pint.Unit") -> "pint.Unit":
    return parse_unit(check_unit(unit, f"variable {name!r}")) if isinstance(unit, str) else unit


def _unit(term: AbstractTerm, units: Mapping[int, "pint.Unit"]) -> "pint.Unit | None":
    none = registry().dimensionless
    match term:
        case Monomial(exponents=exponents):
            return reduce(mul, (units[i] ** power for i, power in enumerate(exponents) if power), none)
        case Product(factors=factors, divisors=divisors):
            above, below = [_unit(each, units) for each in factors], [_unit(each, units) for each in divisors]
            if any(each is None for each in (*above, *below)):
                return None
            quotient: pint.Unit = reduce(mul, above, none) / reduce(mul, below, none)
            return quotient
        case Expression(code=code):
            return expression_unit(code, units)
    return none if all(units[i].dimensionless for i in term.columns()) else None


def expression_unit(code: str, units: Mapping[int, "pint.Unit"]) -> "pint.Unit | None":
    """Return the unit of an expression by computing it for quantities of these units."""
    import pint

    quantities = [registry().Quantity(np.ones(1), units.get(i)) for i in range(max(units) + 1)]
    try:
        with np.errstate(all="ignore"):
            return registry().Unit(registry().Quantity(compiled(code)(quantities, NUMPY)).units)
    except (pint.PintError, TypeError):
        return None
