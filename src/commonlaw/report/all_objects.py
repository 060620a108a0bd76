"""The part of a law's report on all objects of a stream, of which the others show few."""

from collections.abc import Iterator
from functools import partial

import numpy as np
import pandas as pd

from commonlaw.law import Law
from commonlaw.law.numbers import with_error
from commonlaw.law.spread import letter_values, strangest
from commonlaw.law.text import MANY
from commonlaw.plots import plot_intervals
from commonlaw.report.document import Block, Picture, Section, Table, Text
from commonlaw.report.formulas import coefficient_names
from commonlaw.verdict import ManyFindings
from commonlaw.wording import counted, r_squared_text

_STRANGEST = 10
"""Objects that are named each, those with the strangest coefficients and those with the worst forecasts."""


def all_objects(found: ManyFindings) -> Section:
    """Return the part on all objects."""
    law, blocks = found.law, [Text(_intro(found))]
    several = len(law.objects) > MANY and law.support.any()
    return Section(
        "all-objects", "All objects", (*blocks, *_forecasts(found), *(_coefficients(law) if several else ()))
    )


def _intro(found: ManyFindings) -> str:
    shown = counted(len(found.few.trials.objects), "object")
    bands = (
        "" if np.isnan(found.coverage) else f" The 95 % bands hold {100 * found.coverage:.3g} % of the measurements."
    )
    diverged = f" {found.diverged} of the forecasts run away." if found.diverged else ""
    return (
        f"{found.forecast_of} were forecast, each from initial conditions fitted to its first samples: "
        f"$R^2 = {r_squared_text(found.score)}$.{bands}{diverged} "
        f"The verdict and the other parts of this page are about {shown} that stand for all, evenly "
        "by rank of how well they are forecast, the best and the worst among them."
    )


def _forecasts(found: ManyFindings) -> Iterator[Block]:
    relative = found.relative.replace(np.inf, np.nan).dropna()
    name = found.errors.columns[0]
    if len(relative) > MANY:
        caption = "Errors of the forecasts of objects, in units of the spread of the states: letter values."
        yield Table("errors-of-all", caption, letter_values({"rms error": relative.to_numpy()}, "object"))
    worst = found.relative.iloc[::-1][:_STRANGEST]
    frame = pd.DataFrame({name: worst.index.astype(str), "rms error": worst.to_numpy()})
    caption = f"The {counted(len(worst), 'object')} with the worst forecasts, in the same units."
    yield Table("worst", caption, frame)


def _coefficients(law: Law) -> Iterator[Block]:
    heads = [f"{name} [{unit}]" if unit else name for name, unit in coefficient_names(law)]
    values, errors = law.letter_values()
    differ = ~np.isclose(values, values[0], rtol=1e-9).all(axis=0)  # What is universal is said above
    if differ.any():
        heads, values, errors = (
            [each for each, own in zip(heads, differ, strict=True) if own],
            values[:, differ],
            errors[:, differ],
        )
        spread = letter_values(dict(zip(heads, values.T, strict=True)), "object")
        yield Table("spread", "Coefficients of all objects: letter values (Tukey 1977).", spread)
        indices, columns, far = strangest(values, heads, _STRANGEST)
        cells = [
            [with_error(*pair) for pair in zip(values[i].tolist(), np.nan_to_num(errors[i]).tolist(), strict=True)]
            for i in indices
        ]
        frame = pd.DataFrame(cells, columns=heads)
        frame.insert(0, law.schema.object, [law.objects[i] for i in indices])
        caption = "The objects farthest from the medians, in standard deviations of a normal spread."
        frame["farthest in"], frame["by"] = columns, far
        yield Table("strangest", caption, frame)
    yield Picture("coefficients-of-all", "Coefficients of all objects in order.", partial(plot_intervals, law))
