"""The right-hand side of a law for one object, ready to integrate."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.library import Terms


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
        1 or 2; 0 for a law in discrete time, which gives the next states instead of rates.
    inputs
        The inputs at a time, shape (inputs,); needed when the law has inputs.
    support
        Which coefficients are parameters, shape (equations, terms); without it those that are not zero. What all
        objects share is worth giving: it keeps the meaning of sensitivities when a coefficient happens to be zero.

    Raises
    ------
    CommonlawError
        If a coefficient outside the support is not zero.
    """

    terms: Terms
    coefficients: Floats
    order: int = 1
    inputs: Callable[[float], Floats] | None = None
    support: Bools | None = None

    def __post_init__(self) -> None:
        if self.support is not None and np.any(self.coefficients[~self.support]):
            raise CommonlawError("a coefficient outside the support of a vector field is not zero: widen the support")

    def __call__(self, t: float, y: Floats) -> Floats:
        """Return the rates of `y`, or the next `y` in discrete time, shape (d,)."""
        terms, coefficients = self._compact
        highest = coefficients @ terms.evaluate(self.values(t, y))[0]
        return np.asarray(np.concatenate([y[len(highest) :], highest]) if self.order == 2 else highest)

    def jacobian(self, t: float, y: Floats) -> Floats:
        """Return the exact derivatives of ``f(t, y)`` by `y`, shape (d, d)."""
        terms, coefficients = self._compact
        lower = coefficients @ terms.jacobian(self.values(t, y))[0, :, : len(y)]
        if self.order != 2:
            return np.asarray(lower)
        states = len(y) // 2
        return np.concatenate([np.eye(states, len(y), k=states), lower])

    def slopes(self, t: float, y: Floats) -> Floats:
        """Return the derivatives of ``f(t, y)`` by the parameters, shape (d, parameters)."""
        row = self.terms.take(self._used).evaluate(self.values(t, y))[0]
        equations, indices = np.nonzero(self.kept[:, self._used])
        result = np.zeros((len(y), len(indices)))
        result[len(y) - len(self.coefficients) + equations, np.arange(len(indices))] = row[indices]
        return result

    @cached_property
    def kept(self) -> Bools:
        """Which coefficients are parameters, shape (equations, terms); they count in the order of `numpy.argwhere`."""
        return np.asarray(self.coefficients != 0) if self.support is None else self.support

    @property
    def parameters(self) -> Floats:
        """The values of the parameters, shape (parameters,)."""
        return np.asarray(self.coefficients[self.kept])

    def values(self, t: float, y: Floats) -> Floats:
        """Return the variables at one time, shape (1, variables)."""
        inputs = () if self.inputs is None else self.inputs(t)
        return np.concatenate([y, inputs, (t,)])[np.newaxis]

    @cached_property
    def _used(self) -> list[int]:
        """The places of the terms that are in some equation."""
        return [int(k) for k in np.flatnonzero(self.kept.any(axis=0))]

    @cached_property
    def _compact(self) -> tuple[Terms, Floats]:
        """The terms with a coefficient other than zero, and those coefficients."""
        used = [int(k) for k in np.flatnonzero(np.any(self.coefficients != 0, axis=0))]
        return self.terms.take(used), self.coefficients[:, used]
