"""A table as it came in: named columns, their units, and where each row stands; and frames as such tables."""

import numbers
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.runtime.forking import cached_property
from commonlaw.text import counted
from commonlaw.trials.cells import (
    DecimalMark,
    Notation,
    Numerals,
    Unreadable,
    are_meant_as_numbers,
    factorized,
    numerals,
)
from commonlaw.trials.headers import find_name, known_unit, label, plain, split_headers
from commonlaw.trials.reading import WrittenReading
from commonlaw.trials.trial import EXTREME, nearest

if TYPE_CHECKING:
    import narwhals as nw

Codes = NDArray[np.int64]
Column = NDArray[Any]
"""Numbers; or, of dtype object, cells of one other kind (text, dates, ...) with NaN or None where they are empty."""

_POINT = re.compile(r"^[+-]?(0|\d{4,})?\.|\.(?!\d{3}$)")
"""A point that groups no thousands."""
_SWITCHES = [
    {"off": 0.0, "on": 1.0},
    {"false": 0.0, "true": 1.0},
    {"closed": 0.0, "open": 1.0},
    {"no": 0.0, "yes": 1.0},
]
"""Words for the states of a switch."""
_INDEX = re.compile(r"__index_level_\d+__|Unnamed: \d+|index|level_\d+|row[._ ]?(names?|id)|\.{3}\d+", re.IGNORECASE)
"""What pandas and R call an index that has no name; the first of these is called nothing else."""


