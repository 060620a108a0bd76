"""The right-hand side of a law for one object, ready to integrate."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from commonlaw.library import Terms

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class VectorField:
    """``y' = f(t, y)`` with ``y`` the states, and behind them their rates for a law of second order.

    Parameters
    ----------
    terms
        Over the variables states (and rates), inputs, time.
    coefficients
        Of the highest derivatives, shape (equations, terms).
    order
        1 or 2.
    inputs
        The inputs at a time, shape (inputs,); needed when the law has inputs.
    """

    terms: Terms
    coefficients: Floats
    order: int = 1
    inputs: Callable[[float], Floats] | None = None

    def __call__(self, t: float, y: Floats) -> Floats:
        """Return the rates of `y`, shape (states * order,)."""
        highest = self._compact[1] @ self._compact[0].evaluate(self._values(t, y))[0]
        return np.asarray(np.concatenate([y[len(highest) :], highest]) if self.order == 2 else highest)

    def jacobian(self, t: float, y: Floats) -> Floats:
        """Return the exact derivatives of the rates by `y`, shape (states * order, states * order)."""
        gradient = self._compact[0].jacobian(self._values(t, y))[0, :, : len(y)]
        lower = self._compact[1] @ gradient
        if self.order == 1:
            return np.asarray(lower)
        states = len(y) // 2
        return np.concatenate([np.eye(states, len(y), k=states), lower])

    @cached_property
    def _compact(self) -> tuple[Terms, Floats]:
        """The terms with a coefficient other than zero, and those coefficients."""
        used = np.flatnonzero(np.any(self.coefficients != 0, axis=0))
        return self.terms.take([int(i) for i in used]), self.coefficients[:, used]

    def _values(self, t: float, y: Floats) -> Floats:
        inputs = () if self.inputs is None else self.inputs(t)
        return np.concatenate([y, inputs, (t,)])[np.newaxis]
