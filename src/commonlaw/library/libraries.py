"""Libraries: families of candidate terms, their sums and products, and how they are written."""

import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from itertools import combinations_with_replacement, groupby, islice
from operator import add, mul
from typing import Any

from commonlaw.errors import CommonlawError, check_choice
from commonlaw.library.bounds import split_outside
from commonlaw.library.functions import Function, functions_in
from commonlaw.library.grammar import MAX_POWER
from commonlaw.library.parametric import (
    FAMILIES,
    ParametricTerm,
    Ratios,
    parameters_in,
    parametric_term,
    terms_of_family,
)
from commonlaw.library.term import Term, Terms, monomial, parse_term, product, sinusoid
from commonlaw.library.variables import Variables
from commonlaw.runtime.arguments import check_type, check_types, check_whole_number, parse_spec

MAX_TERMS = 100_000


def check_count(what: str, count: int) -> None:
    """Refuse to make more terms than any law could be chosen from."""
    if count > MAX_TERMS:
        raise CommonlawError("library-too-large", library=what, count=count, limit=MAX_TERMS)


@dataclass(frozen=True)
class Offer:
    """What is offered besides plain terms of a law: terms with nonlinear parameters, and ratios of sums of terms."""

    terms: tuple[ParametricTerm, ...]
    ratios: tuple[Ratios, ...] = ()

    @property
    def count(self) -> int:
        """How many terms there are to choose from."""
        return len(self.terms) + sum(len(ratio.above) + len(ratio.below) for ratio in self.ratios)


class AbstractLibrary(ABC):
    """A family of candidate terms, not yet bound to variables.

    Libraries form an algebra: ``a + b`` has the terms of both, ``a * b`` all products of their terms, and
    ``a.select("1", "v")`` and ``a.without("x^3")`` keep or drop terms by name.
    """

    @abstractmethod
    def bind(self, variables: Variables) -> Terms:
        """Return the family's terms over these variables, but for those with parameters inside that are to be found."""

    def parametric(self, variables: Variables) -> tuple[ParametricTerm, ...]:
        """Return the family's terms that are offered besides: with parameters inside that are to be found."""
        return ()

    def ratios(self, variables: Variables) -> tuple[Ratios, ...]:
        """Return ratios of sums of terms that are offered besides."""
        return ()

    def offers(self, variables: Variables) -> Iterator[Offer]:
        """Yield what is offered besides, simple offers first; later ones where a law may be wrong or simpler."""
        yield Offer(self.parametric(variables), self.ratios(variables))

    @property
    def linear(self) -> "AbstractLibrary | None":
        """The same with linear plain terms; None if there is no such."""
        return None

    @property
    def higher(self) -> "AbstractLibrary | None":
        """The library with more plain terms, for data that a law of these may not explain; None if it has no more."""
        return None

    @property
    def seeks_latent_states(self) -> bool:
        """Whether it stands for laws with a latent state, too."""
        return False

    @property
    def functions(self) -> tuple[Function, ...]:
        """The functions of Python in its terms."""
        attributes = vars(self).values()
        return functions_in(f for part in attributes if isinstance(part, AbstractLibrary) for f in part.functions)

    def __add__(self, other: "AbstractLibrary") -> "AbstractLibrary":
        return SumLibrary(self, other) if isinstance(other, AbstractLibrary) else NotImplemented

    def __mul__(self, other: "AbstractLibrary") -> "AbstractLibrary":
        return ProductLibrary(self, other) if isinstance(other, AbstractLibrary) else NotImplemented

    def select(self, *names: str) -> "AbstractLibrary":
        """Return the library of these terms only, in the order given; spaces in the names do not count."""
        return SelectedLibrary(self, names)

    def without(self, *names: str) -> "AbstractLibrary":
        """Return the library without these terms; spaces in the names do not count."""
        return ReducedLibrary(self, names)


