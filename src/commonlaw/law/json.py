"""The saved form of a law: JSON of a versioned schema."""

import os
from pathlib import Path
from typing import Literal, cast

import msgspec
import numpy as np

from commonlaw.differentiation import format_differentiation, parse_differentiation
from commonlaw.errors import CommonlawError
from commonlaw.law.alternative import Alternative
from commonlaw.law.law import Law
from commonlaw.library import Terms, Variables, parse_term
from commonlaw.outcomes import Outcome
from commonlaw.trials import Schema

VERSION = 1


class _Header(msgspec.Struct):
    format: Literal["commonlaw law"]
    version: int


class _Law(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Version 1 of the schema."""

    format: Literal["commonlaw law"] = "commonlaw law"
    version: Literal[1] = 1
    order: Literal[0, 1, 2]
    schema: Schema
    rates: list[str]
    differentiation: str | None
    terms: list[str]
    coefficients: dict[str, list[list[float]]]
    outcomes: list[Outcome] = []
    alternatives: list[Alternative] = []


def encode(law: Law) -> bytes:
    """Return the law as JSON; terms are expressions such as ``x**2*v``, coefficients lists by equation and term."""
    document = _Law(
        order=cast(Literal[0, 1, 2], law.order),
        schema=law.schema,
        rates=list(law.rates),
        differentiation=None if law.differentiation is None else format_differentiation(law.differentiation),
        terms=[term.expression(law.terms.variables.names) for term in law.terms.terms],
        coefficients={name: law.of(name).tolist() for name in law.objects},
        outcomes=list(law.outcomes),
        alternatives=list(law.alternatives),
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
        if version != VERSION:
            raise CommonlawError(
                f"the law is of version {version} of the format, this commonlaw reads version {VERSION}; "
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
    return Law(
        terms,
        schema,
        document.order,
        tuple(document.coefficients),
        np.array(list(document.coefficients.values())).reshape(-1, *shape),
        None if document.differentiation is None else parse_differentiation(document.differentiation),
        tuple(document.outcomes),
        tuple(document.alternatives),
    )


def read(path: str | os.PathLike[str]) -> Law:
    """Read the law in a file; errors name the file."""
    try:
        return decode(Path(path).read_bytes())
    except OSError as error:
        raise CommonlawError(f"cannot read {path}: {error.strerror}; check the path") from None
    except CommonlawError as error:
        raise CommonlawError(f"{path}: {error}") from None
