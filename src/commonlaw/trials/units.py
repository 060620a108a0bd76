"""Units of measurement, read by pint when they are needed."""

import re
from contextlib import suppress
from difflib import get_close_matches
from functools import cache
from threading import Lock
from tokenize import TokenError
from typing import TYPE_CHECKING

from commonlaw.errors import CommonlawError

if TYPE_CHECKING:
    import pint

# Names, signs of degree, percent, powers and products. All else, and towers of powers, would only keep pint busy.
_UNIT = re.compile(r"[\w°%µΩ·⁻⁰¹²³⁴⁵⁶⁷⁸⁹./*^()\- ]{1,80}")
_BROKEN = re.compile("(?<=[⁰¹²³⁴⁵⁶⁷⁸⁹])⋅(?=[⁰¹²³⁴⁵⁶⁷⁸⁹])")
"""The point in a power, as pint writes it and does not read it."""
_TOWER = re.compile(r"(\*\*|\^).*(\*\*|\^)[^/* ]*(\*\*|\^)|\d{5}")


_LOADING = Lock()

_COUNTS = (
    "cell", "individual", "animal", "plant", "person = _ = people", "host", "colony = _ = colonies",
    "copy = _ = copies", "event", "spike", "photon", "colony_forming_unit = CFU = cfu",
    "plaque_forming_unit = PFU = pfu",
    "international_unit = IU", "relative_fluorescence_unit = RFU", "relative_light_unit = RLU",
    "optical_density = OD = OD600",
)  # fmt: skip
"""What biologists count in, each with its symbol and other names: numbers without a dimension, as pint's own count."""


def registry() -> "pint.UnitRegistry[float]":
    """Return the one registry of units, loaded at the first call: units of two registries cannot be compared."""
    with _LOADING:
        return _registry()


@cache
def _registry() -> "pint.UnitRegistry[float]":
    import pint

    made: pint.UnitRegistry[float] = pint.UnitRegistry()
    for count in _COUNTS:
        name, *others = count.split(" = ")
        made.define(" = ".join([name, "count", *others]))
    return made


@cache
def parse_unit(text: str) -> "pint.Unit":
    """Return the unit that a text stands for; of a number that is an empty one, as pint writes it.

    Raises
    ------
    CommonlawError
        If pint does not know the unit; the message has the nearest name that it knows.

    Examples
    --------
    >>> print(parse_unit("m/s^2"), parse_unit("m⁰⋅⁵"), parse_unit("dB/s"), parse_unit(""), sep=", ")
    meter / second ** 2, meter ** 0.5, decibel / second, dimensionless
    """
    unit = known_unit(text) if text else registry().dimensionless
    if unit is None:
        raise _unknown_unit(text)
    return unit


def check_unit(text: str, where: str) -> str:
    """Return a unit's text without outer blanks; refuse one, of ``"column 'height'"`` say, that pint does not read."""
    if known_unit(text) is None:
        raise _unknown_unit(text).at(where)
    return text.strip()


@cache
def known_unit(text: str) -> "pint.Unit | None":
    """Return the unit that a text stands for, or None if pint knows none."""
    import pint

    text = _BROKEN.sub(".", text)
    if not text.strip() or not _UNIT.fullmatch(text) or _TOWER.search(text):
        return None
    # pint knows no differences of logarithms, and lets errors of its tokenizer and of arithmetic on exponents through
    for as_delta in (True, False):
        with suppress(pint.PintError, TokenError, ArithmeticError, AssertionError, KeyError, TypeError, ValueError):
            unit = registry().parse_units(text, as_delta=as_delta)
            registry().get_dimensionality(unit)
            return unit
    return None


def _unknown_unit(text: str) -> CommonlawError:
    """Return the error for an unknown unit, about that one of its words that pint does not know."""
    words = re.findall(r"[^\W\d_]+", text)
    word = next((each for each in words if known_unit(each) is None), text)
    near = get_close_matches(word, [name for name in registry() if len(name) > 2], n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    whole = "" if word == text else f" in {text!r}"
    return CommonlawError("unit-unknown", unit=word, whole=whole, hint=hint)
