"""The order of a law: one number, or where its equations differ that of each."""

from collections.abc import Sequence

import numpy as np

from commonlaw.array_types import Floats, Indices

Order = int | tuple[int, ...]
"""0 in discrete time, 1 or 2; where equations differ, 1 or 2 for each state.

States and rates stand side by side in one vector: all states, and then the rates of those of second order.
"""


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
    found = np.arange(states)
    second = with_rates(order, states)
    found[second] = states + np.arange(len(second))
    return found


def split_derivatives(derivatives: Sequence[Floats], order: Order) -> tuple[Floats, Floats]:
    """Return rates and highest derivatives from the first (and second) derivatives of all states.

    The rates are those of the states of second order, shape (n, rates); highest derivatives have the shape (n, states).
    """
    states = derivatives[0].shape[1]
    if not isinstance(order, tuple):
        return derivatives[0][:, : states * (order - 1)], derivatives[order - 1]
    highest = [derivatives[own - 1][:, j] for j, own in enumerate(order)]
    return derivatives[0][:, with_rates(order, states)], np.stack(highest, axis=1)
