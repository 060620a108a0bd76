"""Files as tables, by what they hold and not by what they are called; workbooks are read by a separate process.

A sheet with a value in its last cell would take all memory.
"""

import io
import json
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, unknown
from commonlaw.runtime.files import write_whole
from commonlaw.runtime.packages import optional_import
from commonlaw.runtime.reading import (
    BYTE_ORDER_MARK,
    LARGEST_FILE,
    MOST_CELLS,
    check_size,
    checked_file,
    read_file,
    read_json,
    unpacked,
)
from commonlaw.runtime.shutdown import put_away_first
from commonlaw.trials import workbook_process
from commonlaw.trials.columns import Column, Table, column_of, filled_table, frame_table
from commonlaw.trials.headers import check_unit, join_header
from commonlaw.trials.text import text_table
from commonlaw.trials.trial import Property, TrialData, property_names

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa
    import pyarrow.parquet as pq


_SECONDS = 30
"""What reading a workbook may take."""

Rows = list[tuple[int, list[Any]]]
"""Numbers, from the header's, and cells of rows that are not empty."""


def workbook_table(source: str, content: bytes, wanted: str | None) -> Table:
    """Return the table in one sheet of a workbook, or in all of them if they have the same header.

    The rows of sheets stand below each other; several sheets without a column ``object`` are an object each.
    """
    optional_import("python_calamine", "reading workbooks", "excel")
    # With -P Python does not import what lies in the working folder
    command = [sys.executable, "-P", str(Path(workbook_process.__file__))]
    try:
        with put_away_first() as ending, ending.waiting():
            done = subprocess.run(command, input=content, capture_output=True, timeout=_SECONDS)
    except subprocess.TimeoutExpired:
        raise CommonlawError("workbook-too-slow", source=source, seconds=_SECONDS) from None
    if done.returncode == workbook_process.NO_WORKBOOK:
        reason = done.stderr.decode(errors="replace").strip()
        raise CommonlawError("workbook-damaged", source=source, reason=reason)
    if done.returncode:
        raise CommonlawError("workbook-too-large", source=source, memory=workbook_process.MEMORY / 2**30)
    sheets: dict[str, Rows] = pickle.loads(done.stdout)
    for name, rows in sheets.items():
        check_size(f"{source}, sheet {name!r}", len(rows), len(rows[0][1]) if rows else 0)
    if wanted is not None and wanted not in sheets:
        raise unknown("sheet", wanted, sheets).at(source)
    chosen = {name: rows for name, rows in sheets.items() if rows and wanted in (None, name)}
    if not chosen:
        raise CommonlawError("workbook-empty", where=source, part="sheet" if wanted else "workbook")
    headers = {name: " | ".join(str(cell).strip() for cell in rows[0][1]).rstrip(" |") for name, rows in chosen.items()}
    if len(set(headers.values())) > 1:
        shown = "; ".join(f"{name!r} ({header})" for name, header in headers.items())
        raise CommonlawError("workbook-sheets", where=source, sheets=shown)
    many, header = len(chosen) > 1, max((rows[0][1] for rows in chosen.values()), key=len)
    listed = [(name, *row) for name, (_, *below) in chosen.items() for row in below]
    cells = [[None if cell == "" else cell for cell in row] + [None] * (len(header) - len(row)) for *_, row in listed]
    made = [column_of([row[i] for row in cells]) for i in range(len(header))]
    columns, loose = [column for column, _ in made], [i for i, (_, is_mixed) in enumerate(made) if is_mixed]
    titles = [str(cell) for cell in header]
    if many and "object" not in {title.strip().casefold() for title in titles}:
        titles, columns = [*titles, "object"], [*columns, column_of([name for name, *_ in listed])[0]]

    def locate(row: int) -> str:
        name, number, _ = listed[row]
        return f"row {number}" + f" of sheet {name!r}" * many

    return filled_table(source, titles, columns, loose=loose, locate=locate, number=lambda row: listed[row][1])


def read_table(path: str | os.PathLike[str], sheet: str | None = None) -> Table:
    """Return the table in a file: text with separators, Parquet, or a workbook, each of which may be compressed."""
    return table_in(Path(path).name, read_file(path), sheet)


def table_in(name: str, content: bytes, sheet: str | None = None) -> Table:
    """Return the table in the content of a file that has this name in messages."""
    content = unpacked(name, content)
    if not content.removeprefix(BYTE_ORDER_MARK).strip():
        raise CommonlawError("table-empty", name=name)
    if content.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        return workbook_table(name, content, sheet)
    if sheet is not None:
        raise CommonlawError("sheet-of-text", name=name, sheet=sheet)
    if content.startswith(b"PAR1"):
        with _whole(name):
            file, data = _unpacked(name, content)
            kept = _kept(name, file.schema_arrow.metadata)
            roles: dict[str, Any] = dict(kept.get("roles", {}))
            return replace(frame_table(data, name), roles=roles, notes=kept.get("notes", ()))
    return text_table(name, content)