@dataclass(frozen=True)
class SumLibrary(AbstractLibrary):
    """The terms of one library and then those of another; a term of both is there once."""

    left: AbstractLibrary
    right: AbstractLibrary

    def bind(self, variables: Variables) -> Terms:
        first, second = self.left.bind(variables), self.right.bind(variables)
        return Terms(variables, tuple(dict.fromkeys(first.terms + second.terms)))

    def parametric(self, variables: Variables) -> tuple[ParametricTerm, ...]:
        return tuple(dict.fromkeys((*self.left.parametric(variables), *self.right.parametric(variables))))

    def ratios(self, variables: Variables) -> tuple[Ratios, ...]:
        return tuple(
            ratios
            for side, opposite in self._sides()
            for ratios in _with_plain(side.ratios(variables), opposite.bind(variables))
        )

    def offers(self, variables: Variables) -> Iterator[Offer]:
        yield from super().offers(variables)
        for side, opposite in self._sides():
            for offer in islice(side.offers(variables), 1, None):
                yield replace(offer, ratios=_with_plain(offer.ratios, opposite.bind(variables)))

    @property
    def higher(self) -> AbstractLibrary | None:
        first, second = self.left.higher, self.right.higher
        return SumLibrary(first or self.left, second or self.right) if first or second else None

    @property
    def seeks_latent_states(self) -> bool:
        return self.left.seeks_latent_states or self.right.seeks_latent_states

    def _sides(self) -> tuple[tuple[AbstractLibrary, AbstractLibrary], ...]:
        return (self.left, self.right), (self.right, self.left)


def _with_plain(ratios: Sequence[Ratios], terms: Terms) -> tuple[Ratios, ...]:
    """Return ratios with more terms added to them."""
    return tuple(replace(ratio, added=tuple(dict.fromkeys((*ratio.added, *terms.terms)))) for ratio in ratios)


@dataclass(frozen=True)
class ProductLibrary(AbstractLibrary):
    """Every product of a term of one library and a term of another; equal products are there once."""

    left: AbstractLibrary
    right: AbstractLibrary

    def bind(self, variables: Variables) -> Terms:
        first, second = self.left.bind(variables), self.right.bind(variables)
        check_count("a product of libraries", len(first) * len(second))
        products = (product(a, b) for a in first.terms for b in second.terms)
        return Terms(variables, tuple(dict.fromkeys(products)))

    def parametric(self, variables: Variables) -> tuple[ParametricTerm, ...]:
        products = (
            nonlinear.times(term)
            for plain, others in ((self.left, self.right), (self.right, self.left))
            for nonlinear in others.parametric(variables)
            for term in plain.bind(variables).terms
        )
        return tuple(dict.fromkeys(products))

    def ratios(self, variables: Variables) -> tuple[Ratios, ...]:
        above = self.bind(variables).terms
        return tuple(
            Ratios(above, ratios.below) for side in (self.left, self.right) for ratios in side.ratios(variables)
        )


@dataclass(frozen=True)
class SelectedLibrary(AbstractLibrary):
    """Some terms of a library, in the order in which they are named."""

    library: AbstractLibrary
    names: tuple[str, ...]

    def bind(self, variables: Variables) -> Terms:
        terms = self.library.bind(variables)
        if not self.names:
            raise CommonlawError("no-term-selected", terms=terms.names)
        return terms.take(tuple(dict.fromkeys(terms.index(name) for name in self.names)))


@dataclass(frozen=True)
class ReducedLibrary(AbstractLibrary):
    """The terms of a library but some."""

    library: AbstractLibrary
    names: tuple[str, ...]

    def bind(self, variables: Variables) -> Terms:
        terms = self.library.bind(variables)
        dropped = {terms.index(name) for name in self.names}
        if len(dropped) == len(terms):
            raise CommonlawError("no-term-left", names=self.names)
        return terms.take([i for i in range(len(terms)) if i not in dropped])


@dataclass(frozen=True)
class CappedLibrary(AbstractLibrary):
    """A library without powers of variables that take few values, by name in `levels`.

    At n values the n-th power of a variable is a sum of its lower powers: it is left out where the library has these.
    """

    library: AbstractLibrary
    levels: tuple[tuple[str, int], ...]

    def bind(self, variables: Variables) -> Terms:
        terms = self.library.bind(variables)
        columns = [(variables.index(name), count) for name, count in self.levels]

        def is_sum_of_lower(term: Term) -> bool:
            powers = term.exponents or {}
            return any(
                powers.get(i, 0) >= count and all(monomial(powers | {i: k}) in terms.terms for k in range(count))
                for i, count in columns
            )

        return terms.take([i for i, term in enumerate(terms.terms) if not is_sum_of_lower(term)])

    def parametric(self, variables: Variables) -> tuple[ParametricTerm, ...]:
        return self.library.parametric(variables)

    def ratios(self, variables: Variables) -> tuple[Ratios, ...]:
        return self.library.ratios(variables)

    def offers(self, variables: Variables) -> Iterator[Offer]:
        return self.library.offers(variables)

    @property
    def higher(self) -> AbstractLibrary | None:
        return replace(self, library=higher) if (higher := self.library.higher) else None

    @property
    def seeks_latent_states(self) -> bool:
        return self.library.seeks_latent_states


