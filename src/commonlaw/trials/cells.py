"""Numbers as people write them in text: decimal commas, groups of thousands, units, and marks of missing values."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Floats
from commonlaw.diagnostics import Diagnostic
from commonlaw.trials.headers import known_unit

DecimalMark = Literal[".", ","]

_MISSING = {
    *("na", "n/a", "n.a.", "nan", "null", "none", "n.d.", "nd", "missing", "-", "--", "---", "?", ".", "*"),
    *("\N{EN DASH}", "\N{EM DASH}"),
    *("#n/a", "#na", "#nan", "#null!", "#div/0!", "#value!", "#ref!", "#num!", "#name?"),
}
"""Words and signs, in small letters, for a value that is not there: of loggers, of R, of spreadsheets."""
_CENSORED = re.compile(
    r"[<>\N{LESS-THAN OR EQUAL TO}\N{GREATER-THAN OR EQUAL TO}] *\S.*|bl[oq]q|b[ql]l|bl[qd]|b[qd]l|al[oq]q|al[qd]",
    re.IGNORECASE,
)
"""<0.5, BLQ, <LOD: measured, and below or above what can be quantified."""
_BELOW = re.compile(r"[<\N{LESS-THAN OR EQUAL TO}]=? *(.*)")

_BLANKS = " '\N{RIGHT SINGLE QUOTATION MARK}\N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}\N{THIN SPACE}"
_GROUPED_BY_BLANKS = re.compile(rf"(?<![\d.,])\d{{1,3}}(?:[{_BLANKS}]\d{{3}})+(?!\d)", re.ASCII)
_WITH_UNIT = re.compile(r"([+-]?[\d.,]*\d[.,]?(?:[eE][+-]?\d+)?)(\s*)([^\d\s.,+-].*)", re.ASCII | re.DOTALL)
_UNGROUPED = re.compile(r"[+-]?\d{4,}", re.ASCII)
"""A whole number above 999 as it stands where thousands are not grouped."""
_GROUPED_FOR_SURE = re.compile(r"[+-]?\d{1,3}(?:(,\d{3})+\.\d*|(\.\d{3})+,\d*|([.,])\d{3}\3\d{3}.*)", re.ASCII)
"""1,234.5 or 1,234,567: thousands, and nothing else."""
_GROUPS: dict[DecimalMark, str] = {".": ",", ",": "."}
"""What may stand between groups of three digits, by the decimal mark."""


_NUMBERS: dict[DecimalMark, re.Pattern[str]] = {
    mark: re.compile(
        rf"[+-]?(?:(?:\d+|[1-9]\d{{0,2}}(?:[{group}]\d{{3}})+)(?:[{mark}]\d*)?|[{mark}]\d+)(?:[eE][+-]?\d+)?", re.ASCII
    )
    for mark, group in _GROUPS.items()
}


_PLAIN: dict[DecimalMark, re.Pattern[str]] = {
    mark: re.compile(rf"[+-]?(?:\d+(?:[{mark}]\d*)?|[{mark}]\d+)(?:[eE][+-]?\d+)?", re.ASCII) for mark in _GROUPS
}
"""Numbers without groups of thousands."""
_CLOCK = re.compile(r"[+-]?\d+[:-]")
"""How dates and times of day begin, and no number."""


@dataclass(frozen=True)
class Unreadable:
    """The cell for which a column is not numbers, as it is written, and why."""

    cell: str
    reason: Diagnostic
    is_ambiguous: bool = False
    """Whether it is a number by either decimal mark."""


@dataclass(frozen=True)
class Notation:
    """How cells are to be read as numbers, as far as that is known."""

    decimal: DecimalMark | None = None
    """As the user says."""
    usual: frozenset[DecimalMark] = frozenset()
    """Those that other columns of the table show."""
    missing: tuple[str, ...] = ()
    """Texts that are missing values, as the user says."""
    below: Mapping[str, float] = field(default_factory=dict)
    """Texts that stand for values below a limit of quantification, with it, as the user says."""

    @property
    def missing_numbers(self) -> dict[str, float]:
        """Of the texts that are missing values, those that are numbers."""
        return {text: float(text) for text in self.missing if _NUMBERS["."].fullmatch(text)}

    @property
    def marks_numbers(self) -> bool:
        """Whether any of these texts may be a number with a decimal comma."""
        return any(map(_PLAIN[","].fullmatch, (*self.missing, *self.below)))


@dataclass(frozen=True)
class Numerals:
    """A column of text as numbers, and how these were written."""

    values: Floats
    """Shape (n,), NaN where a value is missing."""
    decimal: DecimalMark | None = None
    """The decimal mark, if the column shows that it is no other."""
    grouped: str = ""
    """What stands between groups of three digits."""
    unit: str = ""
    """What stands behind each number."""
    missing: Mapping[str, int] = field(default_factory=dict)
    """Marks of missing values, and how many there are of each."""
    below: Floats | None = None
    """Limits that values are below, shape (n,), NaN for others; None without any."""
    censored: Mapping[str, int] = field(default_factory=dict)
    """Marks of these, and how many there are of each."""


def is_missing(cell: str) -> bool:
    """Say whether a cell marks a value that is not there."""
    return cell.strip().casefold() in _MISSING


def are_meant_as_numbers(column: NDArray[Any]) -> bool:
    """Say whether more than half of the cells of a column of text are numbers in any way of writing.

    They may have units. Cells beyond a limit count, but not where they are all, as the classes ``< 5`` and ``>= 5``
    are.
    """
    codes, unique = factorized(column)
    sizes = np.bincount(codes[codes >= 0], minlength=len(unique)).tolist()
    cells = [str(cell).strip() for cell in unique]
    others = [(cell, size) for cell, size in zip(cells, sizes, strict=True) if not _CLOCK.match(cell)]
    if 2 * sum(size for _, size in others) <= sum(sizes):
        return False
    total = sum(size for cell, size in zip(cells, sizes, strict=True) if cell and not is_missing(cell))
    texts = [(_bare(cell), size) for cell, size in others]
    numbers = [_number_and_unit(text)[0] for text, _ in texts]
    plain = [any(regex.fullmatch(number) for regex in _NUMBERS.values()) for number in numbers]
    beyond = [_CENSORED.fullmatch(text) is not None for text, _ in texts]
    meant = sum(size for (_, size), *kinds in zip(texts, plain, beyond, strict=True) if any(kinds))
    return any(plain) and meant > 0.5 * total


def factorized(column: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Return a column as codes, -1 for empty cells, and its different cells in order of their first appearance.

    Cells that are one object, such as a long text in all rows, are compared once.
    """
    import pandas as pd

    if column.dtype.kind != "O":
        return pd.factorize(column)
    which, _ = pd.factorize(np.fromiter(map(id, column), dtype=np.int64, count=len(column)))
    first = np.flatnonzero(np.diff(np.maximum.accumulate(which), prepend=-1))
    codes, cells = pd.factorize(column[first])
    return codes[which], cells


