"""Ratios of two sums of terms, ``(a s + b s^2)/(K + s)``, of which both are to be found."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.library.monomial import Monomial
from commonlaw.library.parametric import free_name
from commonlaw.library.term import AbstractTerm
from commonlaw.library.terms import Variables

_LETTERS = "KLMNPQRSTUVW"


@dataclass(frozen=True)
class Ratio:
    """One ratio of two sums: a coefficient before each term above and below, but for one below, which is one.

    As terms with constants inside these are ``s/(K + s)``, ``s^2/(K + s)``: they share the constants.

    Parameters
    ----------
    above
        The terms of the numerator.
    below
        Those of the denominator.
    reference
        Which term below has the coefficient one, by its index.
    constants
        The names of the coefficients below, in the order of their terms, but for that of `reference`.
    """

    above: tuple[AbstractTerm, ...]
    below: tuple[AbstractTerm, ...]
    reference: int
    constants: tuple[str, ...]

    @property
    def size(self) -> int:
        """How many terms it is: as many as there are above."""
        return len(self.above)

    @property
    def degree(self) -> int:
        """The power of a constant beside one term below: 2 in ``K^2 + s^2``, so that K is a value of s."""
        other = self.below[self.reference]
        pure = isinstance(other, Monomial) and len(other.columns()) == 1 and len(self.below) == 2
        return int(other.complexity()) if pure else 1

    def expressions(self, variables: Variables, constants: Sequence[str]) -> list[str]:
        """Return each of its terms for `parse_term`, with these names of its constants."""
        names, left, written = variables.measured, list(constants), list[str]()
        for i, each in enumerate(self.below):
            text = each.expression(names)
            if i == self.reference:
                written.append(text)
            elif each.columns():
                written.append(f"{left.pop(0)}*{text}")
            else:
                written.append(f"{left.pop(0)}**{self.degree}" if self.degree > 1 else left.pop(0))
        return [f"({each.expression(names)})/({' + '.join(written)})" for each in self.above]

    def values_of_constants(self, below: Floats) -> list[float] | None:
        """Return the values of the constants from coefficients below, shape (terms below,).

        There are none if the coefficient of `reference` is zero, or an even power would have to be below zero.
        """
        with np.errstate(all="ignore"):
            scaled = below / below[self.reference]
        found = []
        for i, (each, value) in enumerate(zip(self.below, scaled.tolist(), strict=True)):
            if i != self.reference:
                power = 1 if each.columns() else self.degree
                if not np.isfinite(value) or (value <= 0 and power % 2 == 0):
                    return None
                found.append(float(np.sign(value) * abs(value) ** (1 / power)))
        return found


@dataclass(frozen=True)
class Ratios:
    """The ratios among which that of an equation is sought.

    Parameters
    ----------
    above, below
        The terms from which numerators and denominators are made.
    beside
        Plain terms that an equation may have besides.
    """

    above: tuple[AbstractTerm, ...]
    below: tuple[AbstractTerm, ...]
    beside: tuple[AbstractTerm, ...] = ()

    def ratio(
        self, above: Sequence[int], below: Sequence[int], variables: Variables, sizes: Floats | None = None
    ) -> Ratio:
        """Return the ratio of sums of some terms above and some below, by their indices.

        Of those below that hold a variable, the one that is largest by these sizes has the coefficient one, so that no
        other is far from being of its size; without sizes it is the first.
        """
        terms, letters = tuple(self.below[i] for i in below), list[str]()
        sizes = np.ones(len(terms)) if sizes is None else sizes
        reference = max((i for i, each in enumerate(terms) if each.columns()), key=lambda i: float(sizes[i]))
        for letter in _LETTERS[: len(below) - 1]:
            letters.append(free_name(letter, (*variables.measured, *letters)))
        return Ratio(tuple(self.above[i] for i in above), terms, reference, tuple(letters))

    def is_reduced(self, above: Sequence[int], below: Sequence[int]) -> bool:
        """Whether no variable cancels in a ratio: ``s/(K + s)``, but not ``s^2/(K s + s^2)``."""
        terms = (*(self.above[i] for i in above), *(self.below[i] for i in below))
        exponents = [each.exponents for each in terms if isinstance(each, Monomial)]
        return len(exponents) < len(terms) or not np.min(exponents, axis=0).any()