def _plain(value: object) -> object:
    return plain(value) if isinstance(value, str) else value


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of numbers and of text, all of the same length, with at least one row."""

    source: str
    """Where the table came from, for messages: ``drops.csv``."""
    columns: Mapping[str, Column]
    units: Mapping[str, str]
    """Unit by column name, from the headers."""
    locate: Callable[[int], str]
    """From the index of a row to its location for the reader: ``row 17 (line 18)``."""
    number: Callable[[int], int] = lambda row: row + 1
    """From the index of a row to its number in the file: of the line, or of the row of a sheet."""
    loose: frozenset[str] = frozenset()
    """Columns of text whose cells may be meant as numbers: all those of a text file, mixed ones of a worksheet."""
    notation: Notation = field(default_factory=Notation)
    """How numbers are written in the columns of text."""
    roles: WrittenReading = field(default_factory=WrittenReading)
    """Names of columns by role, where the file says so itself."""
    label: str = "object"
    """Name of the object, if no column names it."""
    notes: tuple[str, ...] = ()
    facts: tuple[str, ...] = ()
    """What was guessed of how the table is written."""
    calendar: bool = False
    """Whether the column of times had dates or times of day."""
    parsed: dict[str, Numerals | Unreadable] = field(default_factory=dict)
    """Columns of text as far as they have been read as numbers."""
    meant: dict[str, bool] = field(default_factory=dict)
    """Whether they are meant as numbers, as far as that has been asked."""
    coded: dict[str, tuple[Column, Codes]] = field(default_factory=dict)
    """Columns, and their codes, as far as these have been asked for."""
    rows: Codes = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    """Index of each row in the table as it came in, shape (n,)."""
    doses: Column | None = None
    """The doses of each row's trial, shape (n,), a tuple that its rows share; None if the table records none."""
    administered: tuple[str, ...] = ()
    """The columns of their amounts and rates."""
    plain: frozenset[str] = frozenset()
    """Columns of numbers that are text in the file, with a decimal mark or whole."""
    commas: frozenset[str] = frozenset()
    """Of these, those whose decimal mark is a comma."""
    written: Callable[[Sequence[str]], list[Column]] = lambda _: []
    """From names of plain columns to their cells as written, in all rows of the table as it came in."""

    def __post_init__(self) -> None:
        if not len(self):
            raise CommonlawError("table-without-rows", where=self.source)
        if not len(self.rows):
            object.__setattr__(self, "rows", np.arange(len(self)))

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def find(self, name: str) -> str:
        """Return the name of a column, which may be given with its unit."""
        try:
            return find_name(name, self.columns)
        except CommonlawError as error:
            raise error.at(self.source) from None

    @cached_property
    def numeric(self) -> tuple[str, ...]:
        """The columns that hold numbers, see `is_numeric`."""
        return tuple(name for name in self.columns if self.is_numeric(name))

    def is_numeric(self, name: str) -> bool:
        """Say whether a column holds numbers; more than half of the cells will do where text may be meant as such."""
        column = self.columns[name]
        if name not in self.loose:
            return column.dtype.kind in "iuf"
        if name not in self.meant:
            parsed = self._parsed(name)
            self.meant[name] = (
                are_meant_as_numbers(column) if isinstance(parsed, Unreadable) else not np.isnan(parsed.values).all()
            )
        return self.meant[name]

    def numbers(self, name: str, *, missing: bool = False) -> Floats:
        """Return a column as numbers, shape (n,), NaN where a cell is empty if it may be `missing`."""
        column = self.columns[name]
        if column.dtype.kind != "O":
            with np.errstate(over="ignore"):
                values = column.astype(np.float64)
        elif name not in self.loose and _kind(column) != "str":
            raise CommonlawError("column-not-numbers", where=self.source, column=name, kind=_kind(column))
        elif isinstance(parsed := self._parsed(name), Unreadable) and self.is_switch(name):
            words = {word: state for states in _SWITCHES for word, state in states.items()}
            values = np.array([words.get(cell.casefold(), np.nan) for cell in self._cells(name)])
        elif isinstance(parsed, Unreadable):
            where = self._where(name, self._cells(name).index(parsed.cell))
            raise CommonlawError("cell-unreadable", where=where, cell=parsed.cell, reason=parsed.reason)
        else:
            values = parsed.values
        bad = np.flatnonzero(np.isinf(values) if missing else ~np.isfinite(values))
        if len(bad):
            row = int(bad[0])
            what = "is infinite" if np.isinf(values[row]) else "is missing"
            count = "" if len(bad) == 1 else f" ({len(bad)} values of the column are missing or infinite)"
            raise CommonlawError("cell-value", where=self._where(name, row), value=what, count=count)
        extreme = np.flatnonzero(np.abs(values) > EXTREME)
        if len(extreme):
            row = int(extreme[0])
            raise CommonlawError("cell-extreme", where=self._where(name, row), value=values[row], limit=EXTREME)
        return values

    def is_switch(self, name: str) -> bool:
        """Say whether a column holds both words for the states of a switch, which are read as 1 and 0."""
        column = self.columns[name]
        if column.dtype.kind != "O":
            return False
        words, cells = set[str](), set[object]()
        for cell in column:
            if isinstance(cell, str) and cell not in cells:
                cells.add(cell)
                words |= {cell.strip().casefold()} - {""}
            if len(words) > 2:
                return False
        return any(words == {*states} for states in _SWITCHES)

    def limits(self, name: str) -> Floats:
        """Return the limits that values of a column are below of, shape (n,), NaN for others."""
        parsed = self._parsed(name) if name in self.loose else None
        return parsed.below if isinstance(parsed, Numerals) and parsed.below is not None else np.full(len(self), np.nan)

    def deviations(self, name: str, needed: Bools) -> Floats:
        """Return a column of standard deviations, shape (n,), NaN where a cell is empty; some are `needed`."""
        values = self.numbers(name, missing=True)
        bad = np.flatnonzero((values <= 0) | (np.isnan(values) & needed))
        if len(bad):
            row = int(bad[0])
            what = "missing" if np.isnan(values[row]) else f"{values[row]:g}"
            raise CommonlawError("cell-deviation", where=self._where(name, row), value=what)
        return values

    def encoded(self, name: str, read: Callable[[object], object] = _plain) -> tuple[Codes, list[object]]:
        """Return a column as codes, shape (n,), -1 for empty cells, and the values that they stand for, `read` once."""
        column = self.columns[name]
        if name in self.plain and column.dtype.kind == "f":  # Not to call 0.10 otherwise than it is written
            column = self.texts([name])[0]
        try:
            codes, cells = factorized(column)
        except TypeError:
            raise CommonlawError("column-not-text", where=self.source, column=name, kind=_kind(column)) from None
        read_values = [read(value) for value in cells.tolist()]
        values = [value for value in dict.fromkeys(read_values) if value != ""]
        numbered = {value: code for code, value in enumerate(values)}
        # The last one is for the code -1 of empty cells
        renumbered = np.array([numbered.get(value, -1) for value in read_values] + [-1])
        return renumbered[codes], values

    def codes(self, name: str) -> Codes:
        """Return a column as codes, shape (n,), -1 for empty cells; numbers that are equal have the same one."""
        column = self.columns[name]
        if name not in self.coded or self.coded[name][0] is not column:
            codes = self.encoded(name)[0] if column.dtype.kind == "O" else factorized(column)[0]
            self.coded[name] = column, codes
        return self.coded[name][1]

    def texts(self, names: Sequence[str]) -> list[Column]:
        """Return columns as they are written, those of text; others as they are."""
        plain = [name for name in names if name in self.plain]
        written = dict(zip(plain, self.written(plain) if plain else (), strict=True))
        return [written[name][self.rows] if name in written else self.columns[name] for name in names]

    @property
    def fractional(self) -> list[str]:
        """The columns of plain numbers with a decimal point, or a missing value."""
        plain = self.plain - self.commas
        return [name for name in self.columns if name in plain and self.columns[name].dtype.kind == "f"]

    def as_texts(self, names: Sequence[str]) -> "Table":
        """Return the table with columns of plain numbers as the text that they are in the file."""
        columns = {**self.columns, **dict(zip(names, self.texts(names), strict=True))}
        loose, plain, commas = self.loose | {*names}, self.plain - {*names}, self.commas - {*names}
        return replace(self, columns=columns, loose=loose, plain=plain, commas=commas, parsed={}, meant={})

    def joined(self, name: str | None) -> "Table":
        """Return the table with a column of the cells of several that its name lists: ``strain, dose``."""
        names = (name or "").split(", ")
        if name in self.columns or len(names) < 2 or not self.columns.keys() >= {*names}:
            return self
        cells = [[label(cell) for cell in column.tolist()] for column in self.texts(names)]
        texts = np.array([", ".join(parts) if all(parts) else "" for parts in zip(*cells, strict=True)], dtype=object)
        return replace(self, columns={**self.columns, ", ".join(names): texts})

    def taken(self, rows: Codes) -> "Table":
        """Return the table of some of the rows, by their indices."""
        return replace(
            self,
            columns={name: column[rows] for name, column in self.columns.items()},
            rows=self.rows[rows],
            doses=None if self.doses is None else self.doses[rows],
            locate=lambda row: self.locate(int(rows[row])),
            number=lambda row: self.number(int(rows[row])),
            parsed={},
            meant={},
        )

    def is_index(self, name: str) -> bool:
        """Say whether a column numbers the rows, such as an unnamed index of pandas or R."""
        if not _INDEX.fullmatch(name):
            return False
        parsed = self._parsed(name) if name in self.loose else None
        values = parsed.values if isinstance(parsed, Numerals) else self.columns[name]
        return name.startswith("__index_level_") or (values.dtype.kind in "iuf" and _numbers_rows(values))

    def _cells(self, name: str) -> list[str]:
        """Return the cells of a column of text without blanks around them; empty ones are empty texts."""
        return [cell.strip() if isinstance(cell, str) else "" for cell in self.columns[name].tolist()]

    def _parsed(self, name: str) -> Numerals | Unreadable:
        """Return a column of text as numbers, NaN where one is missing, or why it is none."""
        if name not in self.parsed:
            self.parsed[name] = numerals(self.columns[name], self.notation)
        return self.parsed[name]

    def _where(self, name: str, row: int) -> str:
        return f"{self.source}: column {name!r}, {self.locate(row)}"


