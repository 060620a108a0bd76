"""Parquet files, which keep the roles of their columns."""

import io
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from commonlaw.errors import CommonlawError
from commonlaw.extras import optional_import
from commonlaw.files import write_whole
from commonlaw.trials.columns import Column, Table, frame_table

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

_METADATA = b"commonlaw"  # the key under which a file keeps the roles of its columns


def parquet_table(source: str, content: bytes) -> Table:
    """Return the table in a Parquet file."""
    arrow, parquet = _arrow("reading Parquet files")
    try:
        data = parquet.read_table(arrow.BufferReader(content))
    except (arrow.ArrowException, OSError) as error:
        raise CommonlawError(f"{source} is a damaged Parquet file ({error}): write it again") from error
    kept = _kept(data.schema.metadata)
    return replace(frame_table(data, source), roles=kept.get("roles", {}), notes=tuple(kept.get("notes", ())))


def opened(path: str | os.PathLike[str]) -> tuple["pq.ParquetFile", dict[str, Any]]:
    """Return a Parquet file to read batches of rows from, and the names of its columns by role."""
    arrow, parquet = _arrow("streaming Parquet files")
    try:
        file = parquet.ParquetFile(path)
    except OSError as error:
        raise CommonlawError(f"cannot read {path}: {error.strerror or error}; check the path") from None
    except arrow.ArrowInvalid as error:
        raise CommonlawError(f"{path} is no Parquet file ({error}): only Parquet can be streamed") from None
    return file, _kept(file.schema_arrow.metadata).get("roles", {})


def batch_table(batch: "pa.RecordBatch") -> Table:
    """Return the table in a batch of rows of a Parquet file."""
    arrow, _ = _arrow("streaming Parquet files")
    return frame_table(arrow.Table.from_batches([batch]))


def write_parquet(
    path: str | os.PathLike[str], columns: Mapping[str, Column], roles: Mapping[str, object], notes: Sequence[str]
) -> None:
    """Write columns, empty where they are NaN or None, with their roles and notes."""
    arrow, parquet = _arrow("writing Parquet files")
    kept = json.dumps({"roles": roles, "notes": notes}).encode()
    table = arrow.table({name: arrow.array(column, from_pandas=True) for name, column in columns.items()})
    content = io.BytesIO()
    parquet.write_table(table.replace_schema_metadata({_METADATA: kept}), content)
    write_whole(path, content.getvalue())


def _arrow(feature: str) -> tuple[Any, Any]:
    return optional_import("pyarrow", feature, "parquet"), optional_import("pyarrow.parquet", feature, "parquet")


def _kept(metadata: Mapping[bytes, bytes] | None) -> dict[str, Any]:
    kept: dict[str, Any] = json.loads((metadata or {}).get(_METADATA, b"{}"))
    return kept
