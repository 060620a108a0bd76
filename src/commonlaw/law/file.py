"""Laws in files: JSON, or for very many objects Parquet, a row for each of them."""

import json
import os
from collections.abc import Mapping, Sequence
from itertools import product
from math import prod
from typing import Any

import msgspec
import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.foreign import LARGEST_JSON, MOST_CELLS, MOST_COLUMNS, check_size, read_json
from commonlaw.law.averages import AbstractAverages
from commonlaw.law.json import Decoded, check_numbers, decode, decode_document, document_of, encode, not_a_law
from commonlaw.trials.parquet import parquet_bytes, parquet_columns

_METADATA = b"commonlaw law"
"""The key under which a file keeps all of a law that is not by object, as JSON."""

_PARQUET = b"PAR1"
"""What Parquet files begin with."""

_BY_OBJECT = ("coefficients", "covariance", "shared_factor", "properties")
"""Parts of a law's document that are mappings from objects; each becomes columns of the table."""

_OBJECTS = "object"


def law_bytes(law: AbstractAverages, path: str | os.PathLike[str]) -> bytes:
    """Return the file of a law: Parquet if it is named so, else JSON.

    Raises
    ------
    CommonlawError
        If it would be too large to be read again.
    """
    name, content = law_file(law, str(path))
    if name != str(path):
        raise CommonlawError("law-too-large-for-json", objects=len(law.objects))
    return content


def law_file(law: AbstractAverages, path: str) -> tuple[str, bytes]:
    """Return name and content of the file of a law: the path, or where JSON is too large Parquet beside it.

    Raises
    ------
    CommonlawError
        If it would be too large to be read again as Parquet, too, or has numbers that are refused where laws are read.
    """
    document = msgspec.to_builtins(document_of(law))
    try:
        check_numbers(document)
    except CommonlawError as error:
        raise CommonlawError("law-not-saved", where=path, error=error) from None
    if not path.endswith(".parquet"):
        content = encode(law)
        if len(content) <= LARGEST_JSON:
            return path, content
        path += ".parquet"
    return path, _as_parquet(law, document, path)


def decoded_file(content: bytes) -> Decoded:
    """Return what the law of a file is made of, see `decode`."""
    return _of_parquet(content) if content.startswith(_PARQUET) else decode(content)


def _as_parquet(law: AbstractAverages, document: dict[str, Any], path: str) -> bytes:
    columns: dict[str, Any] = {_OBJECTS: law.objects}
    rest = _without_objects(document, "", law.objects, columns)
    check_size(path, len(law.objects), len(columns))
    return parquet_bytes(columns, {_METADATA: json.dumps(rest).encode()})


def _without_objects(value: Any, path: str, objects: Sequence[str], columns: dict[str, Any]) -> Any:
    """Return a document without what is by object; that becomes columns, whose names begin with the path to it."""
    if isinstance(value, list):
        return [_without_objects(each, f"{path}{i} ", objects, columns) for i, each in enumerate(value)]
    if not isinstance(value, dict):
        return value
    rest = dict[str, Any]()
    for key, each in value.items():
        name = f"{path}{key} "
        if key == "properties" and isinstance(each, dict):
            rest[key] = {"names": list(dict.fromkeys(kind for own in each.values() for kind in own))}
            columns |= {
                f"{name}{kind}": [each.get(own, {}).get(kind) for own in objects] for kind in rest[key]["names"]
            }
        elif key in _BY_OBJECT and isinstance(each, dict):
            array = np.array([each[own] for own in objects])
            rest[key] = {"shape": array.shape[1:]}
            columns |= {_column(name, index): array[:, *index] for index in np.ndindex(*array.shape[1:])}
        else:
            rest[key] = _without_objects(each, name, objects, columns)
    return rest


def _of_parquet(content: bytes) -> Decoded:
    columns, metadata = parquet_columns("the law", content)
    if _METADATA not in metadata or _OBJECTS not in columns:
        raise CommonlawError("not-a-law-but-measurements")
    objects = columns[_OBJECTS]
    try:
        if len({*objects}) < len(objects):
            raise ValueError("an object stands in two rows")
        rest = read_json(metadata[_METADATA], dict[str, Any])
        raw = _with_objects(rest, "", objects, columns)
    except KeyError as error:
        raise not_a_law(ValueError(f"it lacks {error}")) from None
    except (CommonlawError, TypeError, ValueError) as error:
        raise not_a_law(error) from None
    assert isinstance(raw, dict)
    return decode_document(raw)


def _with_objects(value: Any, path: str, objects: Sequence[str], columns: Mapping[str, list[Any]]) -> Any:
    """Return a document with what is by object taken from columns again."""
    if isinstance(value, list):
        return [_with_objects(each, f"{path}{i} ", objects, columns) for i, each in enumerate(value)]
    if not isinstance(value, dict):
        return value
    whole = dict[str, Any]()
    for key, each in value.items():
        name = f"{path}{key} "
        if key == "properties" and isinstance(each, dict):
            kinds = {kind: columns[f"{name}{kind}"] for kind in each["names"]}
            cells = {own: {kind: kinds[kind][i] for kind in kinds} for i, own in enumerate(objects)}
            whole[key] = {
                own: {kind: cell for kind, cell in row.items() if cell is not None} for own, row in cells.items()
            }
        elif key in _BY_OBJECT and isinstance(each, dict):
            whole[key] = dict(zip(objects, _nested(each["shape"], name, len(objects), columns), strict=True))
        else:
            whole[key] = _with_objects(each, name, objects, columns)
    return whole


def _nested(shape: list[int], name: str, rows: int, columns: Mapping[str, list[Any]]) -> list[Any]:
    """Return the arrays of all objects as lists within each other, so that what is no number is found later."""
    if len(shape) > 2 or not all(0 <= size <= MOST_COLUMNS for size in shape) or rows * prod(shape) > MOST_CELLS:
        raise ValueError(f"{name}has the shape {shape}")
    cells = np.empty((rows, prod(shape)), dtype=object)
    for i, index in enumerate(product(*map(range, shape))):
        cells[:, i] = columns[_column(name, index)]
    nested: list[Any] = cells.reshape(rows, *shape).tolist()
    return nested


def _column(name: str, index: tuple[int, ...]) -> str:
    return f"{name}{' '.join(map(str, index))}"
