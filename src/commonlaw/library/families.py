"""The families of terms that a library can be made of."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

from commonlaw.errors import CommonlawError, check_choice
from commonlaw.library.algebra import AbstractLibrary, Offer, check_count
from commonlaw.library.grammar import HIGHEST_POWER
from commonlaw.library.monomial import Monomial
from commonlaw.library.parametric import (
    FAMILIES,
    ParametricTerm,
    TiedTerms,
    constants_in,
    parametric_term,
    terms_of_family,
)
from commonlaw.library.parse import parse_term
from commonlaw.library.product import multiply, multiply_powers
from commonlaw.library.ratio import Ratios
from commonlaw.library.terms import Terms, Variables
from commonlaw.library.trigonometric import Trigonometric
from commonlaw.validation import check_whole_number


@dataclass(frozen=True)
class ConstantLibrary(AbstractLibrary):
    """The constant term 1.

    Examples
    --------
    >>> ConstantLibrary().bind(Variables(("x",))).names
    ('1',)
    """

    def bind(self, variables: Variables) -> Terms:
        return Terms(variables, (Monomial((0,) * len(variables.names)),))


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
        object.__setattr__(self, "variables", _checked_names(self.variables))
        check_whole_number("the degree of a library", self.degree, 0, HIGHEST_POWER)
        if self.degree == 0 and not self.constant:
            raise CommonlawError("polynomial-empty")

    def bind(self, variables: Variables) -> Terms:
        columns, size = variables.columns(self.variables), len(variables.names)
        exponents = _monomials(columns, size, self.degree, self.interactions)
        return Terms(variables, tuple(Monomial(each) for each in exponents[not self.constant :]))


@dataclass(frozen=True)
class FourierLibrary(AbstractLibrary):
    """Sines and cosines of whole multiples of each variable, lower multiples first.

    Parameters
    ----------
    frequencies
        The highest multiple.
    variables
        Names of the variables; without them all states (and rates) and inputs, but not time.

    Raises
    ------
    CommonlawError
        If there are not 1 to 1000 frequencies, or a variable is named twice.

    Examples
    --------
    >>> FourierLibrary(2).bind(Variables(("x",))).names
    ('sin(x)', 'cos(x)', 'sin(2 x)', 'cos(2 x)')
    """

    frequencies: int = 1
    variables: Sequence[str] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "variables", _checked_names(self.variables))
        check_whole_number("the number of frequencies of a Fourier library", self.frequencies, 1, 1000)

    def bind(self, variables: Variables) -> Terms:
        columns = variables.columns(self.variables)
        check_count(f"a Fourier library of {len(columns)} variables", 2 * self.frequencies * len(columns))
        terms = [
            term
            for frequency in range(1, self.frequencies + 1)
            for column in columns
            for term in (Trigonometric("sin", frequency, column), Trigonometric("cos", frequency, column))
        ]
        return Terms(variables, tuple(terms))


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
        object.__setattr__(self, "variables", _checked_names(self.variables))
        object.__setattr__(self, "denominator", str(self.denominator))
        check_whole_number("the degree of a library", self.degree, 0, HIGHEST_POWER)

    def bind(self, variables: Variables) -> Terms:
        columns, size = variables.columns(self.variables), len(variables.names)
        above = [Monomial(each) for each in _monomials(columns, size, self.degree)]
        inverse = multiply_powers({parse_term(self.denominator, variables): -1}, size)
        return Terms(variables, tuple(multiply((each, inverse), size) for each in above))


@dataclass(frozen=True)
class RatioLibrary(AbstractLibrary):
    """Ratios of two sums of terms, such as ``V s/(K + s)`` and ``V s^2/(K^2 + s^2)`` of enzymes.

    An equation is a sum of some terms of the numerator divided by a sum of some of the denominator. The coefficients of
    both are found with the law, each object's own; one in the denominator is 1. Nothing that is a factor of all terms
    stays, and the denominator has no zero where trials have been, nor between. Without a denominator, an equation is a
    sum of terms of the numerator.

    Parameters
    ----------
    numerator
        The library of the terms above.
    denominator
        That of the terms below.

    Examples
    --------
    >>> (ratios,) = RatioLibrary(PolynomialLibrary(2), PolynomialLibrary(2)).ratios(Variables(("s",)))
    >>> len(ratios.above), len(ratios.below)
    (3, 3)
    """

    numerator: AbstractLibrary
    denominator: AbstractLibrary

    def bind(self, variables: Variables) -> Terms:
        return self.numerator.bind(variables)

    def ratios(self, variables: Variables) -> tuple[Ratios, ...]:
        below = self.denominator.bind(variables).terms
        if not len(below) > 1:
            raise CommonlawError("denominator-one-term")
        return (Ratios(self.bind(variables).terms, below),)


@dataclass(frozen=True, init=False)
class ExpressionLibrary(AbstractLibrary):
    """The terms that are written, in that order.

    Names inside that are no variables are constants, which are found with the law: K in ``"s/(K + s)"``.

    Parameters
    ----------
    *expressions
        What `parse_term` reads: ``"v*abs(v)"``, ``"sin(x)"``, ``"s/(K + s)"``.

    Raises
    ------
    CommonlawError
        If there is none.

    Examples
    --------
    >>> ExpressionLibrary("1", "v*abs(v)").bind(Variables(("x", "v"))).names
    ('1', 'v*abs(v)')
    """

    expressions: tuple[str, ...]

    def __init__(self, *expressions: str) -> None:
        if not expressions:
            raise CommonlawError("expressions-empty")
        object.__setattr__(self, "expressions", expressions)

    def bind(self, variables: Variables) -> Terms:
        plain = (parse_term(each, variables) for each in self.expressions if not constants_in(each, variables))
        return Terms(variables, tuple(dict.fromkeys(plain)))

    def parametric(self, variables: Variables) -> tuple[ParametricTerm | TiedTerms, ...]:
        inside = (each for each in self.expressions if constants_in(each, variables))
        return tuple(dict.fromkeys(parametric_term(each, variables) for each in inside))


@dataclass(frozen=True)
class FamilyLibrary(AbstractLibrary):
    """Functions that occur in laws and go by a name, such as saturation: see `FAMILIES`.

    A law takes few of them, beside plain terms; constants inside are found with the law, each object's own.

    Parameters
    ----------
    name
        Of the family.
    variables
        Names of the variables; without them all states (and rates) and inputs, and time for periodic functions.

    Raises
    ------
    CommonlawError
        If there is no such family, or a variable is named twice.

    Examples
    --------
    >>> variables = Variables(("s", "x"))
    >>> [each.text(variables) for each in FamilyLibrary("saturating", "s").parametric(variables)]
    ['s/(K + s)', '1/(K + s)']
    """

    name: str
    variables: Sequence[str] | None = None

    def __post_init__(self) -> None:
        check_choice("family", self.name, FAMILIES)
        object.__setattr__(self, "variables", _checked_names(self.variables))

    def bind(self, variables: Variables) -> Terms:
        return Terms(variables, ())

    def parametric(self, variables: Variables) -> tuple[ParametricTerm | TiedTerms, ...]:
        return terms_of_family(self.name, variables, self.variables)


def _monomials(columns: Sequence[int], size: int, degree: int, interactions: bool = True) -> list[tuple[int, ...]]:
    """Return the exponents of the monomials up to a degree in some of `size` variables, 100 000 at most."""
    count = math.comb(len(columns) + degree, degree) if interactions else 1 + len(columns) * degree
    check_count(f"a polynomial of degree {degree} in {len(columns)} variables", count)
    choices = [
        choice
        for total in range(degree + 1)
        for choice in combinations_with_replacement(columns, total)
        if interactions or len(set(choice)) <= 1
    ]
    return [tuple(choice.count(i) for i in range(size)) for choice in choices]


def _checked_names(names: Sequence[str] | str | None) -> tuple[str, ...] | None:
    """Return names as a tuple, hashable; a text is names between commas; refuse none and names that are there twice."""
    if names is None:
        return None
    listed = tuple(each.strip() for each in names.split(",")) if isinstance(names, str) else tuple(names)
    if not listed or len(set(listed)) < len(listed):
        raise CommonlawError("library-variables", variables=", ".join(listed) or "none")
    return listed


_HIGHEST_DEGREE = 4
"""Of the polynomials that are tried before terms with constants inside."""


@dataclass(frozen=True)
class AutoLibrary(AbstractLibrary):
    """All that commonlaw knows to occur in laws: a library for whom none comes to mind.

    Polynomials of degree 3 first, and of degree 4 where the best of these laws leaves more than noise, or needs many
    numbers. Where the better of both leaves more than noise, or may be the beginning of a series, with three powers of
    one variable in equal steps up to the highest: beside few of these, functions of all families, alone and as factors
    of a state or an input. Where these laws leave something, or need many numbers, ratios of sums of terms up to degree
    2, beside linear terms; then, in laws of first order of several trials of at most ten objects,
    a state that nobody measured. A law takes them where its evidence pays for the larger choice.

    Parameters
    ----------
    degree
        Of the polynomials that are tried first.

    Examples
    --------
    >>> library, variables = AutoLibrary(), Variables(("x", "v"))
    >>> len(library.bind(variables)), [each.count for each in library.offers(variables)]
    (10, [0, 98, 12])
    """

    degree: int = 3

    def bind(self, variables: Variables) -> Terms:
        return PolynomialLibrary(self.degree).bind(variables)

    @property
    def higher(self) -> AbstractLibrary | None:
        return replace(self, degree=_HIGHEST_DEGREE) if self.degree < _HIGHEST_DEGREE else None

    def offers(self, variables: Variables) -> Iterator[Offer]:
        yield Offer(())
        yield Offer(self._families(variables))
        yield from (PolynomialLibrary(1) + RatioLibrary(PolynomialLibrary(2), PolynomialLibrary(2))).offers(variables)

    def _families(self, variables: Variables) -> tuple[ParametricTerm | TiedTerms, ...]:
        alone = [FamilyLibrary(name) for name in ("power", "root", "sigmoid", "polar")]
        of_states = [FamilyLibrary(name, variables.states) for name in ("friction", "morse")]
        factors = [
            FamilyLibrary(name)
            for name in ("saturating", "hill", "exponential", "logarithm", "trigonometric", "contact")
        ]
        driven = FamilyLibrary("periodic", (variables.time,))
        several = (*alone, *(PolynomialLibrary(1) * each for each in factors), *of_states, driven)
        return tuple(dict.fromkeys(term for each in several for term in each.parametric(variables)))

    @property
    def seeks_unmeasured(self) -> bool:
        return True
