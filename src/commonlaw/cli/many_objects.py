"""What commands print of a law of many objects: how its coefficients are spread, and the strangest objects."""

from typing import TYPE_CHECKING

import numpy as np

from commonlaw.cli.output import print_frame, print_table, say

if TYPE_CHECKING:
    from commonlaw.law import Law

_STRANGEST = 10


def print_spread(law: "Law", heads: list[str]) -> None:
    """Print letter values of the coefficients, under these heads, and the objects farthest from the medians.

    Nothing of a law that has none.
    """
    from commonlaw.law.tables import letter_values, strangest

    if not heads:
        return
    values, errors = law.parameters.values, law.parameters.errors
    print_frame(letter_values(dict(zip(heads, values.T, strict=True)), "object"))
    say(f"\nThe {_STRANGEST} objects farthest from the medians, in standard deviations of a normal spread:\n")
    rows: list[list[object]] = []
    for i, *rest in zip(*strangest(values, heads, _STRANGEST), strict=True):
        own = zip(values[i].tolist(), np.nan_to_num(errors[i]).tolist(), strict=True)
        rows.append([law.objects[i], *own, *rest])
    print_table([law.schema.object, *heads, "farthest in", "by"], rows)