def stacked_column(parts: Sequence[tuple[Table, str]]) -> Column:
    """Return columns of tables below each other: numbers, or all as written where one of them is text."""
    columns = [table.columns[name] for table, name in parts]
    if any(column.dtype.kind == "O" for column in columns):
        columns = [table.texts([name])[0] for table, name in parts]
    return np.concatenate(columns)


def with_numbers(table: Table, notation: Notation) -> Table:
    """Return the table with its columns read as numbers, and facts of how these were written.

    Columns that are ambiguous by themselves have the decimal mark of the others.
    """
    if notation.decimal == ",":
        table = table.as_texts(table.fractional)
    elif table.commas and (notation.decimal == "." or notation.marks_numbers):
        table = table.as_texts([*table.commas])
    loose = [name for name in table.columns if name in table.loose]
    parsed = {
        name: Numerals(column, ",") if name in table.commas else numerals(column, notation)
        for name, column in table.columns.items()
        if name in table.loose | table.commas
    }
    shown = {mark for result in parsed.values() if (mark := _decimal(result)) is not None}
    if "," in shown:
        table = table.as_texts(table.fractional)
        loose = [name for name in table.columns if name in table.loose]
    if "," in shown or any(isinstance(result, Unreadable) and result.is_ambiguous for result in parsed.values()):
        others = [name for name in (*loose, *table.fractional) if _decimal(parsed.get(name)) != ","]
        shown |= {"."} if any(map(_shows_points, table.texts(others))) else set()
        notation = replace(notation, usual=frozenset(shown))
        # A column that shows its decimal mark is read as before
        again = [name for name in loose if _decimal(parsed.get(name)) is None]
        parsed |= {name: numerals(table.columns[name], notation) for name in again}
    columns = dict(table.columns)
    if notation.missing_numbers:
        parsed |= {name: numerals(column, notation) for name, column in columns.items() if column.dtype.kind in "iuf"}
    read = {
        name: result
        for name, result in parsed.items()
        if isinstance(result, Numerals) and np.isfinite(result.values).any()
    }
    columns |= {name: result.values for name, result in read.items() if name not in table.loose and result.missing}
    for name, result in read.items():
        if result.unit and known_unit(table.units.get(name, result.unit)) != known_unit(result.unit):
            raise CommonlawError(
                "units-differ", where=table.source, column=name, header=table.units[name], cells=result.unit
            )
    marks = {mark: [name for name, result in read.items() if result.grouped == mark] for mark in ",. '"}
    by_blanks = [name for name, result in read.items() if result.grouped and result.grouped not in marks]
    names_by_fact = {
        "a comma is read as the decimal point": [name for name, result in read.items() if result.decimal == ","],
        **{f"{mark!r} groups thousands": names for mark, names in marks.items()},
        "blanks group thousands": by_blanks,
        "the cells hold units": [f"{name} [{result.unit}]" for name, result in read.items() if result.unit],
    }
    facts = [f"{fact} ({', '.join(names)})" for fact, names in names_by_fact.items() if names]
    for name, result in read.items():
        counts = [f"{mark!r} in {counted(count, 'cell')}" for mark, count in result.missing.items()]
        facts += [f"read as missing in {name}: {', '.join(counts)}"] if counts else []
        counts = [f"{mark!r} in {counted(count, 'cell')}" for mark, count in result.censored.items()]
        facts += [f"below a limit of quantification in {name}, for cl.fit alone: {', '.join(counts)}"] if counts else []
    return replace(
        table,
        columns=columns,
        units={name: result.unit for name, result in read.items() if result.unit} | dict(table.units),
        notation=notation,
        parsed={name: parsed[name] for name in loose},
        meant={},
        facts=(*table.facts, *facts),
    )


