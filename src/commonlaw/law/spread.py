"""How numbers of very many objects are spread: letter values, and the strangest objects."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from commonlaw.array_types import Floats
from commonlaw.wording import counted

_DEPTHS = {"fourth": 4, "eighth": 8, "sixteenth": 16}
"""Letter values (Tukey 1977, "Exploratory data analysis", chapter 2) on each side of the median: one object in so many
is beyond them."""

_NORMAL = 1.349
"""Standard deviations between the fourths of a normal distribution."""


def letter_values(columns: Mapping[str, Floats], of: str) -> pd.DataFrame:
    """Return the letter values of columns of numbers, a row for each value and a column for each.

    >>> table = letter_values({"mass": np.arange(101.0)}, "object")
    >>> table.set_index("of 101 objects")["mass"].to_dict()["upper fourth"]
    75.0
    """
    values = np.stack([*columns.values()], axis=1)
    rows = [("median", 0.5)]
    for name, depth in _DEPTHS.items():
        rows += [(f"lower {name}", 1 / depth), (f"upper {name}", 1 - 1 / depth)]
    rows += [("least", 0.0), ("largest", 1.0)]
    found = np.quantile(values, [share for _, share in rows], axis=0, method="linear")
    names = pd.DataFrame({f"of {counted(len(values), of)}": [name for name, _ in rows]})
    return pd.concat([names, pd.DataFrame(found, columns=list(columns))], axis=1)


def strangest(values: Floats, heads: Sequence[str], count: int) -> tuple[list[int], list[str], list[float]]:
    """Return the objects farthest from the medians, the farthest first, in what they are, and by how much.

    Parameters
    ----------
    values
        Shape (objects, columns).
    heads
        Names of the columns.
    count
        Of objects.

    Returns
    -------
    indices, columns, distances
        Distances are in standard deviations of a normal distribution with the same fourths.
    """
    far, which = _distances(values)
    chosen = np.argsort(-far, kind="stable")[:count]
    return chosen.tolist(), [heads[i] for i in which[chosen].tolist()], far[chosen].tolist()


def _distances(values: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Return how far each object is from the medians, and in which column farthest, both of shape (objects,)."""
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75], axis=0)
    scale = (high - low) / _NORMAL
    each = np.where(scale > 0, np.abs(values - middle) / np.where(scale > 0, scale, 1.0), 0.0)
    return each.max(axis=1), each.argmax(axis=1)