def name_of_table(path: str | os.PathLike[str]) -> str:
    """Return the name of a file without its suffix, and without that of a compressed one.

    >>> name_of_table("runs/cup.csv.gz"), name_of_table("cup.2.csv")
    ('cup', 'cup.2')
    """
    file = Path(path)
    return (Path(file.stem) if file.suffix.casefold() in (".gz", ".bz2", ".xz") else file).stem


_METADATA = b"commonlaw"  # the key under which a file keeps the roles of its columns


class _Roles(TypedDict, total=False):
    """Names of columns by role."""

    object: str
    trial: str
    time: str
    states: list[str]
    inputs: list[str]
    noise_columns: dict[str, str]
    properties: list[str]


class _Kept(TypedDict, total=False):
    """What a file says of its columns itself."""

    roles: _Roles
    notes: tuple[str, ...]


def opened(path: str | os.PathLike[str]) -> tuple["pq.ParquetFile", dict[str, Any]]:
    """Return a Parquet file to read batches of rows from, and the names of its columns by role."""
    arrow, _ = _arrow("streaming Parquet files")
    try:
        file = _file(checked_file(path, np.inf))
    except (arrow.ArrowException, OSError, UnicodeDecodeError) as error:
        raise CommonlawError("not-parquet", path=path, error=error) from None
    check_size(str(path), 1, file.metadata.num_columns)
    return file, dict(_kept(str(path), file.schema_arrow.metadata).get("roles", {}))