def _decimal(result: Numerals | Unreadable | None) -> DecimalMark | None:
    """Return the decimal mark that a column shows."""
    return result.decimal if isinstance(result, Numerals) else None


def _shows_points(column: Column) -> bool:
    """Say whether a column of text has numbers with a point that can only be the decimal one."""
    parsed = numerals(column, Notation())
    if isinstance(parsed, Unreadable) or parsed.decimal == ",":
        return False
    return parsed.decimal == "." or any(_POINT.search(cell.strip()) for cell in column if isinstance(cell, str))


def filled_table(
    source: str,
    headers: Sequence[str],
    columns: Sequence[Column],
    *,
    loose: Sequence[int] = (),
    locate: Callable[[int], str] = lambda row: f"row {row + 1}",
    number: Callable[[int], int] = lambda row: row + 1,
    written: Callable[[Sequence[int]], list[Column]] | None = None,
    commas: Collection[int] = (),
) -> Table:
    """Return the table of these columns without the rows and the nameless columns in which nothing stands.

    Those that are not `loose` are `written` as text by their indices, where this is not None, `commas` of them with a
    decimal comma.
    """
    empty = [_missing(column) for column in columns]
    used = [i for i, header in enumerate(headers) if header.strip() or not empty[i].all()]
    titles = [headers[i] for i in used]
    if len(used) > 1 and not titles[0].strip():
        first = numerals(columns[used[0]], Notation())
        if isinstance(first, Unreadable) or _numbers_rows(first.values):  # Words, or numbers of rows
            # As pandas calls a first column without a header
            titles[0] = "Unnamed: 0"
    names, units = split_headers(source, titles)
    blank = np.logical_and.reduce([empty[i] for i in used]) if used else np.ones(0, dtype=bool)
    rows = np.flatnonzero(~blank)
    arrays = {name: columns[i][rows] if blank.any() else columns[i] for name, i in zip(names, used, strict=True)}
    loosely = frozenset(name for name, i in zip(names, used, strict=True) if i in loose)
    truths = {name: values for name in loosely if (values := _truths(arrays[name])) is not None}
    arrays, loosely = arrays | truths, loosely - {*truths}
    where = lambda row: locate(int(rows[row])), lambda row: number(int(rows[row]))
    table = Table(source, arrays, units, *where, loosely)
    if written is None:
        return table
    indices = dict(zip(names, used, strict=True))
    plain = frozenset(name for name in names if indices[name] not in loose)
    cells = written
    return replace(
        table,
        plain=plain,
        commas=frozenset(name for name in names if indices[name] in commas),
        written=lambda texts: [column[rows] for column in cells([indices[name] for name in texts])],
    )


