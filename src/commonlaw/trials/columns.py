"""A table as it came in: named columns, their units, and where each row stands."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.trials.headers import find_name

if TYPE_CHECKING:
    import pyarrow as pa

Codes = NDArray[np.int64]

_NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"


def _stripped(value: object) -> object:
    return value.strip() if isinstance(value, str) else value


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of numbers and of text, all of the same length.

    Parameters
    ----------
    source
        Where the table came from, for messages: ``drops.csv``.
    columns
        Arrow arrays by column name; numbers of any type, or strings.
    units
        Unit by column name, from the headers.
    place
        From the index of a row to its place for the reader: ``row 17 (line 18)``.
    loose
        Columns of text whose cells may be meant as numbers: all those of a text file, mixed ones of a worksheet.
    decimal_comma
        Whether numbers in text are written with a comma.
    roles
        Names of columns by role, where the file says so itself.
    notes
        What was noticed on reading.
    parsed
        Columns of text that have been read as numbers so far, and None for those that cannot be.
    """

    source: str
    columns: Mapping[str, "pa.Array"]
    units: Mapping[str, str]
    place: Callable[[int], str]
    loose: frozenset[str] = frozenset()
    decimal_comma: bool = False
    roles: Mapping[str, str | list[str]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    parsed: dict[str, "pa.Array | None"] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not len(self):
            raise CommonlawError(
                f"{self.source}: the table has a header and no row below it; give it the measured rows"
            )

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def find(self, name: str) -> str:
        """Return the name of a column, which may be given with its unit.

        Raises
        ------
        CommonlawError
            If there is no such column.
        """
        try:
            return find_name(name, self.columns)
        except CommonlawError as error:
            raise CommonlawError(f"{self.source}: {error}") from None

    def is_numeric(self, name: str) -> bool:
        """Say whether a column holds numbers; more than half of the cells will do where text may be meant as such."""
        import pyarrow.compute as pc
        import pyarrow.types as kinds

        column = self.columns[name]
        if name not in self.loose:
            kind = column.type
            return bool(kinds.is_integer(kind) or kinds.is_floating(kind) or kinds.is_decimal(kind))
        parsed = self._parsed(name)
        if parsed is not None:
            return bool(parsed.null_count < len(parsed))
        share = pc.mean(pc.match_substring_regex(self._cells(name), _NUMBER)).as_py()
        return share is not None and share > 0.5

    def numbers(self, name: str, *, missing: bool = False) -> Floats:
        """Return a column as numbers, shape (n,).

        Parameters
        ----------
        name
            The column.
        missing
            Whether cells may be empty; they are NaN then.

        Raises
        ------
        CommonlawError
            If a cell is not a number, is empty, or is not finite; the message names the first one.
        """
        import pyarrow as pa

        column = self.columns[name]
        if pa.types.is_string(column.type):
            column = self._parsed(name)
            if column is None:
                raise self._no_number(name)
        try:
            values = np.array(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=np.float64)
        except (pa.ArrowNotImplementedError, pa.ArrowInvalid):
            raise CommonlawError(f"{self.source}: column {name!r} holds {column.type}: give it as numbers") from None
        bad = np.flatnonzero(np.isinf(values) if missing else ~np.isfinite(values))
        if len(bad):
            row = int(bad[0])
            what = "is infinite" if np.isinf(values[row]) else "is missing"
            count = "" if len(bad) == 1 else f" ({len(bad)} values of the column are missing or infinite)"
            raise CommonlawError(f"{self._where(name, row)}: the value {what}{count}; repair the rows or remove them")
        return values

    def encoded(self, name: str, read: Callable[[object], object] = _stripped) -> tuple[Codes, list[object]]:
        """Return a column as codes, shape (n,), and the values that they stand for; -1 where a cell is empty.

        Parameters
        ----------
        name
            The column.
        read
            What makes a value of a cell; it is called once for each different cell.

        Raises
        ------
        CommonlawError
            If the cells are neither numbers nor text nor dates.
        """
        import pyarrow as pa

        column = self.columns[name]
        if pa.types.is_floating(column.type):
            column = pa.array(column.to_numpy(zero_copy_only=False), from_pandas=True)
        try:
            encoded = column.dictionary_encode()
        except pa.ArrowNotImplementedError:
            raise CommonlawError(f"{self.source}: column {name!r} holds {column.type}: give it as text") from None
        read_values = [read(value) for value in encoded.dictionary.to_pylist()]
        values = [value for value in dict.fromkeys(read_values) if value != ""]
        codes = {value: code for code, value in enumerate(values)}
        renumbered = np.array([codes.get(value, -1) for value in read_values] + [-1])
        places = encoded.indices.fill_null(len(read_values)).to_numpy(zero_copy_only=False)
        return renumbered[places], values

    def _cells(self, name: str) -> "pa.Array":
        """Return a column of text made ready to be read as numbers; empty cells are null."""
        import pyarrow as pa
        import pyarrow.compute as pc

        cells = pc.utf8_trim_whitespace(self.columns[name].cast(pa.string()))
        cells = pc.if_else(pc.equal(cells, ""), pa.scalar(None, pa.string()), cells)
        return pc.replace_substring(cells, ",", ".") if self.decimal_comma else cells

    def _parsed(self, name: str) -> "pa.Array | None":
        """Return a column of text as numbers, or None if a cell is not one."""
        import pyarrow as pa

        if name not in self.parsed:
            cells = self._cells(name)
            try:
                self.parsed[name] = cells.cast(pa.float64())
            except pa.ArrowInvalid:
                self.parsed[name] = None
        return self.parsed[name]

    def _no_number(self, name: str) -> CommonlawError:
        row = _first_without_number(self._cells(name))
        cell = self.columns[name][row].as_py()
        return CommonlawError(
            f"{self._where(name, row)}: {cell!r} is not a number; repair the cell or leave the column out"
        )

    def _where(self, name: str, row: int) -> str:
        return f"{self.source}: column {name!r}, {self.place(row)}"


def _first_without_number(cells: "pa.Array") -> int:
    """Return the index of the first cell that cannot be read as a number, by halving."""
    import pyarrow as pa

    start, stop = 0, len(cells)
    while stop - start > 1:
        middle = (start + stop) // 2
        try:
            cells[start:middle].cast(pa.float64())
            start = middle
        except pa.ArrowInvalid:
            stop = middle
    return start
