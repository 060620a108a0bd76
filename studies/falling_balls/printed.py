"""The paper's printed tables, and what it means that a number agrees with them."""

import math
from pathlib import Path

import pandas as pd

_FACTORS = {"xv": "x v", "x^2v": "x^2 v", "xv^2": "x v^2"}


def printed_table(name: str) -> pd.DataFrame:
    """Return a printed table with its cells as text, so that their digits are kept; an empty cell is empty text.

    Columns that name terms have the names that terms have in a library.
    """
    source = Path(__file__).with_name("published") / f"{name}.csv"
    return pd.read_csv(source, dtype=str, keep_default_na=False).rename(columns=_FACTORS)


def prints_as(value: float, text: str) -> bool:
    """Return whether a value prints as the text when it is rounded or cut off to the text's digits.

    The paper does both: its tables of thresholds are cut off in places.

    >>> prints_as(-0.557, "-0.56"), prints_as(-0.557, "-0.55"), prints_as(-0.557, "-0.57")
    (True, True, False)
    """
    if not text:
        return value == 0
    digits = len(text.partition(".")[2])
    cut = math.trunc(value * 10**digits) / 10**digits
    return math.isclose(float(text), float(f"{value:.{digits}f}")) or math.isclose(float(text), cut, abs_tol=1e-12)
