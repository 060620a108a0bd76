"""Names of terms that are fractions, so that those of one denominator can be written together."""

from collections.abc import Callable
from typing import Self

import numpy as np

from commonlaw.library.term import AbstractTerm


class Fraction(str):
    """The name of a term behind its coefficient, ``s/(K + s)``, with what stands above and below.

    Parameters
    ----------
    whole
        The name.
    above, below
        Of the numerator and the denominator.
    form
        How these are joined.
    """

    __slots__ = ("above", "below", "form")

    above: str
    below: str
    form: str

    def __new__(cls, whole: str, above: str, below: str, form: str) -> Self:
        found = super().__new__(cls, whole)
        found.above, found.below, found.form = above, below, form
        return found

    def over(self, above: str) -> str:
        """Return the fraction of another numerator, ``(a s + b s^2)/(K + s)``."""
        return self.form.format(above, self.below)

    def behind(self, number: str, times: str) -> str:
        """Return it behind a coefficient: ``a s/(K + s)``, ``a/(K + s)``."""
        if self.startswith("1/"):
            return f"{number}{self[1:]}"
        return f"{number}{times}{self}"


PLAIN, LATEX = "({})/({})", r"\frac{{{}}}{{{}}}"
"""How a numerator and a denominator of several addends are joined."""


def fraction(term: AbstractTerm, write: Callable[[AbstractTerm], str], form: str, measured: int) -> Fraction | None:
    """Return the name of a term that is divided by something with constants in it; none for any other.

    Parameters
    ----------
    term
        The term.
    write
        Returns its name, and those of its parts.
    form
        How these are joined.
    measured
        How many variables are no constants.
    """
    parts = term.parts()
    if parts is None or parts[0] is not np.divide or max(parts[2].columns(), default=0) < measured:
        return None
    _, above, below = parts
    return Fraction(write(term), f"({write(above)})" if above.is_sum else write(above), write(below), form)
