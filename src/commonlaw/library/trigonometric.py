"""Sines and cosines of one variable."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.extras import optional_import
from commonlaw.library.naming import latex_name, quoted
from commonlaw.library.term import AbstractTerm

if TYPE_CHECKING:
    import sympy


@dataclass(frozen=True)
class Trigonometric(AbstractTerm):
    """The sine or cosine of a multiple of one variable: ``sin(2 x)``.

    Parameters
    ----------
    function
        ``"sin"`` or ``"cos"``.
    frequency
        The positive number that the variable is multiplied by, in radians per unit of the variable.
    variable
        The column of the variable.
    """

    function: Literal["sin", "cos"]
    frequency: float
    variable: int

    def evaluate(self, values: Floats) -> Floats:
        """Return the values, shape (n,)."""
        function = np.sin if self.function == "sin" else np.cos
        with np.errstate(all="ignore"):
            result: Floats = function(self.frequency * values[:, self.variable])
        return result

    def gradient(self, values: Floats) -> Floats:
        """Return the partial derivatives, shape (n, number of variables)."""
        result = np.zeros(values.shape)
        with np.errstate(all="ignore"):
            angle = self.frequency * values[:, self.variable]
            inner = np.cos(angle) if self.function == "sin" else -np.sin(angle)
            result[:, self.variable] = self.frequency * inner
        return result

    def parts(self) -> None:
        """Return nothing: it is computed directly."""

    def columns(self) -> frozenset[int]:
        """Return the column of its variable."""
        return frozenset((self.variable,))

    def text(self, names: Sequence[str]) -> str:
        """Return ``sin(2 x)``."""
        return f"{self.function}({self._times(' ')}{names[self.variable]})"

    def expression(self, names: Sequence[str]) -> str:
        """Return ``sin(2*x)``."""
        return f"{self.function}({self._times('*')}{quoted(names[self.variable])})"

    def latex(self, names: Sequence[str]) -> str:
        r"""Return ``\sin(2 x)``."""
        return rf"\{self.function}({self._times(' ')}{latex_name(names[self.variable])})"

    def sympy(self, symbols: Sequence["sympy.Symbol"]) -> "sympy.Expr":
        """Return the sine or cosine of the multiple of the symbol."""
        sympy = optional_import("sympy", "the SymPy form of a term", "symbolic")

        return getattr(sympy, self.function)(sympy.sympify(self.frequency) * symbols[self.variable])

    def _times(self, sign: str) -> str:
        return "" if self.frequency == 1 else f"{self.frequency}{sign}"
