"""Libraries: families of terms, their sums and products, and libraries without some of their terms."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

from commonlaw.errors import CommonlawError
from commonlaw.library.monomial import Monomial
from commonlaw.library.parametric import ParametricTerm, TiedTerms
from commonlaw.library.product import multiply
from commonlaw.library.ratio import Ratios
from commonlaw.library.term import AbstractTerm
from commonlaw.library.terms import Terms, Variables

_MOST_TERMS = 100_000


def check_count(what: str, count: int) -> None:
    """Refuse to make more terms than any law could be chosen from."""
    if count > _MOST_TERMS:
        raise CommonlawError("library-too-large", library=what, count=count, limit=_MOST_TERMS)


@dataclass(frozen=True)
class Offer:
    """What is offered beside plain terms of a law.

    Parameters
    ----------
    terms
        With constants inside that are to be found, or that a law takes few of.
    ratios
        Of sums of terms.
    """

    terms: tuple[ParametricTerm | TiedTerms, ...]
    ratios: tuple[Ratios, ...] = ()

    @property
    def count(self) -> int:
        """How many terms there are to choose from."""
        return len(self.terms) + sum(len(each.above) + len(each.below) for each in self.ratios)


class AbstractLibrary(ABC):
    """A family of candidate terms, not yet bound to variables.

    Libraries form an algebra: ``a + b`` has the terms of both, ``a * b`` every product of a term of one with a term
    of the other, and ``a.select("1", "v")`` and ``a.without("x^3")`` keep or drop terms by name.
    """

    @abstractmethod
    def bind(self, variables: Variables) -> Terms:
        """Return the family's terms over these variables, but for those with constants inside that are to be found."""

    def parametric(self, variables: Variables) -> tuple[ParametricTerm | TiedTerms, ...]:
        """Return the family's terms that are offered besides: with constants inside that are to be found."""
        return ()

    def ratios(self, variables: Variables) -> tuple[Ratios, ...]:
        """Return ratios of sums of terms that are offered besides."""
        return ()

    def offers(self, variables: Variables) -> Iterator[Offer]:
        """Yield what is offered besides, the next where a law of those before may be wrong or could be simpler.

        The first is tried in any equation. Offers are many terms: each is made when it is asked for.
        """
        yield Offer(self.parametric(variables), self.ratios(variables))

    @property
    def higher(self) -> "AbstractLibrary | None":
        """The library with more plain terms, for data that a law of these may not explain; None if it has no more."""
        return None

    @property
    def seeks_unmeasured(self) -> bool:
        """Whether it stands for laws with a state that nobody measured, too."""
        return False

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
        left, right = self.left.bind(variables), self.right.bind(variables)
        return Terms(variables, tuple(dict.fromkeys(left.terms + right.terms)))

    def parametric(self, variables: Variables) -> tuple[ParametricTerm | TiedTerms, ...]:
        return tuple(dict.fromkeys((*self.left.parametric(variables), *self.right.parametric(variables))))

    def ratios(self, variables: Variables) -> tuple[Ratios, ...]:
        return tuple(
            each for own, other in self._sides() for each in _with_plain(own.ratios(variables), other.bind(variables))
        )

    def offers(self, variables: Variables) -> Iterator[Offer]:
        yield from super().offers(variables)
        for own, other in self._sides():
            for each in islice(own.offers(variables), 1, None):
                yield replace(each, ratios=_with_plain(each.ratios, other.bind(variables)))

    @property
    def higher(self) -> AbstractLibrary | None:
        left, right = self.left.higher, self.right.higher
        return SumLibrary(left or self.left, right or self.right) if left or right else None

    @property
    def seeks_unmeasured(self) -> bool:
        return self.left.seeks_unmeasured or self.right.seeks_unmeasured

    def _sides(self) -> tuple[tuple[AbstractLibrary, AbstractLibrary], ...]:
        """Return each of both libraries, with the other."""
        return (self.left, self.right), (self.right, self.left)


def _with_plain(ratios: Sequence[Ratios], terms: Terms) -> tuple[Ratios, ...]:
    """Return ratios with more terms beside them."""
    return tuple(replace(each, beside=tuple(dict.fromkeys((*each.beside, *terms.terms)))) for each in ratios)


@dataclass(frozen=True)
class ProductLibrary(AbstractLibrary):
    """Every product of a term of one library and a term of another; equal products are there once."""

    left: AbstractLibrary
    right: AbstractLibrary

    def bind(self, variables: Variables) -> Terms:
        left, right, size = self.left.bind(variables), self.right.bind(variables), len(variables.names)
        check_count("a product of libraries", len(left) * len(right))
        products = (multiply((a, b), size) for a in left.terms for b in right.terms)
        return Terms(variables, tuple(dict.fromkeys(products)))

    def parametric(self, variables: Variables) -> tuple[ParametricTerm | TiedTerms, ...]:
        products = (
            other.times(term, variables)
            for plain, others in ((self.left, self.right), (self.right, self.left))
            for other in others.parametric(variables)
            for term in plain.bind(variables).terms
        )
        return tuple(dict.fromkeys(products))

    def ratios(self, variables: Variables) -> tuple[Ratios, ...]:
        above = self.bind(variables).terms
        return tuple(Ratios(above, each.below) for own in (self.left, self.right) for each in own.ratios(variables))


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
    """A library without powers of variables that take few values.

    At n values the n-th power of a variable is a sum of its lower powers, so no measurement tells them apart. Such a
    term goes where the library has these.

    Parameters
    ----------
    library
        Which terms there are.
    levels
        How many values a variable takes, by name.
    """

    library: AbstractLibrary
    levels: tuple[tuple[str, int], ...]

    def bind(self, variables: Variables) -> Terms:
        terms = self.library.bind(variables)
        columns = [(variables.index(name), count) for name, count in self.levels]
        return terms.take([i for i, term in enumerate(terms.terms) if not _is_sum_of_lower(term, columns, terms.terms)])

    def parametric(self, variables: Variables) -> tuple[ParametricTerm | TiedTerms, ...]:
        return self.library.parametric(variables)

    def ratios(self, variables: Variables) -> tuple[Ratios, ...]:
        return self.library.ratios(variables)

    def offers(self, variables: Variables) -> Iterator[Offer]:
        return self.library.offers(variables)

    @property
    def higher(self) -> AbstractLibrary | None:
        return replace(self, library=higher) if (higher := self.library.higher) else None

    @property
    def seeks_unmeasured(self) -> bool:
        return self.library.seeks_unmeasured


def _is_sum_of_lower(term: AbstractTerm, columns: Sequence[tuple[int, int]], among: Sequence[AbstractTerm]) -> bool:
    """Return whether a term has as high a power of a column as that has values, and all lower powers are there."""
    if not isinstance(term, Monomial):
        return False
    powers = term.exponents
    return any(
        powers[i] >= count and all(Monomial((*powers[:i], k, *powers[i + 1 :])) in among for k in range(count))
        for i, count in columns
    )
