"""What a candidate function is."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.library.notation import expression_latex, sympy_form

if TYPE_CHECKING:
    import sympy


class AbstractTerm(ABC):
    """A function of the variables: it evaluates, differentiates, prints, and has a SymPy form.

    Terms know variables by their column; names come in as arguments. Terms are values: equal terms compare equal.
    """

    @abstractmethod
    def evaluate(self, values: Floats) -> Floats:
        """Return the term's values, shape (n,), at the rows of `values`, shape (n, number of variables).

        Where the term is not defined, it is infinite or not a number; no warning is given.
        """

    @abstractmethod
    def gradient(self, values: Floats) -> Floats:
        """Return the exact partial derivatives by every variable, shape (n, number of variables)."""

    def parts(self) -> tuple[np.ufunc, "AbstractTerm", "AbstractTerm"] | None:
        """Return `numpy.multiply` or `numpy.divide` and the two simpler terms that it makes into this one, if any."""
        return None

    def below(self) -> tuple["AbstractTerm", ...]:
        """Return what it is divided by."""
        return ()

    @abstractmethod
    def columns(self) -> frozenset[int]:
        """Return the columns of the variables that the term depends on."""

    @property
    def is_sum(self) -> bool:
        """Whether it needs parentheses behind a coefficient."""
        return False

    @abstractmethod
    def complexity(self) -> float:
        """Return how many factors it takes to write the term: variables and functions, but no numbers.

        Three for ``x^2 v``, two for ``sin(2 x)``, none for ``1``.
        """

    @abstractmethod
    def text(self, names: Sequence[str]) -> str:
        """Return the term as the field writes it: ``x^2 v``, ``sin(2 x)``."""

    @abstractmethod
    def expression(self, names: Sequence[str]) -> str:
        """Return the term as an expression that `parse_term` reads back: ``x**2*v``."""

    def latex(self, names: Sequence[str]) -> str:
        """Return the term as LaTeX, without dollar signs."""
        return expression_latex(self._code(len(names)), names)

    def sympy(self, symbols: Sequence["sympy.Symbol"]) -> "sympy.Expr":
        """Return the term as a SymPy expression in the given symbols, one for each variable.

        The symbols should be real: only then is the derivative of ``abs(x)`` the sign of x.

        Raises
        ------
        CommonlawError
            If SymPy is not installed, or the variables cancel out, as in ``exp((x - x + 9)**99)``, and leave a number
            beyond all bounds.
        """
        return sympy_form(self._code(len(symbols)), symbols)

    def _code(self, count: int) -> str:
        """Return the expression as the grammar writes it, over the names of its columns."""
        return self.expression([f"v{i}" for i in range(count)])
