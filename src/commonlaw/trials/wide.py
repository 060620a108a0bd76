"""Columns that hold one quantity, of an object each or of one object.

Of several rules the first that holds decides:

1. Names of wells of a plate, or of conditions in one unit (``25 °C``, ``35 °C``), are objects.
2. Words with numbers that name individuals, or replicates of nearly the same values, are objects.
3. A common stem with an index, ``Cup A`` and ``Cup B`` or ``T1`` and ``T2``: coordinates (``x1``, ``pos1``,
   ``theta_1``) are states of one object; individuals (``Cup A``) are objects; all others are objects unless the data
   show that they act on each other, see `coupling`.
4. Other columns are states.
"""

import re
import unicodedata
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.trials.columns import Table
from commonlaw.trials.headers import known_unit
from commonlaw.trials.recognition import INPUT, MEASURED, QUANTITIES, SEPARATE, is_called, readable, vocabulary, words

_WELL = re.compile(r"(?:(.*[\W_]))?([A-P])0?(?:[1-9]|1\d|2[0-4])")
"""Of a plate of up to 384 wells, after the name of what was measured or without it."""
_NUMBERED = re.compile(r"(.*?)[\W_]*\d+")
_REPLICATE = re.compile(r"(.*[^\W\d_]{2})[\W_]*\d+")
"""A word of two letters at least, and a number."""
_QUALIFIED = re.compile(r"([^\W\d_]+)[\W_]+[^\W\d_]{2,}")
"""A quantity and of what it is, T_milk, but no component such as pos_x."""
_CONDITION = re.compile(r"[-+]?\d+(?:[.,]\d+)?\s*(\D+)")
"""A number with a unit, such as the temperature or the dose of a run."""
_INDEXED = re.compile(r"(.*[^\W\d_])(?:[\W_]*(\d+)|[\W_]+([A-WYZ]|[a-w]|[IVX]+))")
"""A stem and a number or letter, but no component such as pos_x."""
_COORDINATES = vocabulary("x y z u v w p q r pos position displacement angle vel velocity speed")
"""What has components, or degrees of freedom, in one object; and so have Greek letters."""
_MAX_COUPLED = 12
"""Columns of one stem up to which they may act on each other."""
_MIN_LIKE_COLUMNS, _MIN_COLUMNS = 4, 8
"""Columns of like names, and of any names, from which on they may be an object each."""
_MAX_REPLICATE_DIFFERENCE = 0.1
"""Of the range of their mean, by how much replicates differ from it; and of all values, by how much starts differ."""


class OneQuantity(NamedTuple):
    """Columns that hold one quantity of an object each, none if that is in doubt, and notes on what was assumed."""

    names: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def columns_of_one_quantity(table: Table, names: Sequence[str], times: Floats) -> OneQuantity:
    """Return those columns of numbers that hold one quantity of an object each, by the rules of this module.

    They have one unit. Times are of all rows, shape (n,).
    """
    conditions = {match[1].strip() if (match := _CONDITION.fullmatch(name)) else None for name in names}
    wells = {name: match for name in names if (match := _WELL.fullmatch(name))}
    stems = {name: match[1] for name in names if (match := _REPLICATE.fullmatch(name))}
    groups: dict[str, list[str]] = {}
    for name, stem in stems.items():
        groups.setdefault(stem, []).append(name)
    if len(wells) >= _MIN_LIKE_COLUMNS and len({well[1] for well in wells.values()}) == 1:
        letters = {well[2] for well in wells.values()}
        values = _complete(table, [*wells])
        start_alike = len(values) and np.ptp(values[0]) < _MAX_REPLICATE_DIFFERENCE * np.ptp(values)
        if len(letters) > 1 or len(wells) >= _MIN_COLUMNS or start_alike:
            return _of_one_unit(table, [*wells])
    elif len(names) > 1 and len(conditions) == 1 and (condition := conditions.pop()):
        unit = known_unit(condition)  # Lengths are the places of sensors on one object
        places = unit is not None and unit.dimensionality == {"[length]": 1}
        return OneQuantity() if places else _of_one_unit(table, names)
    elif len(stems) == len(names) > 2 and not any(map(_is_variable, stems.values())):
        individuals = all(is_called(stem, SEPARATE) for stem in stems.values())
        values = _complete(table, names)
        span = float(np.ptp(values)) if values.size else 0.0
        if individuals or (len(groups) < len(names) and all(_are_repeated(table, of, span) for of in groups.values())):
            return _of_one_unit(table, names)
    return _of_one_stem(table, names, times)


