"""Constants inside of terms: numbers that are found like coefficients, and multiply nothing."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.library.naming import quoted
from commonlaw.library.term import AbstractTerm


@dataclass(frozen=True)
class Constant(AbstractTerm):
    """The place of a constant among the terms of a law: its coefficient is the value of the constant.

    So what is known of coefficients is known of K in ``s/(K + s)``: each object's own value, its standard error, what
    decides it. By itself the term is zero: it adds nothing to an equation.

    Parameters
    ----------
    column
        The column of the constant among the variables.
    """

    column: int

    def evaluate(self, values: Floats) -> Floats:
        return np.zeros(len(values))

    def gradient(self, values: Floats) -> Floats:
        return np.zeros(values.shape)

    def columns(self) -> frozenset[int]:
        return frozenset((self.column,))

    def complexity(self) -> float:
        """Return zero: it is counted where it stands."""
        return 0.0

    def text(self, names: Sequence[str]) -> str:
        """Return ``K``."""
        return names[self.column]

    def expression(self, names: Sequence[str]) -> str:
        """Return ``K``."""
        return quoted(names[self.column])