@dataclass(frozen=True)
class ConstantLibrary(AbstractLibrary):
    """The constant term 1."""

    def bind(self, variables: Variables) -> Terms:
        return Terms(variables, (Term(),))


@dataclass(frozen=True)
class PolynomialLibrary(AbstractLibrary):
    """All monomials up to a degree, lower degrees first: 1, x, v, x^2, x v, v^2, x^3, ...

    Raises `CommonlawError` if an argument does not fit, no term is left, or a variable is named twice.

    Parameters
    ----------
    degree
        The highest degree, 0 to 100.
    variables
        Names of the variables; without them all states (and rates) and inputs, but not time.
    constant, interactions
        Whether the constant term 1, and products of different variables, are in.

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
        check_whole_number("the degree of a library", self.degree, 0, MAX_POWER)
        if self.degree == 0 and not self.constant:
            raise CommonlawError("polynomial-empty")
        check_types(PolynomialLibrary, vars(self))

    def bind(self, variables: Variables) -> Terms:
        terms = _monomials(variables.columns(self.variables), self.degree, self.interactions)
        return Terms(variables, tuple(terms[not self.constant :]))


@dataclass(frozen=True)
class FourierLibrary(AbstractLibrary):
    """Sines and cosines of whole multiples of each variable, lower multiples first.

    Raises `CommonlawError` if an argument does not fit, or a variable is named twice.

    Parameters
    ----------
    frequencies
        The highest multiple, 1 to 1000.
    variables
        Names of the variables; without them all states (and rates) and inputs, but not time.

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
        terms = (
            sinusoid(function, frequency, column)
            for frequency in range(1, self.frequencies + 1)
            for column in columns
            for function in ("sin", "cos")
        )
        return Terms(variables, tuple(terms))


@dataclass(frozen=True)
class RationalLibrary(AbstractLibrary):
    """All monomials up to a degree, each divided by the same expression.

    Raises `CommonlawError` if an argument does not fit, or a variable is named twice.

    Parameters
    ----------
    degree
        The highest degree of the numerators, 0 to 100.
    denominator
        An expression: ``"1 + x^2"``.
    variables
        Names of the variables of the numerators; without them all states (and rates) and inputs, but not time.

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
        check_whole_number("the degree of a library", self.degree, 0, MAX_POWER)

    def bind(self, variables: Variables) -> Terms:
        inverse = parse_term(self.denominator, variables).power(-1)
        above = _monomials(variables.columns(self.variables), self.degree)
        return Terms(variables, tuple(product(term, inverse) for term in above))


@dataclass(frozen=True)
class RatioLibrary(AbstractLibrary):
    """Ratios of two sums of terms, such as ``V s/(K + s)`` and ``V s^2/(K^2 + s^2)`` of enzymes.

    An equation is a sum of terms of the numerator, divided by a sum of terms of the denominator or by nothing.
    Coefficients of both are found with the law, object-specific; one in the denominator is 1. Common factors are
    cancelled, and the denominator has no zero along the trials.

    Parameters
    ----------
    numerator, denominator
        The libraries of their terms.

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
    """The given terms, in that order; names that are no variables are nonlinear parameters: K in ``"s/(K + s)"``.

    Raises `CommonlawError` if there is none, or a function cannot be a term.

    Parameters
    ----------
    *expressions
        What `parse_term` reads: ``"v*abs(v)"``, ``"sin(x)"``, ``"s/(K + s)"``; or functions of Python, from arrays of
        variables, which their arguments name, to an array.
    functions
        Other functions that expressions call by their names: ``"drag(2*v)"``.

    Examples
    --------
    >>> ExpressionLibrary("1", "v*abs(v)").bind(Variables(("x", "v"))).names
    ('1', 'v*abs(v)')
    """

    expressions: tuple[str, ...]
    called: tuple[Function, ...]

    def __init__(
        self, *expressions: str | Callable[..., Any], functions: Iterable[Callable[..., Any] | Function] = ()
    ) -> None:
        if not expressions:
            raise CommonlawError("expressions-empty")
        called = {expression: Function.of(expression) for expression in expressions if not isinstance(expression, str)}
        texts = tuple(
            expression if isinstance(expression, str) else called[expression].text for expression in expressions
        )
        object.__setattr__(self, "expressions", texts)
        object.__setattr__(self, "called", functions_in((*called.values(), *functions)))

    @property
    def functions(self) -> tuple[Function, ...]:
        return self.called

    def bind(self, variables: Variables) -> Terms:
        plain = (
            parse_term(expression, variables)
            for expression in self.expressions
            if not parameters_in(expression, variables)
        )
        return Terms(variables, tuple(dict.fromkeys(plain)))

    def parametric(self, variables: Variables) -> tuple[ParametricTerm, ...]:
        inside = (expression for expression in self.expressions if parameters_in(expression, variables))
        return tuple(dict.fromkeys(parametric_term(expression, variables) for expression in inside))