def numerals(column: NDArray[Any], notation: Notation) -> Numerals | Unreadable:
    """Return a column of text as numbers, NaN where cells are empty.

    The decimal mark is that by which all cells are numbers. A comma or a point before three digits may as well group
    thousands: another cell settles it, or the other columns of the table do; else the column is not read.
    """
    if column.dtype.kind != "O":
        with np.errstate(over="ignore"):
            return _without_sentinels(Numerals(column.astype(np.float64)), notation)
    # Points are decimal where no other column says that commas are
    if notation.decimal != "," and "," not in notation.usual:
        with suppress(TypeError, ValueError):
            numbers = column.astype(np.float64)
            text = " ".join(map(str, column.tolist()))
            if text.isascii() and "_" not in text:  # Which Python reads, too
                return _without_sentinels(Numerals(numbers), notation)
    codes, unique = factorized(column)
    if (word := _first_word([str(cell).strip() for cell in unique[:100]], notation)) is not None:
        return Unreadable(word, Diagnostic("cell-not-a-number", {"cell": word}))
    cells = [str(cell).strip() for cell in unique]
    counts = np.bincount(codes[codes >= 0], minlength=len(cells))
    plain, mark = _plain_cells(cells, notation)
    others = sorted({*range(len(cells))}.difference(plain))
    missing = {i: cell for i in others if not (cell := cells[i]) or cell in notation.missing or is_missing(cell)}
    limits = {i: limit for i in others if (limit := _limit(cells[i], notation)) is not None}
    present = [i for i in others if i not in missing and i not in limits]
    result = _read([cells[i] for i in present], notation)
    if isinstance(result, Unreadable):
        return result
    values = np.full(len(cells) + 1, np.nan)  # The last one is for the code -1 of empty cells
    values[present] = result.values
    values[plain] = [float(cells[i].replace(mark, ".")) for i in plain]
    marks = Counter[str]()
    for i, cell in missing.items():
        marks[cell] += int(counts[i]) if cell else 0
    result = replace(result, values=values[codes], missing=+marks)
    if limits:
        below = np.full(len(cells) + 1, np.nan)
        below[[*limits]] = [*limits.values()]
        censored = {cells[i]: int(counts[i]) for i in limits}
        result = replace(result, below=below[codes], censored=censored)
    return _without_sentinels(result, notation)