def _of_one_unit(table: Table, names: Sequence[str], *notes: str) -> OneQuantity:
    return OneQuantity(tuple(names), notes) if len({table.units.get(name) for name in names}) == 1 else OneQuantity()


def common_stem(names: Sequence[str]) -> str | None:
    """Return what names with an index begin with, None if they differ in more.

    >>> common_stem(["Cup A", "Cup B"]), common_stem(["T1", "T2"]), common_stem(["pos_x", "pos_y"])
    ('Cup', 'T', None)
    """
    matches = [_INDEXED.fullmatch(name) for name in names]
    stems = [match[1].strip(" _-.:") for match in matches if match]
    return stems[0] if len(stems) == len(names) > 1 and len({stem.casefold() for stem in stems}) == 1 else None


def _of_one_stem(table: Table, names: Sequence[str], times: Floats) -> OneQuantity:
    """Return columns of one stem with an index as objects, unless they are coordinates or act on each other."""
    alike = [name for name in names if not is_called(name, INPUT)]
    stem = common_stem(alike)
    if stem is None or words(stem)[-1] in _COORDINATES or _is_greek(words(stem)[-1]):
        return OneQuantity()
    shown = shown_columns(alike)
    if not is_called(stem, SEPARATE) and len(alike) <= _MAX_COUPLED:
        inputs = [name for name in names if name not in alike]
        if coupling(*longest_run(times, _columns(table, alike), _columns(table, inputs))):
            return OneQuantity(notes=(
                f"{shown} are taken as states of one object, as they act on each other; if each is an object, read "
                f"them with `wide={(quantity(alike, None))!r}`",
            ))  # fmt: skip
    listed = f"[{', '.join(map(repr, alike))}]" if len(alike) < _MIN_LIKE_COLUMNS else "[...]"
    note = f"{shown} are taken as an object each; if they are states of one object, name them: `states={listed}`"
    return _of_one_unit(table, alike, note)


def _columns(table: Table, names: Sequence[str]) -> Floats:
    return np.column_stack([np.empty((len(table), 0)), *(readable(table, name) for name in names)])