@dataclass(frozen=True)
class ParametricLibrary(AbstractLibrary):
    """Functions with nonlinear parameters that go by a name, such as saturation: see `FAMILIES`.

    A law takes few of them, besides plain terms; the parameters are found with the law, object-specific.

    Raises `CommonlawError` if there is no such family, or a variable is named twice.

    Parameters
    ----------
    name
        Of the family.
    variables
        Names of the variables; without them all states (and rates) and inputs, and time for periodic functions.

    Examples
    --------
    >>> variables = Variables(("s", "x"))
    >>> [term.text(variables) for term in ParametricLibrary("saturating", "s").parametric(variables)]
    ['s/(K + s)', '1/(K + s)']
    """

    name: str
    variables: Sequence[str] | None = None

    def __post_init__(self) -> None:
        check_choice("family", self.name, FAMILIES)
        object.__setattr__(self, "variables", _checked_names(self.variables))

    def bind(self, variables: Variables) -> Terms:
        return Terms(variables, ())

    def parametric(self, variables: Variables) -> tuple[ParametricTerm, ...]:
        return terms_of_family(self.name, variables, self.variables)


def _monomials(columns: Sequence[int], degree: int, interactions: bool = True) -> list[Term]:
    """Return the monomials up to a degree in some variables, 100 000 at most."""
    count = math.comb(len(columns) + degree, degree) if interactions else 1 + len(columns) * degree
    check_count(f"a polynomial of degree {degree} in {len(columns)} variables", count)
    return [
        monomial(Counter(choice))
        for total in range(degree + 1)
        for choice in combinations_with_replacement(columns, total)
        if interactions or len(set(choice)) <= 1
    ]


def _checked_names(names: Sequence[str] | str | None) -> tuple[str, ...] | None:
    """Return names as a tuple, hashable; a text is names between commas; refuse none and names that are there twice."""
    if names is None:
        return None
    check_type("variables", names, Iterable, "names of variables")
    listed = tuple(name.strip() for name in names.split(",")) if isinstance(names, str) else tuple(names)
    for name in listed:
        check_type("variables", name, str, "names of variables")
    if not listed or len(set(listed)) < len(listed):
        raise CommonlawError("library-variables", variables=", ".join(listed) or "none")
    return listed


