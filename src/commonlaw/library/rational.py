"""Monomials over a given denominator."""

from collections.abc import Sequence
from dataclasses import dataclass

from commonlaw.library.algebra import AbstractLibrary
from commonlaw.library.monomial import Monomial
from commonlaw.library.parse import parse_term
from commonlaw.library.polynomial import check_degree, monomials
from commonlaw.library.product import multiply, multiply_powers
from commonlaw.library.terms import Terms
from commonlaw.library.variables import Variables, checked_names


@dataclass(frozen=True)
class RationalLibrary(AbstractLibrary):
    """All monomials up to a degree, each divided by the same expression.

    Parameters
    ----------
    degree
        The highest degree of the numerators.
    denominator
        An expression: ``"1 + x^2"``.
    variables
        Names of the variables of the numerators; without them all states (and rates) and inputs, but not time.

    Raises
    ------
    CommonlawError
        If the degree is no whole number from 0 to 100, or a variable is named twice.

    Examples
    --------
    >>> RationalLibrary(1, "1 + x^2").bind(Variables(("x",))).names
    ('1/(1 + x^2)', 'x/(1 + x^2)')
    """

    degree: int
    denominator: str
    variables: Sequence[str] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "variables", checked_names(self.variables))
        object.__setattr__(self, "denominator", str(self.denominator))
        check_degree(self.degree)

    def bind(self, variables: Variables) -> Terms:
        """Return the quotients.

        Raises
        ------
        CommonlawError
            If a variable is not there, or the denominator cannot be read.
        """
        columns, size = variables.columns(self.variables), len(variables.names)
        above = [Monomial(each) for each in monomials(columns, size, self.degree)]
        inverse = multiply_powers({parse_term(self.denominator, variables): -1}, size)
        return Terms(variables, tuple(multiply((each, inverse), size) for each in above))
