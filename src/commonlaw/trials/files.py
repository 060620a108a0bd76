"""Files as tables, by what they hold and not by what they are called; workbooks are read by a separate process.

A sheet with a value in its last cell would take all memory.
"""

import io
import json
import os
import pickle
import re
import subprocess
import sys
import zipfile
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, unknown
from commonlaw.runtime.files import (
    BYTE_ORDER_MARK,
    LARGEST_FILE,
    MOST_CELLS,
    PARQUET,
    WORKBOOK,
    check_size,
    checked_file,
    path_of,
    read_file,
    read_json,
    unpacked,
    write_whole,
)
from commonlaw.runtime.packages import optional_import
from commonlaw.runtime.shutdown import put_away_first
from commonlaw.text import as_text, counted
from commonlaw.trials import workbook_process
from commonlaw.trials.columns import Column, Table, frame_table, stacked_column
from commonlaw.trials.headers import check_unit, join_header
from commonlaw.trials.layouts.grid import labels_of
from commonlaw.trials.layouts.sheets import Rows, table_in_sheets
from commonlaw.trials.reading import WrittenReading
from commonlaw.trials.text import text_table
from commonlaw.trials.trial import Dose, Property, TrialData, property_names

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq


_ENDINGS = frozenset([".csv", ".tsv", ".txt", ".dat", ".log", ".asc", ".xlsx", ".xls", ".ods", ".gz", ".bz2", ".xz"])
"""Of files of tables in a folder."""


def workbook_table(source: str, content: bytes, wanted: str | None) -> Table:
    """Return the table in one sheet of a workbook, or in all of them, see `table_in_sheets`."""
    optional_import("python_calamine", "reading workbooks", "excel")
    seconds = 30  # What reading may take
    # With -P Python does not import what lies in the working folder
    command = [sys.executable, "-P", str(Path(workbook_process.__file__))]
    try:
        with put_away_first() as ending, ending.waiting():
            done = subprocess.run(command, input=content, capture_output=True, timeout=seconds)
    except subprocess.TimeoutExpired:
        raise CommonlawError("workbook-too-slow", source=source, seconds=seconds) from None
    if done.returncode == workbook_process.NO_WORKBOOK:
        if zipfile.is_zipfile(io.BytesIO(content)):
            raise CommonlawError("workbook-is-archive", source=source)
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
    return table_in_sheets(source, chosen)


TablePath = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]
"""A file, a folder, a pattern such as ``runs/*.csv``, or several files."""


def table_files(path: TablePath) -> list[Path]:
    """Return the files of tables in a folder or of a pattern, in order of their names; of a single file none.

    Parquet files, which are streamed, do not count.
    """
    if not isinstance(path, str | os.PathLike):
        files = path if isinstance(path, Sequence) and path and not isinstance(path, bytes) else [path]
        return [path_of(file) for file in files]
    digits, paths = re.compile(r"(\d+)"), files_of(Path(path), _ENDINGS) or []
    return sorted(
        (file for file in paths if file.is_file() and file.name[0] != "." and file.suffix.casefold() != ".parquet"),
        key=lambda file: [int(part) if part.isdigit() else part.casefold() for part in digits.split(str(file))],
    )


def files_of(path: Path, endings: Container[str]) -> list[Path] | None:
    """Return what is in a folder with these endings, or what a pattern names; None if the path is neither."""
    try:
        if path.is_dir():
            return [file for file in path.rglob("*") if file.suffix.casefold() in endings]
        if path.exists() or not any(mark in str(path) for mark in "*?["):
            return None
        root = Path(path.anchor or ".")
        return [*root.glob(str(path.relative_to(root)))]
    except (OSError, ValueError):  # A name that is too long or no pattern, which is refused where it is read
        return None


