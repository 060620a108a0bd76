"""Column headers that carry a unit: ``height [m]``, ``Height (m)`` or, beside a time ``t/s``, ``height/m``."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from commonlaw.errors import CommonlawError, unknown
from commonlaw.trials.identifiers import plain
from commonlaw.trials.units import check_unit, known_unit

_SQUARE = re.compile(r"(.*\S)\s*\[([^\[\]]*)\]", re.DOTALL)
_ROUND = re.compile(r"(.*?\S)(\s*)\(((?:[^()]|\([^()]*\))*)\)", re.DOTALL)


_PER_UNIT = re.compile(r"(.*\S)\s*/\s*(\S+)")
_TIME_PER_UNIT = re.compile(r"(?i)(?:t|time|zeit|temps|tiempo|tempo|tijd|tid)\s*/\s*(\S+)")


def split_header(header: str) -> tuple[str, str]:
    """Return the name and the unit in a header; the unit is empty where there is none.

    What stands in brackets and is not a unit is part of the name. Empty square brackets say that the name before
    them is complete, although it looks as if it ended in a unit.

    >>> split_header("Height (m)"), split_header("drag (fitted)"), split_header("v [m/s] []")
    (('Height', 'm'), ('drag (fitted)', ''), ('v [m/s]', ''))
    """
    text = plain(header)
    square = _SQUARE.fullmatch(text)
    if square:
        unit = square[2].strip()
        return (square[1], unit) if not unit or known_unit(unit) is not None else (text, "")
    rounded = _ROUND.fullmatch(text)
    # x(t) is a function of time, not a mass of x tonnes
    if rounded and known_unit(rounded[3]) is not None and (rounded[2] or rounded[3] != "t"):
        return rounded[1], rounded[3].strip()
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
    for each in (plain(str(name)), split_header(str(name))[0], str(name).partition("/")[0].strip()):
        if each in names:
            return each
    raise unknown(kind, name, names)


def joined_units(
    headers: Mapping[str, str], given: Mapping[str, str] | None, known: Iterable[str], used: Iterable[str]
) -> dict[str, str]:
    """Return the units of the columns that are used: those from the headers, or where the user gave one that.

    An empty unit takes the one from the header away. Units can be given for the known columns.
    """
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


def _with_brackets(headers: Sequence[str]) -> list[str]:
    """Return headers such as ``U/V``, a quantity over its unit, as ``U [V]`` if that of the time, ``t/s``, is one.

    A header alone may be a ratio.
    """
    times = [known_unit(found[1]) for header in headers if (found := _TIME_PER_UNIT.fullmatch(header.strip()))]
    if not any(unit is not None and dict(unit.dimensionality) == {"[time]": 1} for unit in times):
        return list(headers)
    return [_in_brackets(header) for header in headers]


def _in_brackets(header: str) -> str:
    found = _PER_UNIT.fullmatch(header.strip())
    return f"{found[1]} [{found[2]}]" if found and known_unit(found[2]) is not None else header


def split_headers(source: str, headers: Sequence[str]) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return the names of columns and the units by name.

    Columns whose names differ in their units alone keep their whole header as the name.
    """
    blank = [number for number, header in enumerate(headers, 1) if not header.strip()]
    if blank:
        raise CommonlawError("header-missing", where=source, number=blank[0])
    parts = [split_header(header) for header in _with_brackets(headers)]
    short = Counter(name for name, _ in parts)
    names = [name if short[name] == 1 else plain(header) for (name, _), header in zip(parts, headers, strict=True)]
    numbers: dict[str, int] = {}
    for number, name in enumerate(names, 1):
        if numbers.setdefault(name, number) != number:
            raise CommonlawError("header-twice", where=source, name=name, first=numbers[name], second=number)
    return tuple(names), {name: unit for name, (_, unit) in zip(names, parts, strict=True) if unit}
