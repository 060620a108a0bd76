"""Names and units: in headers of columns, of objects and trials, however they are written."""

import math
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from functools import cache, lru_cache
from itertools import product
from tokenize import TokenError
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.errors import CommonlawError, unknown
from commonlaw.runtime.forking import ProcessLock

if TYPE_CHECKING:
    import pint


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
    if value is None or type(value).__name__ in ("NAType", "NaTType"):  # Of pandas
        return ""
    if isinstance(value, float | np.floating):
        if math.isnan(value):
            return ""
        if float(value).is_integer():
            return str(int(value))
    return _text_label(str(value))


@lru_cache(maxsize=1024)
def _text_label(text: str) -> str:
    text = plain(text)
    return text.split(".")[0] if re.fullmatch(r"[+-]?\d+\.0*", text) else text


# Names, signs of degree, percent, powers and products. All else, and towers of powers, would only keep pint busy.
_UNIT = re.compile(r"[\w°%µΩ·⁻⁰¹²³⁴⁵⁶⁷⁸⁹./*^()\- ]{1,80}")
_BROKEN = re.compile("(?<=[⁰¹²³⁴⁵⁶⁷⁸⁹])⋅(?=[⁰¹²³⁴⁵⁶⁷⁸⁹])")
"""The point in a power, as pint writes it and does not read it."""
_TOWER = re.compile(r"(\*\*|\^).*(\*\*|\^)[^/* ]*(\*\*|\^)|\d{5}")


_PLAIN_POWER = re.compile(r"(?<![^\W_])(?:[cdkmnµμ]?m|s)(?=[23]\b)|[^\W\d_](?=-[1-9]\b)")
"""What is written before a power without a sign of power: mm3, mol L-1."""
_LABEL = re.compile(r"(?![dhms]-)[^\W\d_]-\d|s\d")
"""What is rather a place or an earlier sample: A-1, t-1."""
_LONGEST_UNIT = 100
"""Characters."""
_BASIS = re.compile(r"(\w+) ?/ ?\1 \w+")
"""What a share is of, such as dry matter: kg/kg dm."""
_TENS = re.compile(r"(?:[x×] ?)?10(?:(?:\^|\*\*)([369])|([³⁶⁹]))")
_THOUSANDS = {"3": "thousand ", "6": "million ", "9": "billion "}
_SPELLINGS = {
    r"(?i:\b(a\.\s?u\.|arb\.?\s?u(\.|nits?\b)|arbitrary units?\b))": "arbitrary_unit",
    r"[º˚]": "°",
    r"℃": "degC",
    r"(°|\b[Dd]eg(rees?|\.)?)\s*([CF])\b": r"deg\3",
    r"\b([mkM]?N)([cm]?m)\b": r"\1 \2",
    r"\b[Aa]mps?\b": "ampere",
    r"\bMins?\b": "min",
    r"\bpct\b": "percent",
    r"\bdps\b": "degree/s",
    r"\bkmh\b": "km/h",
    r"\blpm\b|\bLPM\b": "L/min",
    r"\bKg\b": "kg",
    r"\bms-1\b": "m/s",
    r"\bms-2\b": "m/s^2",
}
"""What people write, also what pint takes for another unit: Nm for one of yarns, amps for attometers per second."""
_LOADING = ProcessLock()

_COUNTS = (
    "cell", "individual = ind", "animal", "plant", "person = _ = people", "host", "colony = _ = colonies",
    "copy = _ = copies", "event", "spike", "photon", "colony_forming_unit = CFU = cfu",
    "plaque_forming_unit = PFU = pfu",
    "international_unit = IU", "relative_fluorescence_unit = RFU", "relative_light_unit = RLU",
    "optical_density = OD = OD600", "beat", "arbitrary_unit = arb",
)  # fmt: skip
"""What is counted in, each with its symbol and other names: numbers without a dimension, as pint's own count."""


def registry() -> "pint.UnitRegistry[float]":
    """Return the one registry of units, loaded at the first call: units of two registries cannot be compared."""
    with _LOADING.held():
        return _registry()


@cache
def _registry() -> "pint.UnitRegistry[float]":
    import pint

    made: pint.UnitRegistry[float] = pint.UnitRegistry(on_redefinition="ignore")
    made.define("year = 365.25 * day = yr = a = julian_year")  # 1/a next to a coefficient a is hard to read
    for count in _COUNTS:
        name, *others = count.split(" = ")
        made.define(" = ".join([name, "count", *others]))
    made.define("beats_per_minute = beat / minute = bpm")
    made.define("counts_per_minute = count / minute = cpm = CPM")
    made.define("@alias ohm = Ohm")
    for name, number in (("thousand", "1e3"), ("million", "1e6"), ("billion", "1e9")):
        made.define(f"{name} = {number} count = _ = {name}s")
    return made


