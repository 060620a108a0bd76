"""The saved form of a law: JSON of a versioned schema."""

import os
from pathlib import Path
from typing import Literal, cast

import msgspec
import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation import format_differentiation, parse_differentiation
from commonlaw.errors import CommonlawError
from commonlaw.law.alternative import Alternative
from commonlaw.law.history import Step
from commonlaw.law.law import Law
from commonlaw.library import Terms, Variables, parse_term
from commonlaw.outcomes import Outcome
from commonlaw.trials import Schema

VERSION = 2


class _Header(msgspec.Struct):
    format: Literal["commonlaw law"]
    version: int


class _Law(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Version 2 of the schema; version 1 ended with the alternatives."""

    format: Literal["commonlaw law"] = "commonlaw law"
    version: Literal[1, 2] = 2
    order: Literal[0, 1, 2]
    schema: Schema
    rates: list[str]
    differentiation: str | None
    terms: list[str]
    coefficients: dict[str, list[list[float]]]
    outcomes: list[Outcome] = []
    alternatives: list[Alternative] = []
    covariance: dict[str, list[float]] | None = None
    noise: list[float] | None = None
    inclusion: list[list[float]] | None = None
    history: list[Step] = []
    common: dict[str, list[list[float]]] | None = None


def encode(law: Law) -> bytes:
    """Return the law as JSON.

    Terms are expressions such as ``x**2*v``, coefficients lists by equation and term, and the covariance of each
    object's coefficients the rows of its lower triangle, one after the other.
    """
    triangle = np.tril_indices(int(law.support.sum()))
    covariance = None if law.covariance is None else [matrix[triangle].tolist() for matrix in law.covariance]
    document = _Law(
        order=cast(Literal[0, 1, 2], law.order),
        schema=law.schema,
        rates=list(law.rates),
        differentiation=None if law.differentiation is None else format_differentiation(law.differentiation),
        terms=[term.expression(law.terms.variables.names) for term in law.terms.terms],
        coefficients={name: law.of(name).tolist() for name in law.objects},
        outcomes=list(law.outcomes),
        alternatives=list(law.alternatives),
        covariance=None if covariance is None else dict(zip(law.objects, covariance, strict=True)),
        noise=None if law.noise is None else law.noise.tolist(),
        inclusion=None if law.inclusion is None else law.inclusion.tolist(),
        history=list(law.history),
        common=None if law.common is None else dict(zip(law.objects, law.common.tolist(), strict=True)),
    )
    return msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n"


def decode(content: bytes) -> Law:
    """Return the law of a JSON document.

    Raises
    ------
    CommonlawError
        If it is not a law, is damaged, or is of another version.
    """
    try:
        version = msgspec.json.decode(content, type=_Header).version
        if not 1 <= version <= VERSION:
            raise CommonlawError(
                f"the law is of version {version} of the format, this commonlaw reads versions up to {VERSION}; "
                "read it with the release that wrote it, or discover the law again"
            )
        document = msgspec.json.decode(content, type=_Law)
    except msgspec.DecodeError as error:
        raise CommonlawError(f"this is not a law or it is damaged: {error}; discover the law again") from None
    schema = document.schema
    variables = Variables((*schema.states, *document.rates), schema.inputs, schema.time)
    terms = Terms(variables, tuple(parse_term(text, variables) for text in document.terms))
    shape = (len(schema.states), len(terms))
    for name, rows in document.coefficients.items():
        if len(rows) != shape[0] or any(len(row) != shape[1] for row in rows):
            expected = f"{shape[0]} x {shape[1]} numbers"
            raise CommonlawError(f"the law is damaged: the coefficients of {name!r} are not {expected}")
    coefficients = np.array(list(document.coefficients.values())).reshape(-1, *shape)
    return Law(
        terms,
        schema,
        document.order,
        tuple(document.coefficients),
        coefficients,
        None if document.differentiation is None else parse_differentiation(document.differentiation),
        tuple(document.outcomes),
        tuple(document.alternatives),
        None if document.covariance is None else _covariance(document, int(np.any(coefficients, axis=0).sum())),
        None if document.noise is None else np.array(document.noise),
        None if document.inclusion is None else _matrix(document.inclusion, "inclusion", shape),
        tuple(document.history),
        None if document.common is None else _common(document, int(np.any(coefficients, axis=0).sum())),
    )


def _covariance(document: _Law, parameters: int) -> Floats:
    """Return the covariance of each object's coefficients from its lower triangle, in the order of the coefficients."""
    rows, columns = np.tril_indices(parameters)
    found = np.zeros((len(document.coefficients), parameters, parameters))
    covariance = document.covariance or {}
    for matrix, name in zip(found, document.coefficients, strict=True):
        own = covariance.get(name, [])
        if len(own) != len(rows):
            raise CommonlawError(f"the law is damaged: the covariance of {name!r} is not {len(rows)} numbers")
        matrix[rows, columns] = matrix[columns, rows] = own
    return found


def _common(document: _Law, parameters: int) -> Floats:
    """Return what the errors of objects have in common, in the order of the coefficients."""
    common, shape = document.common or {}, (parameters, parameters)
    found = [_matrix(common.get(name, []), f"common error of {name!r}", shape) for name in document.coefficients]
    return np.array(found).reshape(-1, *shape)


def _matrix(rows: list[list[float]], what: str, shape: tuple[int, int]) -> Floats:
    if len(rows) != shape[0] or any(len(row) != shape[1] for row in rows):
        raise CommonlawError(f"the law is damaged: its {what} is not {shape[0]} x {shape[1]} numbers")
    return np.array(rows)


def read(path: str | os.PathLike[str]) -> Law:
    """Read the law in a file; errors name the file."""
    try:
        return decode(Path(path).read_bytes())
    except OSError as error:
        raise CommonlawError(f"cannot read {path}: {error.strerror}; check the path") from None
    except CommonlawError as error:
        raise CommonlawError(f"{path}: {error}") from None
