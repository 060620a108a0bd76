"""Types of arrays, and evenly spaced indices."""

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