def _truths(column: Column) -> Column | None:
    """Return 1 for true and 0 for false, as of booleans, of a column of these words alone; None of any other."""
    states, values = {"true": True, "false": False}, list[bool | None]()
    for cell in column:
        word = cell.strip().casefold() if isinstance(cell, str) else ""
        if word and word not in states:
            return None
        values.append(states.get(word))
    return None if not {*values} - {None} else column_of(values)[0]


def _numbers_rows(values: Column) -> bool:
    """Say whether numbers are whole and none is there twice, as those of rows are in whatever order."""
    return bool(np.all(values == np.round(values)) and len(np.unique(values)) == len(values))


def column_of(cells: Sequence[Any]) -> tuple[Column, bool]:
    """Return cells as a column, and whether they were of several kinds and became text."""
    column = np.fromiter(cells, dtype=object, count=len(cells))
    try:
        empty = _missing(column)
    except InvalidOperation:  # A signalling NaN may not even be compared
        return column_of([None if isinstance(cell, Decimal) and cell.is_snan() else cell for cell in cells])
    column[empty] = np.nan
    present = column[~empty]
    families = (bool, np.bool_), (numbers.Real, Decimal), (str,), (date,)
    types = {type(cell) for cell in present}
    kinds = {next((family[0] for family in families if issubclass(kind, family)), kind) for kind in types}
    if len(kinds) > 1:
        column[~empty] = [str(cell) for cell in present]
        return column, True
    if not kinds <= {bool, numbers.Real}:
        return column, False
    whole = not empty.any() and all(isinstance(cell, numbers.Integral) for cell in present)
    try:
        with np.errstate(over="ignore"):  # Of long doubles; what is infinite is refused
            return column.astype(np.int64 if whole and len(column) else np.float64), False
    except OverflowError:
        return np.array([nearest(cell) for cell in column.tolist()]), False