@cache
def parse_unit(text: str) -> "pint.Unit":
    """Return the unit that a text stands for; of a number that is an empty one. Refuse others, with the nearest name.

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
    """Return the unit that a text stands for, also mol L-1, mm3, 10^6/mL, or names as in Volts; None if there is none.

    >>> str(known_unit("mol L-1")), str(known_unit("x10^6/mL")), known_unit("A-1"), known_unit("kg/kg dm")
    ('mole / liter', 'million / milliliter', None, None)
    >>> print(known_unit("Nm"), known_unit("m/s2"), known_unit("kOhm"), known_unit("deg C"), sep=", ")
    meter * newton, meter / second ** 2, kiloohm, degree_Celsius
    """
    import pint

    if len(text) > _LONGEST_UNIT or _BASIS.fullmatch(text):
        return None
    for spelling, written in _SPELLINGS.items():
        text = re.sub(spelling, written, text)
    text = _BROKEN.sub(".", text)
    spelled = [text] if _LABEL.fullmatch(text) else dict.fromkeys([text, _usual(text)])
    # pint knows no differences of logarithms, and lets errors of its tokenizer and of arithmetic on exponents through
    for candidate, as_delta in product(spelled, (True, False)):
        if not candidate.strip() or not _UNIT.fullmatch(candidate) or _TOWER.search(candidate):
            continue
        try:
            unit = registry().parse_units(candidate, as_delta=as_delta)
            registry().get_dimensionality(unit)
        except (pint.PintError, TokenError, ArithmeticError, AssertionError, KeyError, TypeError, ValueError):
            continue
        return unit
    return None


def _usual(text: str) -> str:
    """Return a unit with signs of powers, powers of ten in words, and names in small letters."""
    text = _TENS.sub(lambda match: _THOUSANDS[unicodedata.normalize("NFKC", match[1] or match[2])], text)
    names = {word: word.lower() for word in re.findall(r"[A-Z][a-z]{2,}|[A-Z]{3}", text)}
    known = {word: name for word, name in names.items() if {name, name.removesuffix("s")} & _names_of_units()}
    text = re.sub(r"[A-Za-z]+", lambda match: known.get(match[0], match[0]), text)
    return _PLAIN_POWER.sub(r"\g<0>^", text)


@cache
def _names_of_units() -> frozenset[str]:
    return frozenset(registry())


def _unknown_unit(text: str) -> CommonlawError:
    """Return the error for an unknown unit, about that one of its words that pint does not know."""
    words = re.findall(r"[^\W\d_]+", text)
    word = next((word for word in words if known_unit(word) is None), text)
    near = get_close_matches(word, [name for name in registry() if len(name) > 2], n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    whole = "" if word == text else f" in {text!r}"
    return CommonlawError("unit-unknown", unit=word, whole=whole, hint=hint)


LONGEST_NAME = 1000
"""Characters of the name of a column."""
_LONGEST_HEADER = 200
"""Characters of a header that may end in a unit."""
_SQUARE = re.compile(r"(.*\S)\s*\[([^\[\]]*)\]", re.DOTALL)
_ROUND = re.compile(r"(.*?\S)(\s*)\(((?:[^()]|\([^()]*\))*)\)", re.DOTALL)


_CONCENTRATION = re.compile(r"\[(\w+)\]\s*[(\[]?([^()\[\]]*)[)\]]?")
_BARE_UNIT = re.compile(
    r"((?:.*\s)?[^\s/]*[^\W\d_][^\s/]*)\s+([^\s/]+/(?:[dmµμun]?[lL]|s|min|h|hr|d|day)|°[CF]|%)", re.DOTALL
)
"""A unit without brackets that is no name: per volume or time, degrees, percent; but no value, as in 2 g/L."""
_PER_UNIT = re.compile(r"(.*?\S)\s*/\s*(\S.*)")
_TEMPERATURE = re.compile(r"(?i:temp|ambient)|^T(?![a-z])|^T(amb|room|air|in|out|env|water)")
"""What C and F are degrees of, and not coulombs and farads."""
_TIME_PER_UNIT = re.compile(r"(?i)(?:t|time|zeit|temps|tiempo|tempo|tijd|tid)\s*/\s*(\S+)")


def split_header(header: str) -> tuple[str, str]:
    """Return the name and the unit in a header; the unit is empty where there is none.

    Brackets around what is no unit are part of the name; empty square brackets follow a name that seems to end in a
    unit. A concentration, [A], is called after its substance. Units that are no words need no brackets.

    >>> split_header("Height (m)"), split_header("drag (fitted)"), split_header("v [m/s] []"), split_header("[A] mM")
    (('Height', 'm'), ('drag (fitted)', ''), ('v [m/s]', ''), ('A', 'mM'))
    >>> split_header("signal [a.u.]"), str(known_unit("a.u./s"))
    (('signal', 'a.u.'), 'arbitrary_unit / second')
    >>> split_header("NH4 mg/l"), split_header("Temperatur in °C"), split_header("glucose 2 g/L")
    (('NH4', 'mg/l'), ('Temperatur', '°C'), ('glucose 2 g/L', ''))
    >>> split_header("Temperature (C)"), split_header("T_room (C)"), split_header("Charge (C)")
    (('Temperature', '°C'), ('T_room', '°C'), ('Charge', 'C'))
    """
    name, unit = _split(plain(header))
    return name, f"°{unit}" if unit in ("C", "F") and _TEMPERATURE.search(name) else unit


def _split(text: str) -> tuple[str, str]:
    if len(text) > _LONGEST_HEADER:
        return text, ""
    if (match := _CONCENTRATION.fullmatch(text)) and (not match[2].strip() or known_unit(match[2]) is not None):
        return match[1], match[2].strip()
    square = _SQUARE.fullmatch(text)
    if square:
        unit = square[2].strip()
        return (square[1], unit) if not unit or known_unit(unit) is not None else (text, "")
    rounded = _ROUND.fullmatch(text)
    # x(t) is a function of time, not a mass of x tonnes
    if rounded and known_unit(rounded[3]) is not None and (rounded[2] or rounded[3] != "t"):
        return rounded[1], rounded[3].strip()
    if (bare := _BARE_UNIT.fullmatch(text)) and known_unit(bare[2]) is not None:
        return bare[1].removesuffix(" in").strip(), bare[2]
    return text, ""


def join_header(name: str, unit: str) -> str:
    """Return the header that `split_header` takes apart again.

    >>> join_header("height", "m"), join_header("height", ""), join_header("height (m)", "")
    ('height [m]', 'height', 'height (m) []')
    """
    if unit:
        return f"{name} [{unit}]"
    return name if split_header(name) == (name, "") else f"{name} []"


def find_name(name: str, known: Iterable[str], kind: str = "column") -> str:
    """Return that of the known names which is meant by a name, given as it is or as a header with its unit."""
    names = list(known)
    for spelling in (plain(str(name)), split_header(str(name))[0], str(name).partition("/")[0].strip()):
        if spelling in names:
            return spelling
    raise unknown(kind, name, names)


def joined_units(
    headers: Mapping[str, str], given: Mapping[str, str] | None, known: Iterable[str], used: Iterable[str]
) -> dict[str, str]:
    """Return the units of the columns that are used: those that are given, an empty one for none, or of headers."""
    units, known = dict(headers), list(known)
    if given is not None and not isinstance(given, Mapping):
        raise CommonlawError("units-not-by-column", units=given)
    for name, unit in (given or {}).items():
        column = find_name(name, known)
        if not isinstance(unit, str):
            raise CommonlawError("unit-not-text", column=column, unit=unit)
        if unit.strip():
            units[column] = check_unit(unit, f"column {column!r}")
        else:
            units.pop(column, None)
    return {name: units[name] for name in used if name in units}


def split_headers(source: str, headers: Sequence[str]) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return the names of columns and units by name; names that differ in units alone are whole headers.

    Headers that are all repeated in the same order are of runs next to each other, which are numbered.

    >>> split_headers("", ["t (s)", "x", "t (s)", "x"])
    (('t 1', 'x 1', 't 2', 'x 2'), {'t 1': 's', 't 2': 's'})
    """
    for number, header in enumerate(headers, 1):
        if len(header) > LONGEST_NAME:
            raise CommonlawError(
                "column-name-too-long", where=source, number=number, characters=len(header), limit=LONGEST_NAME
            )
    size = len(set(headers))
    if 1 < size < len(headers) and list(headers) == [*headers[:size]] * (len(headers) // size):
        parts = [split_header(header) for header in headers]
        headers = [join_header(f"{name} {i // size + 1}", unit) for i, (name, unit) in enumerate(parts)]
    blank = [number for number, header in enumerate(headers, 1) if not header.strip()]
    if blank:
        raise CommonlawError("header-missing", where=source, number=blank[0])
    titles = list(headers)
    times = [known_unit(match[1]) for header in headers if (match := _TIME_PER_UNIT.fullmatch(header.strip()))]
    if any(unit is not None and dict(unit.dimensionality) == {"[time]": 1} for unit in times):
        for j, header in enumerate(headers):  # As that of the time, t/s, others may be quantities over units: U/V
            match = _PER_UNIT.fullmatch(header.strip())
            if match and not split_header(header)[1] and known_unit(match[2]) is not None:
                titles[j] = f"{match[1]} [{match[2]}]"
    parts = [split_header(title) for title in titles]
    short = Counter(name for name, _ in parts)
    names = [name if short[name] == 1 else plain(header) for (name, _), header in zip(parts, headers, strict=True)]
    numbers: dict[str, int] = {}
    for number, name in enumerate(names, 1):
        if numbers.setdefault(name, number) != number:
            raise CommonlawError("header-twice", where=source, name=name, first=numbers[name], second=number)
    return tuple(names), {name: unit for name, (_, unit) in zip(names, parts, strict=True) if unit}
