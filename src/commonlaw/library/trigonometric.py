"""Sines and cosines of one variable."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.library.naming import quoted
from commonlaw.library.term import AbstractTerm


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
        function = np.sin if self.function == "sin" else np.cos
        with np.errstate(all="ignore"):
            return np.asarray(function(self.frequency * values[:, self.variable]))

    def gradient(self, values: Floats) -> Floats:
        result = np.zeros(values.shape)
        with np.errstate(all="ignore"):
            angle = self.frequency * values[:, self.variable]
            inner = np.cos(angle) if self.function == "sin" else -np.sin(angle)
            result[:, self.variable] = self.frequency * inner
        return result

    def columns(self) -> frozenset[int]:
        return frozenset((self.variable,))

    def complexity(self) -> float:
        """Return two: a function and a variable."""
        return 2

    def text(self, names: Sequence[str]) -> str:
        """Return ``sin(2 x)``."""
        return f"{self.function}({self._times(' ')}{names[self.variable]})"

    def expression(self, names: Sequence[str]) -> str:
        """Return ``sin(2*x)``."""
        return f"{self.function}({self._times('*')}{quoted(names[self.variable])})"

    def _times(self, sign: str) -> str:
        return "" if self.frequency == 1 else f"{self.frequency}{sign}"