def frame_table(frame: Any, source: str = "the frame") -> Table:
    """Return the table in a frame, as narwhals reads it, a mapping, a structured array or an xarray Dataset."""
    import narwhals as nw
    import pandas as pd

    units = dict[str, str]()
    if hasattr(frame, "data_vars"):  # An xarray Dataset
        attributes = {str(name): variable.attrs.get("units") for name, variable in frame.variables.items()}
        units = {name: unit for name, unit in attributes.items() if isinstance(unit, str) and known_unit(unit)}
        frame = frame.to_dataframe().reset_index()
    elif isinstance(frame, Mapping) or (isinstance(frame, np.ndarray) and frame.dtype.names):
        fields = frame if isinstance(frame, Mapping) else {name: frame[name] for name in frame.dtype.names or ()}
        quantities = {str(name): with_unit(values) for name, values in fields.items()}
        units = {name: unit for name, (_, unit) in quantities.items() if unit}
        # In order whatever their indices are, and the bytes of a structured array as text
        arrays = {
            name: values.to_numpy() if hasattr(values, "to_numpy") else values
            for name, (values, _) in quantities.items()
        }
        for name in frame.dtype.names or () if isinstance(frame, np.ndarray) else ():
            arrays[name] = np.char.decode(frame[name], "utf-8") if frame[name].dtype.kind == "S" else frame[name]
        try:
            frame = pd.DataFrame(arrays)
        except (TypeError, ValueError) as error:
            raise CommonlawError("columns-unequal", where=source, problem=error) from None
    elif nw.dependencies.is_pandas_dataframe(frame):
        # Levels of the index that have a name are columns; only pandas has such a thing
        named = [name for name in frame.index.names if name is not None]
        twice = next((name for name in named if named.count(name) > 1 or name in frame.columns), None)
        if twice is not None:
            raise CommonlawError("index-twice", where=source, name=str(twice))
        frame = frame.reset_index(level=named) if named else frame
    try:
        data = nw.from_native(frame)
    except nw.exceptions.DuplicateError as error:
        text = " ".join(str(error).split())
        raise CommonlawError("column-twice", where=source, problem=text) from None
    except TypeError:
        raise CommonlawError("frame-unknown", type=type(frame).__name__) from None
    if isinstance(data, nw.LazyFrame):
        try:
            data = data.collect()
        except Exception as error:  # Whatever the engine of the frame raises, in computing what the user asked of it
            kind, text = type(error).__name__, " ".join(str(error).split())
            raise CommonlawError("frame-not-computed", source=source, problem=kind, text=text) from error
    headers = [str(name) for name in data.columns]
    columns = [_series_column(column) for column in data.iter_columns()]
    loose = [i for i, (_, is_mixed) in enumerate(columns) if is_mixed]
    table = filled_table(source, headers, [column for column, _ in columns], loose=loose)
    named_units = dict(zip(split_headers(source, headers)[0], headers, strict=True)) if units else {}
    more = {name: units[named_unit] for name, named_unit in named_units.items() if named_unit in units}
    return replace(table, units={**table.units, **more})


def with_unit(values: Any) -> tuple[Any, str]:
    """Return the values and the unit of a quantity of pint, or of a list of these; other values and no unit."""
    if isinstance(values, list | tuple) and values and all(hasattr(value, "magnitude") for value in values):
        return [value.m_as(values[0].units) for value in values], f"{values[0].units:~C}"
    return (values.magnitude, f"{values.units:~C}") if hasattr(values, "magnitude") else (values, "")


_DECIMAL = re.compile(r"[<≤]?\s*[-+]?\d*[.,]\d+(?:[eE][-+]?\d+)?")


def _series_column(series: "nw.Series[Any]") -> tuple[Column, bool]:
    """Return a column of a frame, and whether its text may be numbers.

    It may if it was mixed with other kinds, or has decimal marks, as ``<0.1``, ``1,5`` or ``n.d.`` turn a column of
    numbers into text. Whole numbers, and numbers with a unit, are labels.
    """
    import narwhals as nw

    # NumPy has no integers of 128 bits
    if (series.dtype.is_integer() or series.dtype.is_float()) and series.dtype not in (nw.Int128, nw.UInt128):
        values = series.to_numpy()
        if values.dtype.kind in "iuf":
            return values, False
    if series.dtype == nw.Categorical and series.implementation.is_pyarrow():
        cells: list[object] = []  # Those that are the same are one object
        for chunk in series.to_native().chunks:
            words = [*chunk.dictionary.to_pylist(), None]
            cells += map(words.__getitem__, chunk.indices.fill_null(len(words) - 1).to_pylist())
        return column_of(cells)
    column, is_mixed = column_of(series.to_list())
    if is_mixed or not any(isinstance(cell, str) and _DECIMAL.fullmatch(cell.strip()) for cell in column.tolist()):
        return column, is_mixed
    return column, isinstance(numerals(column, Notation()), Numerals)


def _missing(column: Column) -> Bools:
    import pandas as pd

    return np.asarray(pd.isna(column), dtype=bool)


def _kind(column: Column) -> str:
    """Return what a column of cells that are not numbers holds; nothing counts as text."""
    present = column[~_missing(column)]
    return type(present[0]).__name__.casefold() if len(present) else "str"
