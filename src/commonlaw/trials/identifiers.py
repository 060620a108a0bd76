"""Names as they are compared: of objects, trials, columns and words, however they are written."""

import math
import re
import unicodedata
from functools import lru_cache

import numpy as np


def plain(text: str) -> str:
    r"""Return a text without outer blanks, its letters composed (Unicode's form NFC).

    >>> plain(" Cafe\N{COMBINING ACUTE ACCENT}") == "Caf\N{LATIN SMALL LETTER E WITH ACUTE}"
    True
    """
    return unicodedata.normalize("NFC", text).strip()


def label(value: object) -> str:
    """Return the text by which an object or a trial is known: 1, 1.0, "1" and "1.0" are the same label.

    A value that is missing (None, NaN) has an empty one.

    >>> label(1.0), label(" 1.0"), label("Golf Ball"), label("v1.0"), label(None)
    ('1', '1', 'Golf Ball', 'v1.0', '')
    """
    if not isinstance(value, str) and _is_missing(value):
        return ""
    if isinstance(value, float | np.floating) and float(value).is_integer():
        return str(int(value))
    return _text_label(str(value))


@lru_cache(maxsize=1024)
def _text_label(text: str) -> str:
    text = plain(text)
    return text.split(".")[0] if re.fullmatch(r"[+-]?\d+\.0*", text) else text


def several_spellings(what: str, spellings: dict[str, list[str]]) -> tuple[str, ...]:
    """Return a note for each label, of objects say, that is written in several ways."""
    return tuple(
        f"{what} {name!r} is written in {len(ways)} ways, taken as one: {', '.join(map(ascii, ways))}"
        for name, ways in spellings.items()
        if len(ways) > 1
    )


def _is_missing(value: object) -> bool:
    """Say whether a value is None, NaN, or one of those of pandas, which are named after what they are."""
    is_nan = isinstance(value, float | np.floating) and math.isnan(value)
    return value is None or is_nan or type(value).__name__ in ("NAType", "NaTType")