def longest_run(times: Floats, states: Floats, inputs: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the complete rows of the longest part of a table in which times increase."""
    complete = np.isfinite(np.column_stack([times, states, inputs])).all(axis=1)
    times, states, inputs = times[complete], states[complete], inputs[complete]
    begins = np.append(0, np.flatnonzero(np.diff(times) <= 0) + 1)
    lengths = np.diff(np.append(begins, len(times)))
    first = int(begins[np.argmax(lengths)])
    rows = slice(first, first + int(lengths.max()))
    return times[rows], states[rows], inputs[rows]


_MAX_COUPLING_P = 1e-4
"""Of the F test, up to which columns act on each other."""
_MIN_COUPLING_RATIO = 2.0
"""Of the residual variances without and with the others."""
_MIN_UNEXPLAINED = 0.01
"""Residual of the law of a column alone, of its range, from which on it needs the others."""
_RESOLVED = 0.003
"""Residual that interpolation between samples may leave, of the range."""
_MAX_COUPLING_ROWS = 400


def coupling(times: Floats, states: Floats, inputs: Floats) -> bool:
    """Say whether columns, shape (n, m), need each other to be explained, by the integral form of laws.

    By itself a column obeys ``x' = a + b x + c x^2 + d x^3``, or ``x'' = a + b x + c x'``; with the others it has their
    terms ``x_j`` and ``x x_j``, or ``x_j`` and ``x_j'``, too. Integrated once or twice, these are linear regressions of
    x on integrals, whose errors are those of measurements (F test of the larger model).
    """
    from scipy.interpolate import CubicSpline
    from scipy.special import fdtrc

    ranges = np.ptp(states, axis=0)
    if len(times) < 8 or not (ranges > 0).all():
        return False
    t, x = (times - times[0]) / np.ptp(times), (states - states.mean(axis=0)) / ranges
    u = (inputs - inputs.mean(axis=0)) / np.maximum(np.ptp(inputs, axis=0), np.finfo(float).tiny)
    rows = np.unique(np.linspace(0, len(t) - 1, min(len(t), _MAX_COUPLING_ROWS)).astype(int))

    def integral(values: Floats, times: int = 1) -> Floats:
        return np.asarray(CubicSpline(t, values).antiderivative(times)(t[rows]))

    def residual(target: Floats, *columns: Floats) -> tuple[float, int]:
        """Return the sum of squares and the degrees of freedom."""
        terms = np.column_stack([np.ones(len(rows)), t[rows], *columns])
        terms = terms / np.maximum(np.abs(terms).max(axis=0), np.finfo(float).tiny)
        coefficients, _, rank, _ = np.linalg.lstsq(terms, target, rcond=1e-10)
        squares = float(np.sum((target - terms @ coefficients) ** 2))
        return squares + len(rows) * _RESOLVED**2, len(rows) - int(rank)

    forces = [integral(column) for column in u.T]
    twice = [integral(column, 2) for column in u.T]
    for i, column in enumerate(x.T):
        others, target = np.delete(x, i, axis=1).T, column[rows]
        first = [*forces, integral(column), integral(column**2)]
        second = [*twice, t[rows] ** 2, integral(column), integral(column, 2)]
        linear = [integral(partner) for partner in others]
        products = [integral(column * partner) for partner in others]
        forced = [integral(partner, 2) for partner in others]
        squares, freedom = min(
            (residual(target, *first, integral(column**3)), residual(target, *second)), key=lambda pair: pair[0]
        )
        if freedom < 1 or squares / len(rows) < _MIN_UNEXPLAINED**2:
            continue
        for more in ([*first, *linear], [*first, *linear, *products], [*second, *forced], [*second, *forced, *linear]):
            with_others, remaining = residual(target, *more)
            gained = max(freedom - remaining, 1)
            if remaining < 3 or squares / freedom < _MIN_COUPLING_RATIO * with_others / remaining:
                continue
            if fdtrc(gained, remaining, (squares - with_others) / gained / (with_others / remaining)) < _MAX_COUPLING_P:
                return True
    return False


def _is_variable(stem: str) -> bool:
    """Say whether a name ends in a quantity or is a Greek letter, which one object may have several of."""
    return _is_greek(stem) or words(stem)[-1] in QUANTITIES


def _is_greek(word: str) -> bool:
    try:
        unicodedata.lookup(f"GREEK SMALL LETTER {word.upper()}")
    except KeyError:
        return False
    return True


def _complete(table: Table, names: Sequence[str]) -> Floats:
    """Return the rows of columns without missing values, shape (n, columns)."""
    values = np.column_stack([readable(table, name) for name in names])
    return np.asarray(values[np.isfinite(values).all(axis=1)])


def _are_repeated(table: Table, names: Sequence[str], span: float) -> bool:
    """Return whether columns are replicates: nearly equal, or both constant as blanks next to the range of all."""
    values = _complete(table, names)
    mean = values.mean(axis=1, keepdims=True)
    if not len(values):
        return False
    return bool(
        np.sqrt(np.mean((values - mean) ** 2)) < _MAX_REPLICATE_DIFFERENCE * np.ptp(mean)
        or np.ptp(values) < _MAX_REPLICATE_DIFFERENCE * span
    )


def wide_hint(table: Table, states: Sequence[str]) -> tuple[str, ...]:
    """Return a note if columns that were taken as the states of one object may well be an object each."""
    stems = {match[1].casefold() if (match := _NUMBERED.fullmatch(name)) else name for name in states}
    begins = {match[1].casefold() if (match := _QUALIFIED.fullmatch(name)) else "" for name in states}
    alike = len(states) >= _MIN_LIKE_COLUMNS and len(stems) == 1
    alike |= len(states) > 1 == len(begins) and not begins.isdisjoint(QUANTITIES | {"t", "od"})
    if not alike and (len(states) < _MIN_COLUMNS or len({table.units.get(name) for name in states}) > 1):
        return ()
    return (
        f"{shown_columns(states)} are taken as states of one object; if each is an object of its own, read them with "
        "`wide='value'`, or the name of what was measured",
    )


def quantity(columns: Sequence[str], wide: bool | str | None) -> str:
    """Return the name of the measured quantity, by default the common beginning of the names of wells, or "value".

    Letters with an index are called by the letter, T1 and T2 by T, and quantities by their name.
    """
    if isinstance(wide, str):
        return wide
    stem = common_stem(columns) or ""
    if (len(stem) == 1 and not all(map(_WELL.fullmatch, columns))) or stem.casefold() in MEASURED:
        return stem
    begins = {match[1] or "" if (match := _WELL.fullmatch(name)) else "" for name in columns}
    return (begins.pop().strip(" _-.:") if len(begins) == 1 else "") or "value"


def shown_columns(names: Sequence[str]) -> str:
    """Return names in short."""
    return f"{', '.join(names[:2])}, ..., {names[-1]} ({len(names)} columns)" if len(names) > 3 else ", ".join(names)