def _first_word(cells: Sequence[str], notation: Notation) -> str | None:
    """Return the cell for which a column is text, if one of its first few shows it, whatever the others are."""
    patterns = [pattern for mark, pattern in _NUMBERS.items() if notation.decimal in (None, mark)]
    for cell in cells:
        text = _bare(cell)
        if _number_and_unit(text)[1]:
            return None
        is_special = not cell or cell in notation.missing or cell in notation.below or is_missing(cell)
        if not (is_special or _CENSORED.fullmatch(text) or any(pattern.fullmatch(text) for pattern in patterns)):
            return cell
    return None


def _plain_cells(cells: Sequence[str], notation: Notation) -> tuple[list[int], DecimalMark]:
    """Return the indices of plain numbers that show no more of their notation than others do, and their decimal mark.

    If one number shows that a mark is decimal, others with it show nothing more; nor do further whole numbers.
    """
    marked = {*notation.missing, *notation.below}
    by_mark = {
        mark: [i for i, cell in enumerate(cells) if pattern.fullmatch(cell) and cell not in marked]
        for mark, pattern in _PLAIN.items()
        if notation.decimal in (None, mark)
    }
    mark, plain = max(by_mark.items(), key=lambda item: len(item[1]))
    ambiguous = _NUMBERS["," if mark == "." else "."]
    whole = [i for i in plain if mark not in cells[i]]
    decisive = next((i for i in plain if not ambiguous.fullmatch(cells[i])), None)
    kept = {decisive, *whole[:1], next((i for i in whole if _UNGROUPED.fullmatch(cells[i])), None)}
    return [i for i in (whole if decisive is None else plain) if i not in kept], mark


def show_commas(cells: Sequence[str]) -> bool:
    """Say whether all cells are plain numbers with a decimal comma, one of which cannot be a number with a point."""
    return all(map(_PLAIN[","].fullmatch, cells)) and not all(map(_NUMBERS["."].fullmatch, cells))


def _limit(cell: str, notation: Notation) -> float | None:
    """Return the limit of quantification that a cell says to be below of; None for any other cell."""
    if cell in notation.below:
        return notation.below[cell]
    if cell in notation.missing or (match := _BELOW.fullmatch(_bare(cell))) is None:
        return None
    number, _ = _number_and_unit(match[1])
    marks = [mark for mark in _NUMBERS if notation.decimal in (None, mark) and _NUMBERS[mark].fullmatch(number)]
    return _value(number, marks[0]) if marks else None


def _without_sentinels(found: Numerals, notation: Notation) -> Numerals:
    """Return numbers without those that are missing values, as the user says."""
    counts = {mark: int(np.sum(found.values == number)) for mark, number in notation.missing_numbers.items()}
    if not any(counts.values()):
        return found
    is_sentinel = np.isin(found.values, [*notation.missing_numbers.values()])
    missing = Counter(found.missing) + Counter(counts)
    return replace(found, values=np.where(is_sentinel, np.nan, found.values), missing=missing)