def read_table(path: TablePath, sheet: str | None = None) -> Table:
    """Return the table in a file: text with separators, Parquet, or a workbook, each of which may be compressed.

    The rows of several files stand below each other, and without a column ``object`` their names are those of objects,
    see `_labels_of_files`.
    """
    if isinstance(path, str | os.PathLike) and not (files := table_files(path)):
        return table_in(Path(path).name, read_file(path), sheet)
    files = table_files(path)
    tables = [table_in(file.name, read_file(file), sheet) for file in files]
    headers = [[join_header(name, table.units.get(name, "")) for name in table.columns] for table in tables]
    for table, header in zip(tables, headers, strict=True):
        if sorted(header) != sorted(headers[0]):
            raise CommonlawError(
                "files-differ", where=table.source, columns=header, first=tables[0].source, others=headers[0]
            )
    begins = np.cumsum([0, *map(len, tables)])
    check_size(f"{len(tables)} files", int(begins[-1]), len(tables[0].columns))

    def within(row: int) -> tuple[Table, int]:
        index = int(np.searchsorted(begins, row, side="right")) - 1
        return tables[index], row - int(begins[index])

    def locate(row: int) -> str:
        table, table_row = within(row)
        return f"{table.locate(table_row)} of {table.source}"

    commas = frozenset[str].intersection(*(table.commas for table in tables))
    tables = [table.as_texts([*table.commas - commas]) for table in tables]
    columns = {name: stacked_column([(table, name) for table in tables]) for name in tables[0].columns}
    plain = frozenset(name for name in columns if all(name in table.plain for table in tables))
    if "object" not in {name.casefold() for name in columns}:
        for role, labels in _labels_of_files(files).items():
            if role not in columns:
                columns[role] = np.repeat(np.array(labels, dtype=object), np.diff(begins))
    return Table(
        f"{tables[0].source} and {counted(len(tables) - 1, 'other file')}",
        columns,
        tables[0].units,
        locate,
        lambda row: within(row)[0].number(within(row)[1]),
        frozenset().union(*(table.loose for table in tables)),
        notes=tuple(dict.fromkeys(note for table in tables for note in table.notes)),
        facts=tuple(dict.fromkeys(fact for table in tables for fact in table.facts)),
        plain=plain,
        commas=commas,
        written=lambda names: [np.concatenate(parts) for parts in zip(*(t.texts(names) for t in tables), strict=True)],
        label=as_text(name_of_table(path)) if isinstance(path, str | os.PathLike) else "object",
    )


def _labels_of_files(files: Sequence[Path]) -> dict[str, list[str]]:
    """Return the names of objects that files have, and the labels of trials where several files are of one object.

    ``golf_1.csv``, ``golf_2.csv``, ``tennis_1.csv`` are trials of two objects, and so are ``golf/1.csv`` and
    ``tennis/1.csv`` in folders of their own; ``run 1.csv``, ``run 2.csv`` are trials of one.
    """
    names = [as_text(name_of_table(file)) for file in files]
    folders = [file.parent.name for file in files]
    if len(set(folders)) > 1:
        return {"object": folders, "trial": names}
    return labels_of(names)


def table_in(name: str, content: bytes, sheet: str | None = None) -> Table:
    """Return the table in the content of a file that has this name in messages."""
    content = unpacked(name, content)
    if not content.removeprefix(BYTE_ORDER_MARK).strip():
        raise CommonlawError("table-empty", name=name)
    if content.startswith(WORKBOOK):
        table = workbook_table(name, content, sheet)
    elif sheet is not None:
        raise CommonlawError("sheet-of-text", name=name, sheet=sheet)
    elif content.startswith(PARQUET):
        with _whole(name):
            file, data = _unpacked(name, content)
            kept = _kept(name, file.schema_arrow.metadata)
            table = frame_table(data, name)
            table = replace(table, roles=kept.get("roles", table.roles), notes=kept.get("notes", ()))
    else:
        table = text_table(name, content)
    return replace(table, label=as_text(name_of_table(name)))


def name_of_table(path: str | os.PathLike[str]) -> str:
    """Return the name of a file without its suffix, and without that of a compressed one.

    >>> name_of_table("runs/cup.csv.gz"), name_of_table("cup.2.csv")
    ('cup', 'cup.2')
    """
    file = Path(path)
    return (Path(file.stem) if file.suffix.casefold() in (".gz", ".bz2", ".xz") else file).stem


_METADATA = b"commonlaw"  # the key under which a file keeps the roles of its columns


class _Kept(TypedDict, total=False):
    """What a file says of its columns itself."""

    roles: WrittenReading
    notes: tuple[str, ...]


def opened(path: str | os.PathLike[str]) -> tuple["pq.ParquetFile", WrittenReading]:
    """Return a Parquet file to read batches of rows from, and the names of its columns by role."""
    arrow = _arrow("streaming Parquet files")
    try:
        file = _file(checked_file(path, np.inf))
    except (arrow.ArrowException, OSError, UnicodeDecodeError) as error:
        raise CommonlawError("not-parquet", path=path, error=error) from None
    check_size(str(path), 1, file.metadata.num_columns)
    return file, _kept(str(path), file.schema_arrow.metadata).get("roles", {})