@dataclass(frozen=True)
class AutoLibrary(AbstractLibrary):
    """All kinds of terms, the simplest first: for data without a hypothesis.

    Polynomials of `degree`, and of degree 4 where the best law has a lack of fit, or many terms. Where that too has
    one, or may be a truncated series, with three powers of a variable in equal steps: in addition,
    with two states and their rates, central forces and drag; then a few functions of all families, alone and as factors
    of a state or an input; then ratios of sums of terms up to degree 2, with linear terms; then, in laws of first order
    of several trials of at most ten objects, a latent state.
    The evidence decides.

    Parameters
    ----------
    degree
        Of the polynomials that are tried first.

    Examples
    --------
    >>> library, variables = AutoLibrary(), Variables(("x", "v"))
    >>> len(library.bind(variables)), [offer.count for offer in library.offers(variables)]
    (10, [0, 102, 12])
    """

    degree: int = 3

    def bind(self, variables: Variables) -> Terms:
        return PolynomialLibrary(self.degree).bind(variables)

    @property
    def linear(self) -> AbstractLibrary:
        return replace(self, degree=1)

    @property
    def higher(self) -> AbstractLibrary | None:
        return replace(self, degree=4) if self.degree < 4 else None

    def offers(self, variables: Variables) -> Iterator[Offer]:
        yield Offer(())
        # Positions and velocities may be vectors
        if len(variables.states) >= 4:
            yield Offer(ParametricLibrary("central").parametric(variables))
        alone = [ParametricLibrary(name) for name in ("power", "reciprocal", "root", "sigmoid", "polar")]
        of_states = [ParametricLibrary(name, variables.states) for name in ("friction", "morse")]
        factors = [
            ParametricLibrary(name)
            for name in ("saturating", "hill", "exponential", "logarithm", "trigonometric", "contact")
        ]
        driven = ParametricLibrary("periodic", (variables.time,))
        several = (*alone, *(PolynomialLibrary(1) * factor for factor in factors), *of_states, driven)
        yield Offer(tuple(dict.fromkeys(term for library in several for term in library.parametric(variables))))
        yield from (PolynomialLibrary(1) + RatioLibrary(PolynomialLibrary(2), PolynomialLibrary(2))).offers(variables)

    @property
    def seeks_latent_states(self) -> bool:
        return True


LibraryGiven = AbstractLibrary | str | Sequence[str | AbstractLibrary | Callable[..., Any]]
"""A library, its text, or a list of libraries, of terms as texts, and of functions of Python."""


def parse_library(given: LibraryGiven) -> AbstractLibrary:
    """Return the library that a text names, or the terms in a list; a library as it is.

    ``poly:3``, ``fourier:2``, ``rational:2:1+x**2``, ``terms:1,v,v*abs(v)``, ``constant`` or ``auto``, a family of
    `FAMILIES` such as ``saturating``, or several joined by ``+`` and ``*`` with spaces around: ``poly:2 + fourier:1``,
    ``poly:1 * saturating:s``. Within a library there are no such spaces, but for parentheses: ``terms:1+x``, not
    ``terms:1 + x``. ``ratio(poly:2, poly:2)`` are ratios of sums of terms of two libraries. Variables are listed with
    commas: ``poly:3:x,v``. Names in terms that are no variables are nonlinear parameters: ``poly:1 + terms:s/(K+s)``.

    A list has terms and libraries, which are texts with a colon or `AbstractLibrary`: ``["poly:1", "v*abs(v)"]``.

    Raises `CommonlawError` if there is no such library or its arguments do not fit.

    Examples
    --------
    >>> parse_library("poly:1 + terms:v*abs(v)").bind(Variables(("x", "v"))).names
    ('1', 'x', 'v', 'v*abs(v)')
    """
    if isinstance(given, AbstractLibrary):
        return given
    if not isinstance(given, str):
        check_type("library", given, Iterable, "a library, its text, or a list of them")
        parts = list[AbstractLibrary]()
        for are_libraries, group in groupby(given, lambda x: ":" in x if isinstance(x, str) else not callable(x)):
            members: Any = [*group]
            parts += map(parse_library, members) if are_libraries else [ExpressionLibrary(*members)]
        return reduce(add, parts or [ExpressionLibrary()])
    makers: dict[str, Callable[..., AbstractLibrary]] = {
        "poly": PolynomialLibrary,
        "fourier": FourierLibrary,
        "rational": RationalLibrary,
        "terms": lambda expressions: ExpressionLibrary(*split_outside(str(expressions))),
        "constant": ConstantLibrary,
        "auto": AutoLibrary,
        **{name: partial(ParametricLibrary, name) for name in FAMILIES},
    }

    def one(part: str) -> AbstractLibrary:
        if not part.startswith("ratio("):
            return parse_spec("library", part, makers)
        sides = split_outside(part[len("ratio(") : -1])
        if not part.endswith(")") or len(sides) != 2:
            raise CommonlawError("ratio-syntax", library=part)
        return RatioLibrary(*map(parse_library, sides))

    sums = [[one(factor) for factor in split_outside(part, " * ")] for part in split_outside(given, " + ")]
    return reduce(add, (reduce(mul, factors) for factors in sums))
