"""What commands print of a law of many objects: how its coefficients are spread, and the strangest objects."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Floats
from commonlaw.cli.output import print_table, say
from commonlaw.wording import counted

if TYPE_CHECKING:
    from commonlaw.law import Law

MANY = 50
"""Objects; of more a table with a row for each is no help to a reader."""

_STRANGEST = 10

_DEPTHS = {"median": 2, "fourth": 4, "eighth": 8, "sixteenth": 16}
"""Letter values (Tukey 1977, "Exploratory data analysis", chapter 2), by the share of objects beyond them."""

_NORMAL = 1.349
"""Standard deviations between the fourths of a normal distribution."""


def print_spread(law: "Law", heads: list[str]) -> None:
    """Print letter values of the coefficients, under these heads, and the objects farthest from the medians."""
    values, errors = law.letter_values()
    rows: list[list[object]] = []
    for name, share in _DEPTHS.items():
        sides = [(f"lower {name}", 1 / share), (f"upper {name}", 1 - 1 / share)] if share > 2 else [(name, 0.5)]
        rows += [[side, *np.quantile(values, at, axis=0).tolist()] for side, at in sides]
    rows += [["least", *values.min(axis=0).tolist()], ["largest", *values.max(axis=0).tolist()]]
    print_table([f"of {counted(len(values), 'object')}", *heads], rows)
    far, which = _distances(values)
    say(f"\nThe {_STRANGEST} objects farthest from the medians, in standard deviations of a normal spread:\n")
    strange = np.argsort(-far, kind="stable")[:_STRANGEST].tolist()
    own = (list(zip(values[i].tolist(), np.nan_to_num(errors[i]).tolist(), strict=True)) for i in strange)
    shown = [[law.objects[i], *cells, heads[which[i]], float(far[i])] for i, cells in zip(strange, own, strict=True)]
    print_table([law.schema.object, *heads, "farthest in", "by"], shown)


def _distances(values: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Return how far each object is from the medians, and in which coefficient farthest, both of shape (objects,)."""
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75], axis=0)
    scale = (high - low) / _NORMAL
    each = np.where(scale > 0, np.abs(values - middle) / np.where(scale > 0, scale, 1.0), 0.0)
    return each.max(axis=1), each.argmax(axis=1)