def batch_tables(path: str | os.PathLike[str], rows: int) -> Iterator[Table]:
    """Yield the tables in so many rows of a Parquet file after the other, or in fewer, as memory allows."""
    arrow = _arrow("streaming Parquet files")
    with _whole(str(path)):
        file, _ = opened(path)
        for batch in _batches(file, min(rows, MOST_CELLS // max(1, file.metadata.num_columns))):
            if _characters(batch) > _MOST_CHARACTERS:
                raise CommonlawError("parquet-too-large", source=str(path), limit=_MOST_CHARACTERS)
            yield frame_table(arrow.Table.from_batches([batch]))


def parquet_bytes(columns: Mapping[str, Column | Sequence[object]], metadata: Mapping[bytes, bytes]) -> bytes:
    """Return a Parquet file of columns, empty where they are NaN or None, with metadata such as roles and notes."""
    arrow = _arrow("writing Parquet files")
    table = arrow.table({name: arrow.array(column, from_pandas=True) for name, column in columns.items()})
    content = io.BytesIO()
    arrow.parquet.write_table(table.replace_schema_metadata(dict(metadata)), content)
    return content.getvalue()


def parquet_columns(source: str, content: bytes) -> tuple[dict[str, list[Any]], dict[bytes, bytes]]:
    """Return the cells of a Parquet file by column, None where they are empty, and its metadata."""
    with _whole(source):
        file, data = _unpacked(source, content)
        columns = {name: column.to_pylist() for name, column in zip(data.column_names, data.columns, strict=True)}
        return columns, dict(file.schema_arrow.metadata or {})


def _arrow(feature: str = "reading Parquet files") -> Any:
    optional_import("pyarrow.parquet", feature, "parquet")
    return optional_import("pyarrow", feature, "parquet")


@contextmanager
def _whole(source: str) -> Iterator[None]:
    """Refuse a file that turns out to be damaged while it is read."""
    arrow = _arrow()
    try:
        yield
    except (arrow.ArrowException, OSError, UnicodeDecodeError) as error:
        raise CommonlawError("parquet-damaged", source=source, error=error) from error


def _file(where: Any) -> "pq.ParquetFile":
    """Return a Parquet file whose texts are read as dictionaries: a few bytes can stand for a text in every row."""
    parquet = _arrow().parquet
    file = parquet.ParquetFile(where)
    columns = map(file.schema.column, range(len(file.schema)))
    texts = [column.path for column in columns if column.physical_type == "BYTE_ARRAY"]
    return parquet.ParquetFile(where, metadata=file.metadata, read_dictionary=texts)


def _flat(file: "pq.ParquetFile") -> list["pa.Field[Any]"]:
    """Return the columns of a file that hold neither lists nor bytes, which a few bytes can stand for without end."""
    types = _arrow().types
    return [
        field
        for field in file.schema_arrow
        if not (types.is_nested(field.type) or types.is_fixed_size_binary(field.type))
    ]


def _batches(file: "pq.ParquetFile", rows: int) -> Iterator["pa.RecordBatch"]:
    count = 0
    for batch in file.iter_batches(batch_size=rows, columns=[field.name for field in _flat(file)]):
        batch.validate(full=True)  # Texts may be numbers of entries that a damaged dictionary does not have
        count += len(batch)
        yield batch
    if count != file.metadata.num_rows:
        raise OSError(f"{count} of {file.metadata.num_rows} rows are there")


def _unpacked(source: str, content: bytes) -> tuple["pq.ParquetFile", "pa.Table"]:
    """Return a file and its rows, as far as memory holds them."""
    arrow = _arrow()
    file, batches, size, characters = _file(arrow.BufferReader(content)), [], 0, 0
    check_size(source, file.metadata.num_rows, file.metadata.num_columns)
    for batch in _batches(file, 65_536):
        size, characters = size + batch.nbytes, characters + _characters(batch)
        if size > LARGEST_FILE or characters > _MOST_CHARACTERS:
            raise CommonlawError("parquet-too-large", source=source, limit=LARGEST_FILE)
        batches.append(batch)
    return file, arrow.Table.from_batches(batches, arrow.schema(_flat(file)))


_MOST_CHARACTERS = 2 * LARGEST_FILE
"""Bytes of all cells of text, though those that are the same are in memory once: each is gone through."""


def _characters(batch: "pa.RecordBatch") -> int:
    """Return the bytes of all cells of text of some rows."""
    arrow = _arrow()
    compute = optional_import("pyarrow.compute", "reading Parquet files", "parquet")
    return sum(
        compute.sum(compute.binary_length(column.dictionary).take(column.indices)).as_py() or 0
        for column in batch.columns
        if arrow.types.is_dictionary(column.type)
    )


def _kept(source: str, metadata: Mapping[bytes, bytes] | None) -> _Kept:
    try:
        return read_json((metadata or {}).get(_METADATA, b"{}"), _Kept)
    except CommonlawError as error:
        raise CommonlawError("parquet-metadata", where=source, metadata=_METADATA.decode(), error=error) from None


def to_csv(trials: TrialData, path: str | os.PathLike[str]) -> None:
    """Write a CSV file, see `Trials.to_csv`."""
    columns = _with_units(trials)
    cells = []
    for column in columns.values():  # Text in quotes, numbers with all their digits, nothing if empty
        if column.dtype == object:
            cells.append(["" if value is None else _quoted(value) for value in column])
        else:
            cells.append(["" if value != value else repr(value) for value in column.tolist()])
    lines = [",".join(map(_quoted, columns)), *map(",".join, zip(*cells, strict=True)), ""]
    write_whole(path, "\n".join(lines).encode())


def to_parquet(trials: TrialData, path: str | os.PathLike[str]) -> None:
    """Write a Parquet file, see `Trials.to_parquet`."""
    names = ("object", "trial", "time", "states", "inputs", "noise_columns")
    roles = {name: getattr(trials.schema, name) for name in names}
    roles["properties"] = property_names(trials.properties)
    kept = json.dumps({"roles": roles, "notes": trials.notes}).encode()
    write_whole(path, parquet_bytes(_with_units(trials), {_METADATA: kept}))


def columns_of(data: TrialData) -> dict[str, Column]:
    """Return the columns of all samples; a missing state or property is NaN among numbers and None among texts.

    Doses that a table recorded are rows again, as in a NONMEM data set.
    """
    trials, schema, properties = data.trials, data.schema, data.properties
    blocks = list[tuple[Floats, ...]]()
    for trial in trials:  # From its first input before its first sample on
        unknown = np.full((len(trial.earlier), trial.states.shape[1]), np.nan)
        before = (trial.earlier[:, 0], unknown, trial.earlier[:, 1:], unknown) if len(trial.earlier) else ()
        samples = trial.times, trial.states, trial.inputs, trial.noise
        of_trial = [np.concatenate(parts) for parts in zip(*([before] * bool(before)), samples, strict=True)]
        blocks.append((*of_trial, np.zeros((len(of_trial[0]), len(RECORDS)))))
        if trial.doses:
            blocks[-1] = _with_doses(blocks[-1], trial.doses)
    row_trials = np.repeat(np.arange(len(trials)), [len(block[0]) for block in blocks])
    times, states, inputs, noise, records = (np.concatenate(parts) for parts in zip(*blocks, strict=True))

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
    for name in property_names(properties):
        columns[name] = per_trial([properties.get(trial.object, {}).get(name) for trial in trials])
    if schema.administered:
        columns |= dict(zip((*schema.administered, *RECORDS[len(schema.administered) :]), records.T, strict=True))
    return columns


RECORDS = ("AMT", "RATE", "II", "SS", "CMT", "EVID")
"""Columns of a NONMEM data set for doses as `Trial.doses` holds them."""


def _with_doses(samples: tuple[Floats, ...], doses: Sequence[Dose]) -> tuple[Floats, ...]:
    """Return rows of a trial with those of its doses, after samples at the same time that do not show them."""
    given = [dose for dose in doses if dose.amount and not (dose.duration or dose.is_before or dose.interval)]
    first = np.isin(samples[0], [dose.time for dose in given])
    rows = [
        (
            dose.amount,
            dose.amount / dose.duration if dose.duration else 0.0,
            dose.interval,
            float(dose.interval > 0),
            dose.compartment,
            1.0 if dose.amount else 3.0,
        )
        for dose in doses
    ]
    times = np.array([dose.time for dose in doses])
    empty = (np.full((len(doses), samples[1].shape[1]), np.nan), np.zeros((len(doses), samples[2].shape[1])))
    parts = (times, *empty, empty[0], np.array(rows))
    return tuple(
        np.concatenate([sample[first], dose, sample[~first]]) for sample, dose in zip(samples, parts, strict=True)
    )


def _with_units(trials: TrialData) -> dict[str, Column]:
    units = {name: check_unit(unit, f"column {name!r}") for name, unit in trials.schema.units.items() if unit.strip()}
    return {join_header(name, units.get(name, "")): column for name, column in columns_of(trials).items()}


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"'