def batch_tables(path: str | os.PathLike[str], rows: int) -> Iterator[Table]:
    """Yield the tables in so many rows of a Parquet file after the other, or in fewer, as memory allows."""
    arrow, _ = _arrow("streaming Parquet files")
    with _whole(str(path)):
        file, _ = opened(path)
        for batch in _batches(file, min(rows, MOST_CELLS // max(1, file.metadata.num_columns))):
            yield frame_table(arrow.Table.from_batches([batch]))


def parquet_bytes(columns: Mapping[str, Column | Sequence[object]], metadata: Mapping[bytes, bytes]) -> bytes:
    """Return a Parquet file of columns, empty where they are NaN or None, with metadata such as roles and notes."""
    arrow, parquet = _arrow("writing Parquet files")
    table = arrow.table({name: arrow.array(column, from_pandas=True) for name, column in columns.items()})
    content = io.BytesIO()
    parquet.write_table(table.replace_schema_metadata(dict(metadata)), content)
    return content.getvalue()


def parquet_columns(source: str, content: bytes) -> tuple[dict[str, list[Any]], dict[bytes, bytes]]:
    """Return the cells of a Parquet file by column, None where they are empty, and its metadata."""
    with _whole(source):
        file, data = _unpacked(source, content)
        columns = {name: column.to_pylist() for name, column in zip(data.column_names, data.columns, strict=True)}
        return columns, dict(file.schema_arrow.metadata or {})


def _arrow(feature: str) -> tuple[Any, Any]:
    return optional_import("pyarrow", feature, "parquet"), optional_import("pyarrow.parquet", feature, "parquet")


@contextmanager
def _whole(source: str) -> Iterator[None]:
    """Refuse a file that turns out to be damaged while it is read."""
    arrow, _ = _arrow("reading Parquet files")
    try:
        yield
    except (arrow.ArrowException, OSError, UnicodeDecodeError) as error:
        raise CommonlawError("parquet-damaged", source=source, error=error) from error


def _file(where: Any) -> "pq.ParquetFile":
    """Return a Parquet file whose texts are read as dictionaries: a few bytes can stand for a text in every row."""
    _, parquet = _arrow("reading Parquet files")
    file = parquet.ParquetFile(where)
    columns = map(file.schema.column, range(len(file.schema)))
    texts = [column.path for column in columns if column.physical_type == "BYTE_ARRAY"]
    return parquet.ParquetFile(where, metadata=file.metadata, read_dictionary=texts)


def _flat(file: "pq.ParquetFile") -> list["pa.Field[Any]"]:
    """Return the columns of a file that hold neither lists nor bytes, which a few bytes can stand for without end."""
    types = _arrow("reading Parquet files")[0].types
    return [
        each for each in file.schema_arrow if not (types.is_nested(each.type) or types.is_fixed_size_binary(each.type))
    ]


def _batches(file: "pq.ParquetFile", rows: int) -> Iterator["pa.RecordBatch"]:
    """Yield so many rows after the other."""
    found = 0
    for batch in file.iter_batches(batch_size=rows, columns=[field.name for field in _flat(file)]):
        batch.validate(full=True)  # Texts may be numbers of entries that a damaged dictionary does not have
        found += len(batch)
        yield batch
    if found != file.metadata.num_rows:
        raise OSError(f"{found} of {file.metadata.num_rows} rows are there")


def _unpacked(source: str, content: bytes) -> tuple["pq.ParquetFile", "pa.Table"]:
    """Return a file and its rows, as far as memory holds them."""
    arrow, _ = _arrow("reading Parquet files")
    file, batches, size = _file(arrow.BufferReader(content)), [], 0
    check_size(source, file.metadata.num_rows, file.metadata.num_columns)
    for batch in _batches(file, 65_536):
        size += batch.nbytes
        if size > LARGEST_FILE:
            raise CommonlawError("parquet-too-large", source=source, limit=LARGEST_FILE)
        batches.append(batch)
    return file, arrow.Table.from_batches(batches, arrow.schema(_flat(file)))


def _kept(source: str, metadata: Mapping[bytes, bytes] | None) -> _Kept:
    try:
        return read_json((metadata or {}).get(_METADATA, b"{}"), _Kept)
    except CommonlawError as error:
        raise CommonlawError("parquet-metadata", where=source, metadata=_METADATA.decode(), error=error) from None


def to_frame(data: TrialData) -> "pd.DataFrame":
    """Return a frame with a row for each sample, see `Trials.to_frame`."""
    import pandas as pd

    return pd.DataFrame({name: pd.Series(column).infer_objects() for name, column in _columns(data).items()})


def to_csv(data: TrialData, path: str | os.PathLike[str]) -> None:
    """Write a CSV file, see `Trials.to_csv`."""
    columns = _with_units(data)
    cells = []
    for column in columns.values():  # Text in quotes, numbers with all their digits, nothing if empty
        if column.dtype == object:
            cells.append(["" if value is None else _quoted(value) for value in column])
        else:
            cells.append(["" if value != value else repr(value) for value in column.tolist()])
    lines = [",".join(map(_quoted, columns)), *map(",".join, zip(*cells, strict=True)), ""]
    write_whole(path, "\n".join(lines).encode())


def to_parquet(data: TrialData, path: str | os.PathLike[str]) -> None:
    """Write a Parquet file, see `Trials.to_parquet`."""
    schema = data.schema
    roles = {
        "object": schema.object,
        "trial": schema.trial,
        "time": schema.time,
        "states": schema.states,
        "inputs": schema.inputs,
        "noise_columns": schema.noise_columns,
        "properties": property_names(data.properties),
    }
    kept = json.dumps({"roles": roles, "notes": data.notes}).encode()
    write_whole(path, parquet_bytes(_with_units(data), {_METADATA: kept}))


def _columns(data: TrialData) -> dict[str, Column]:
    """Return the columns of all samples; a missing state or property is NaN among numbers and None among texts."""
    trials, schema, properties = data.trials, data.schema, data.properties
    rows = list[tuple[Floats, ...]]()
    for trial in trials:  # From its first input before its first sample on
        unknown = np.full((len(trial.earlier), trial.states.shape[1]), np.nan)
        before = (trial.earlier[:, 0], unknown, trial.earlier[:, 1:], unknown) if len(trial.earlier) else ()
        own = trial.times, trial.states, trial.inputs, trial.noise
        rows += [before] * bool(before) + [own]
    of_trial = [len(trial.earlier) + len(trial) for trial in trials]
    row_trials = np.repeat(np.arange(len(trials)), of_trial)
    times, states, inputs, noise = (np.concatenate(each) for each in zip(*rows, strict=True))

    def per_trial(values: Sequence[Property | None]) -> Column:
        is_text = any(isinstance(value, str) for value in values)
        return np.array(values, dtype=object if is_text else np.float64)[row_trials]

    columns = {
        schema.object: per_trial([trial.object for trial in trials]),
        schema.trial: per_trial([trial.name for trial in trials]),
        schema.time: times,
    }
    values = np.hstack([states, inputs])
    columns |= dict(zip((*schema.states, *schema.inputs), values.T, strict=True))
    columns |= {name: noise[:, schema.states.index(state)] for state, name in schema.noise_columns.items()}
    for name in property_names(data.properties):
        columns[name] = per_trial([properties.get(trial.object, {}).get(name) for trial in trials])
    return columns


def _with_units(data: TrialData) -> dict[str, Column]:
    """Return the columns with units in their names."""
    units = {name: check_unit(unit, f"column {name!r}") for name, unit in data.schema.units.items() if unit.strip()}
    return {join_header(name, units.get(name, "")): column for name, column in _columns(data).items()}


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"'
