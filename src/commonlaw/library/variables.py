"""Named variables, the order of a law, and which states have rates."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats, Indices
from commonlaw.errors import unknown
from commonlaw.library.functions import Function
from commonlaw.runtime.forking import cached_property

Order = int | tuple[int, ...]
"""0 in discrete time, 1 or 2; where equations differ, 1 or 2 for each state.

States and rates stand side by side in one vector: all states, and then the rates of those of second order.
"""


@dataclass(frozen=True)
class Variables:
    """The variables of terms, in the order of the columns of the array that terms are evaluated on.

    Parameters
    ----------
    states
        The states, followed by the rates of those of second order.
    inputs, time
        Measured inputs, and the name of time, the next columns.
    logarithmic
        Log-scaled states of vector fields; terms are of the states themselves.
    parameters
        Nonlinear parameters, such as K in ``s/(K + s)``: the last columns.
    orders
        The order of each equation, if they differ: else there are rates of all states, or of none.
    functions
        Functions of Python that terms may call.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...] = ()
    time: str = "t"
    logarithmic: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    orders: tuple[int, ...] = ()
    functions: tuple[Function, ...] = ()

    @property
    def arities(self) -> dict[str, int]:
        """The number of arguments of each function of Python by its name."""
        return {function.name: len(function.arguments) for function in self.functions}

    @property
    def names(self) -> tuple[str, ...]:
        """All names: states, inputs, time, parameters."""
        return (*self.measured, *self.parameters)

    @property
    def measured(self) -> tuple[str, ...]:
        """The names of what has a value at any time: states, inputs, time."""
        return (*self.states, *self.inputs, self.time)

    def order_of(self, equations: int) -> Order:
        """Return the order of a law over these variables, 1 or 2 or that of each of so many equations."""
        return self.orders or len(self.states) // equations

    def index(self, name: str) -> int:
        """Return the column of a variable; raises `CommonlawError` if there is none of that name."""
        if name not in self.names:
            raise unknown("variable", name, self.names)
        return self.names.index(name)

    def natural(self, values: Floats) -> Floats:
        """Return values of the variables, shape (n, variables), of which some were given by their logarithms."""
        if not self.logarithmic:
            return values
        result, columns = values.copy(), self.logarithmic_columns
        with np.errstate(over="ignore"):
            result[:, columns] = np.exp(result[:, columns])
        return result

    @cached_property
    def logarithmic_columns(self) -> tuple[int, ...]:
        """The columns of the states that are followed by their logarithms."""
        return self.columns(self.logarithmic)

    def columns(self, names: Sequence[str] | None = None) -> tuple[int, ...]:
        """Return the columns of the named variables; default: of all states and inputs, but not time."""
        if names is None:
            return tuple(range(len(self.states) + len(self.inputs)))
        return tuple(self.index(name) for name in names)


def order_of_each(order: Order, states: int) -> tuple[int, ...]:
    """Return the order of each equation.

    >>> order_of_each(2, 3), order_of_each((2, 1), 2)
    ((2, 2, 2), (2, 1))
    """
    return order if isinstance(order, tuple) else (order,) * states


def one_order(orders: Sequence[int]) -> Order:
    """Return the order of a law by those of its equations.

    >>> one_order([2, 2]), one_order([2, 1])
    (2, (2, 1))
    """
    return orders[0] if len({*orders}) == 1 else tuple(orders)


def highest_order(order: Order) -> int:
    """Return the largest order of an equation."""
    return max(order) if isinstance(order, tuple) else order


def with_rates(order: Order, states: int) -> Indices:
    """Return the indices of the states of second order, whose rates follow all states in this sequence.

    >>> with_rates((1, 2, 2), 3)
    array([1, 2])
    """
    return np.flatnonzero(np.array(order_of_each(order, states)) == 2)


def highest_columns(order: Order, states: int) -> Indices:
    """Return where the highest derivative of each state stands among the derivatives of states and rates.

    >>> highest_columns((1, 2, 2), 3), highest_columns(1, 2)
    (array([0, 3, 4]), array([0, 1]))
    """
    result = np.arange(states)
    second = with_rates(order, states)
    result[second] = states + np.arange(len(second))
    return result


def split_derivatives(derivatives: Sequence[Floats], order: Order) -> tuple[Floats, Floats]:
    """Return rates, shape (n, rates), and highest derivatives, (n, states), from the derivatives of all states."""
    states = derivatives[0].shape[1]
    if not isinstance(order, tuple):
        return derivatives[0][:, : states * (order - 1)], derivatives[order - 1]
    highest = [derivatives[number - 1][:, j] for j, number in enumerate(order)]
    return derivatives[0][:, with_rates(order, states)], np.stack(highest, axis=1)
