"""Types of arrays, evenly spaced indices, and equality of what holds arrays."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]


def evenly_spaced(count: int, most: int) -> list[int]:
    """Return the indices of at most so many of a number of things, the first and the last among them.

    >>> evenly_spaced(9, 3), evenly_spaced(2, 3)
    ([0, 4, 8], [0, 1])
    """
    return [int(i) for i in np.unique(np.linspace(0, count - 1, min(count, most)).round())]


def same_content(one: Any, other: Any, without: Sequence[str] = ()) -> bool:
    """Return whether two values hold the same: arrays with NaN equal to NaN, dataclasses `without` some fields.

    >>> same_content({"x": np.array([1.0, np.nan])}, {"x": np.array([1.0, np.nan])})
    True
    """
    if one is other:
        return True
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        is_numeric = one.dtype.kind in "fc" and other.dtype.kind in "fc"
        return np.array_equal(one, other, equal_nan=is_numeric)
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(
            same_content(entry, other[name], without) for name, entry in one.items()
        )
    if isinstance(one, list | tuple) and type(one) is type(other):
        return len(one) == len(other) and all(same_content(*pair, without) for pair in zip(one, other, strict=True))
    if is_dataclass(one) and type(one) is type(other):
        compared = [field.name for field in fields(one) if field.compare and field.name not in without]
        return all(same_content(getattr(one, name), getattr(other, name), without) for name in compared)
    return bool(one == other)


def thinned(count: int, most: int = 1500) -> slice:
    """Return which of so many points stay, evenly spaced and at most so many.

    >>> list(range(10))[thinned(10, 4)]
    [0, 3, 6, 9]
    """
    return slice(None, None, -(-count // most) or 1)
