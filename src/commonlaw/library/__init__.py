"""Candidate terms of a law, and the families that list them."""

from collections.abc import Callable
from functools import partial, reduce
from operator import add, mul

from commonlaw.errors import CommonlawError
from commonlaw.library.algebra import (
    AbstractLibrary,
    CappedLibrary,
    Offer,
    ProductLibrary,
    ReducedLibrary,
    SelectedLibrary,
    SumLibrary,
)
from commonlaw.library.constant import Constant
from commonlaw.library.expression import Expression
from commonlaw.library.families import (
    AutoLibrary,
    ConstantLibrary,
    ExpressionLibrary,
    FamilyLibrary,
    FourierLibrary,
    PolynomialLibrary,
    RatioLibrary,
    RationalLibrary,
)
from commonlaw.library.monomial import Monomial
from commonlaw.library.order import (
    Order,
    highest_columns,
    highest_order,
    one_order,
    order_of_each,
    split_derivatives,
    with_rates,
)
from commonlaw.library.parametric import FAMILIES, ParametricTerm, TiedTerms, parametric_term
from commonlaw.library.parse import parse_term, parse_terms
from commonlaw.library.product import Product
from commonlaw.library.ratio import Ratio, Ratios
from commonlaw.library.term import AbstractTerm
from commonlaw.library.terms import Terms, Variables
from commonlaw.library.trigonometric import Trigonometric
from commonlaw.library.units import term_unit
from commonlaw.library.units_of_constants import units_of_constants
from commonlaw.spec import parse_spec

__all__ = [
    "FAMILIES",
    "AbstractLibrary",
    "AbstractTerm",
    "AutoLibrary",
    "CappedLibrary",
    "Constant",
    "ConstantLibrary",
    "Expression",
    "ExpressionLibrary",
    "FamilyLibrary",
    "FourierLibrary",
    "Monomial",
    "Offer",
    "Order",
    "ParametricTerm",
    "PolynomialLibrary",
    "Product",
    "ProductLibrary",
    "Ratio",
    "RatioLibrary",
    "RationalLibrary",
    "Ratios",
    "ReducedLibrary",
    "SelectedLibrary",
    "SumLibrary",
    "Terms",
    "TiedTerms",
    "Trigonometric",
    "Variables",
    "highest_columns",
    "highest_order",
    "one_order",
    "order_of_each",
    "parametric_term",
    "parse_library",
    "parse_term",
    "parse_terms",
    "split_derivatives",
    "term_unit",
    "units_of_constants",
    "with_rates",
]


def parse_library(text: str) -> AbstractLibrary:
    """Return the library that a text names.

    Parameters
    ----------
    text
        ``poly:3``, ``fourier:2``, ``rational:2:1+x**2``, ``terms:1,v,v*abs(v)`` or ``constant``, a family of `FAMILIES`
        such as ``saturating``, or several of them joined by ``+`` and ``*`` with spaces around: ``poly:2 + fourier:1``,
        ``poly:1 * saturating:s``. Inside a library there are no such spaces, but for parentheses: ``terms:1+x``, not
        ``terms:1 + x``. ``ratio(poly:2, poly:2)`` are ratios of sums of terms of two libraries.
        Variables are listed with commas: ``poly:3:x,v``. Names in terms that are no variables are constants, which are
        found with the law: ``poly:1 + terms:s/(K+s)``. ``auto``: see `AutoLibrary`.

    Raises
    ------
    CommonlawError
        If there is no such library or its arguments do not fit.

    Examples
    --------
    >>> parse_library("poly:1 + terms:v*abs(v)").bind(Variables(("x", "v"))).names
    ('1', 'x', 'v', 'v*abs(v)')
    """
    makers: dict[str, Callable[..., AbstractLibrary]] = {
        "poly": PolynomialLibrary,
        "fourier": FourierLibrary,
        "rational": RationalLibrary,
        "terms": _listed,
        "constant": ConstantLibrary,
        "auto": AutoLibrary,
        **{name: partial(FamilyLibrary, name) for name in FAMILIES},
    }

    def one(part: str) -> AbstractLibrary:
        if not part.startswith("ratio("):
            return parse_spec("library", part, makers)
        sides = _pieces(part[len("ratio(") : -1], ",")
        if not part.endswith(")") or len(sides) != 2:
            raise CommonlawError("ratio-syntax", library=part)
        return RatioLibrary(*map(parse_library, sides))

    sums = [[one(each) for each in _pieces(part, " * ")] for part in _pieces(text, " + ")]
    return reduce(add, (reduce(mul, factors) for factors in sums))


def _listed(expressions: str) -> AbstractLibrary:
    """Return the library of expressions between commas."""
    return ExpressionLibrary(*_pieces(str(expressions), ","))


def _pieces(text: str, separator: str) -> list[str]:
    """Return what stands between separators; those in parentheses or backticks do not count."""
    pieces, depth, quoted, position = [""], 0, False, 0
    while position < len(text):
        if depth == 0 and not quoted and text.startswith(separator, position):
            pieces.append("")
            position += len(separator)
            continue
        each = text[position]
        quoted ^= each == "`"
        depth += 0 if quoted else (each == "(") - (each == ")")
        pieces[-1] += each
        position += 1
    return [each.strip() for each in pieces]
