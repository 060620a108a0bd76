"""All monomials up to a degree."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

from commonlaw.errors import CommonlawError
from commonlaw.library.algebra import AbstractLibrary
from commonlaw.library.grammar import HIGHEST_POWER
from commonlaw.library.monomial import Monomial
from commonlaw.library.terms import Terms
from commonlaw.library.variables import Variables, checked_names
from commonlaw.validation import check_whole_number

_MOST_TERMS = 100_000


@dataclass(frozen=True)
class PolynomialLibrary(AbstractLibrary):
    """All monomials up to a degree, lower degrees first: 1, x, v, x^2, x v, v^2, x^3, ...

    Parameters
    ----------
    degree
        The highest degree.
    variables
        Names of the variables; without them all states (and rates) and inputs, but not time.
    constant
        Whether the constant term 1 is in.
    interactions
        Whether products of different variables are in.

    Raises
    ------
    CommonlawError
        If the degree is no whole number from 0 to 100, no term is left, or a variable is named twice.

    Examples
    --------
    >>> PolynomialLibrary(2).bind(Variables(("x", "v"))).names
    ('1', 'x', 'v', 'x^2', 'x v', 'v^2')
    """

    degree: int = 2
    variables: Sequence[str] | None = None
    constant: bool = True
    interactions: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "variables", checked_names(self.variables))
        check_degree(self.degree)
        if self.degree == 0 and not self.constant:
            raise CommonlawError("a polynomial of degree 0 without its constant has no terms: raise the degree")

    def bind(self, variables: Variables) -> Terms:
        """Return the monomials.

        Raises
        ------
        CommonlawError
            If a variable is not there, or there would be more than 100 000 terms.
        """
        columns, size = variables.columns(self.variables), len(variables.names)
        exponents = monomials(columns, size, self.degree, self.interactions)
        return Terms(variables, tuple(Monomial(each) for each in exponents[not self.constant :]))


def check_degree(degree: int) -> None:
    """Refuse what is not a degree from 0 to 100."""
    check_whole_number("the degree of a library", degree, 0, HIGHEST_POWER)


def monomials(columns: Sequence[int], size: int, degree: int, interactions: bool = True) -> list[tuple[int, ...]]:
    """Return the exponents of the monomials in some of `size` variables up to a degree, lower degrees first.

    Raises
    ------
    CommonlawError
        If there are more than 100 000.
    """
    count = math.comb(len(columns) + degree, degree) if interactions else 1 + len(columns) * degree
    if count > _MOST_TERMS:
        raise CommonlawError(
            f"a polynomial of degree {degree} in {len(columns)} variables has {count} terms: lower the degree, "
            "name fewer variables, or leave out the interactions"
        )
    choices = [
        choice
        for total in range(degree + 1)
        for choice in combinations_with_replacement(columns, total)
        if interactions or len(set(choice)) <= 1
    ]
    return [tuple(choice.count(i) for i in range(size)) for choice in choices]