def _read(cells: Sequence[str], notation: Notation) -> Numerals | Unreadable:
    """Return different cells, none of them missing, as numbers."""
    texts = [_bare(cell) for cell in cells]
    parts = [_number_and_unit(text) for text in texts]
    units = {unit for _, unit in parts}
    unit, numbers = (units.pop(), [number for number, _ in parts]) if len(units) == 1 else ("", texts)
    marks = [
        mark
        for mark, pattern in _NUMBERS.items()
        if notation.decimal in (None, mark) and all(map(pattern.fullmatch, numbers))
    ]
    if not marks:
        return _unreadable(cells, texts, numbers, notation)
    mark: DecimalMark | None = marks[0]
    shows = len(marks) == 1 and any(candidate in number for number in numbers for candidate in ".,")
    twofold = [i for i, number in enumerate(numbers) if _is_twofold(number)]
    if len(marks) == 2 and twofold:
        mark = _settled(numbers, notation.usual)
    elif twofold and notation.decimal is None and not any(map(_GROUPED_FOR_SURE.fullmatch, numbers)):
        mark = None if any(_GROUPS[marks[0]] in numbers[i] for i in twofold) else mark
    if mark is None:
        ways = " or ".join(f"{_value(numbers[twofold[0]], candidate):g}" for candidate in _NUMBERS)
        reason = Diagnostic("decimal-mark-ambiguous", {"ways": ways})
        return Unreadable(cells[twofold[0]], reason, is_ambiguous=True)
    blanks = (match[0].strip("0123456789")[0] for cell in cells if (match := _GROUPED_BY_BLANKS.search(cell)))
    grouped = _GROUPS[mark] if any(_GROUPS[mark] in number for number in numbers) else next(blanks, "")
    values = np.array([_value(number, mark) for number in numbers], dtype=np.float64)
    return Numerals(values, mark if shows or (twofold and mark == ",") else None, grouped, unit)


def _bare(cell: str) -> str:
    """Return a cell with a plain minus, and without blanks around it or between groups of digits."""
    text = cell.strip().replace("\N{MINUS SIGN}", "-")
    return _GROUPED_BY_BLANKS.sub(lambda match: re.sub(f"[{_BLANKS}]", "", match[0]), text)


def _value(number: str, decimal: DecimalMark) -> float:
    return float(number.replace(_GROUPS[decimal], "").replace(decimal, "."))


def _is_twofold(number: str) -> bool:
    """Say whether a number is another one by the other decimal mark."""
    return all(regex.fullmatch(number) for regex in _NUMBERS.values()) and _value(number, ".") != _value(number, ",")


def _number_and_unit(text: str) -> tuple[str, str]:
    """Return a number and the unit behind it, else the text and none; 12A without a blank is a name, as of a well.

    10 am is a time of day.
    """
    match = _WITH_UNIT.fullmatch(text)
    if match is None or match[3].casefold() in ("am", "pm") or known_unit(match[3]) is None:
        return text, ""
    return (match[1], match[3]) if match[2] or not (len(match[3]) == 1 and match[3].isupper()) else (text, "")


def _settled(numbers: Sequence[str], usual: frozenset[DecimalMark]) -> DecimalMark | None:
    """Return the decimal mark of numbers of which some are others by the other mark; None if nothing settles it."""
    marks: set[DecimalMark] = {mark for mark in _NUMBERS if any(mark in number for number in numbers)}
    if len(marks) == 1 and any(map(_UNGROUPED.fullmatch, numbers)):
        return marks.pop()
    if marks == {"."}:
        return None if "," in usual else "."
    if marks == {","} == usual and not all("," in number for number in numbers):
        return None  # 998, 999, 1,000
    return next(iter(usual)) if len(usual) == 1 else None


def _unreadable(cells: Sequence[str], texts: Sequence[str], numbers: Sequence[str], notation: Notation) -> Unreadable:
    """Return the cell for which a column is not numbers; `texts` are its bare cells, `numbers` these without units."""
    patterns = [pattern for mark, pattern in _NUMBERS.items() if notation.decimal in (None, mark)]
    limits = [i for i, text in enumerate(texts) if _CENSORED.fullmatch(text)]
    wrong = [i for i, number in enumerate(numbers) if not any(pattern.fullmatch(number) for pattern in patterns)]
    words = [i for i in wrong if i not in set(limits)]
    if words:
        units = sorted({unit for text in texts if (unit := _number_and_unit(text)[1])})
        cell, has_unit = cells[words[0]], bool(_number_and_unit(texts[words[0]])[1])
        if has_unit and len(units) > 1:
            return Unreadable(cell, Diagnostic("cell-in-other-unit", {"units": units}))
        if has_unit:
            return Unreadable(cell, Diagnostic("cell-with-unit"))
        return Unreadable(cell, Diagnostic("cell-not-a-number", {"cell": cell}))
    if limits:
        marks = [cells[i] for i in limits]
        also = f" (and so for {', '.join(map(repr, marks[1:4]))}{', ...' if len(marks) > 4 else ''})" * (len(marks) > 1)
        return Unreadable(marks[0], Diagnostic("cell-censored", {"mark": marks[0], "others": also}))
    comma = next(i for i, number in enumerate(numbers) if not _NUMBERS["."].fullmatch(number))
    return Unreadable(cells[comma], Diagnostic("cell-decimal-comma"))
