"""The saved form of a law: JSON of a versioned schema."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, Literal, cast

import msgspec
import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation import format_differentiation, parse_differentiation
from commonlaw.errors import CommonlawError
from commonlaw.foreign import read_json
from commonlaw.law.earlier_versions import compared_with_the_best, renamed
from commonlaw.law.provenance import Alternative, Provenance, Step
from commonlaw.law.uncertainty import Uncertainty
from commonlaw.library import Terms, Variables, parse_term
from commonlaw.likelihood import ErrorModel
from commonlaw.outcomes import Outcome
from commonlaw.trials import Schema

VERSION = 3

Fields = tuple[Terms, Schema, int, tuple[str, ...], Floats, Uncertainty, Provenance]
"""What a law is made of: terms, schema, order, objects, coefficients, uncertainty, provenance."""


class _Header(msgspec.Struct):
    format: Literal["commonlaw law"]
    version: int


class _Errors(msgspec.Struct, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """Levels by state, see `ErrorModel`."""

    proportional: list[float] | None = None
    correlated: list[float] | None = None
    memory: float | None = None
    force: list[float] | None = None
    force_time: float | None = None
    walk: list[float] | None = None
    widening: float | None = None


class _Uncertainty(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Matrices by object; of a covariance the rows of its lower triangle, one after the other."""

    covariance: dict[str, list[float]] | None = None
    shared_factor: dict[str, list[list[float]]] | None = None
    noise: list[float] | None = None
    inclusion_probabilities: list[list[float]] | None = None
    error_model: _Errors | None = None


class _Provenance(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    differentiation: str | None = None
    outcomes: tuple[Outcome, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    history: tuple[Step, ...] = ()
    equations: tuple[str, ...] = ()


class _Law(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    format: Literal["commonlaw law"] = "commonlaw law"
    version: Literal[3] = 3
    order: Literal[0, 1, 2]
    schema: Schema
    rates: list[str]
    terms: list[str]
    coefficients: dict[str, list[list[float]]]
    uncertainty: _Uncertainty
    provenance: _Provenance


def encode(parts: Fields) -> bytes:
    """Return what a law is made of as JSON; terms are expressions such as ``x**2*v``, coefficients lists by object."""
    terms, schema, order, objects, coefficients, uncertainty, provenance = parts
    method = provenance.differentiation
    document = _Law(
        order=cast(Literal[0, 1, 2], order),
        schema=schema,
        rates=list(terms.variables.states[len(schema.states) :]),
        terms=[term.expression(terms.variables.names) for term in terms.terms],
        coefficients=dict(zip(objects, coefficients.tolist(), strict=True)),
        uncertainty=_saved_uncertainty(objects, uncertainty),
        provenance=_Provenance(
            differentiation=None if method is None else format_differentiation(method),
            outcomes=provenance.outcomes,
            alternatives=provenance.alternatives,
            history=provenance.history,
            equations=provenance.equations,
        ),
    )
    return msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n"


def _saved_uncertainty(objects: Sequence[str], uncertainty: Uncertainty) -> _Uncertainty:
    covariance = uncertainty.covariance
    triangles = None if covariance is None else covariance[:, *np.tril_indices(covariance.shape[1])]
    triangles, factors, noise, inclusion = (
        None if each is None else each.tolist()
        for each in (triangles, uncertainty.shared_factor, uncertainty.noise, uncertainty.inclusion_probabilities)
    )
    return _Uncertainty(
        covariance=None if triangles is None else dict(zip(objects, triangles, strict=True)),
        shared_factor=None if factors is None else dict(zip(objects, factors, strict=True)),
        noise=noise,
        inclusion_probabilities=inclusion,
        error_model=_saved_errors(uncertainty.error_model),
    )


def _saved_errors(errors: ErrorModel) -> _Errors | None:
    values = {field.name: getattr(errors, field.name) for field in fields(errors)}
    kept = {name: each for name, each in values.items() if each is not None and np.all(np.isfinite(each))}
    return _Errors(**{name: np.asarray(each).tolist() for name, each in kept.items()}) if kept else None


def _read_errors(saved: _Errors | None) -> ErrorModel:
    values = {} if saved is None else msgspec.structs.asdict(saved)
    given: dict[str, Any] = {name: each for name, each in values.items() if each is not None}
    given |= {name: np.array(each) for name, each in given.items() if isinstance(each, list)}
    return ErrorModel(**given)


def decode(content: bytes) -> Fields:
    """Return what the law of a JSON document is made of; documents of versions 1 and 2 are read too.

    Raises
    ------
    CommonlawError
        If it is not a law, is damaged, or is of another version.
    """
    try:
        version = read_json(content, _Header).version
        if 1 <= version <= VERSION:
            raw = read_json(content, dict[str, Any])
            document = msgspec.convert(raw if version == VERSION else renamed(raw), type=_Law)
    except (CommonlawError, msgspec.ValidationError) as error:
        raise CommonlawError(f"this is not a law or it is damaged: {error}; discover the law again") from None
    if not 1 <= version <= VERSION:
        raise CommonlawError(
            f"the law is of version {version} of the format, this commonlaw reads versions up to {VERSION}; "
            "read it with the release that wrote it, or discover the law again"
        )
    if version < VERSION:
        document.provenance.alternatives = compared_with_the_best(document.provenance.alternatives)
    schema = document.schema
    variables = Variables((*schema.states, *document.rates), schema.inputs, schema.time)
    terms = Terms(variables, tuple(parse_term(text, variables) for text in document.terms))
    shape, objects = (len(schema.states), len(terms)), tuple(document.coefficients)
    matrices = [
        _matrix(rows, f"the coefficients of {name!r} are", shape) for name, rows in document.coefficients.items()
    ]
    coefficients = np.array(matrices).reshape(len(objects), *shape)
    parameters = int(np.any(coefficients, axis=0).sum())
    uncertainty = _read_uncertainty(document.uncertainty, objects, shape, parameters)
    saved = document.provenance
    method = None if saved.differentiation is None else parse_differentiation(saved.differentiation)
    provenance = Provenance(method, saved.outcomes, saved.alternatives, saved.history, saved.equations)
    return terms, schema, document.order, objects, coefficients, uncertainty, provenance


def _read_uncertainty(
    saved: _Uncertainty, objects: tuple[str, ...], shape: tuple[int, int], parameters: int
) -> Uncertainty:
    inclusion = saved.inclusion_probabilities
    return Uncertainty(
        None if saved.covariance is None else _covariance(saved.covariance, objects, parameters),
        None if saved.shared_factor is None else _shared_factor(saved.shared_factor, objects, parameters),
        None if saved.noise is None else np.array(saved.noise),
        None if inclusion is None else _matrix(inclusion, "its inclusion probabilities are", shape),
        _read_errors(saved.error_model),
    )


def _covariance(saved: Mapping[str, list[float]], objects: tuple[str, ...], parameters: int) -> Floats:
    """Return the covariance of each object's coefficients from its lower triangle, in the order of the coefficients."""
    rows, columns = np.tril_indices(parameters)
    found = np.zeros((len(objects), parameters, parameters))
    for matrix, name in zip(found, objects, strict=True):
        own = saved.get(name, [])
        if len(own) != len(rows):
            raise CommonlawError(f"the law is damaged: the covariance of {name!r} is not {len(rows)} numbers")
        matrix[rows, columns] = matrix[columns, rows] = own
    return found


def _shared_factor(saved: Mapping[str, list[list[float]]], objects: tuple[str, ...], parameters: int) -> Floats:
    """Return what the errors of objects have in common, in the order of the coefficients."""
    shape = (parameters, parameters)
    found = [_matrix(saved.get(name, []), f"the shared factor of {name!r} is", shape) for name in objects]
    return np.array(found).reshape(len(objects), *shape)


def _matrix(rows: list[list[float]], what: str, shape: tuple[int, int]) -> Floats:
    if len(rows) != shape[0] or any(len(row) != shape[1] for row in rows):
        raise CommonlawError(f"the law is damaged: {what} not {shape[0]} x {shape[1]} numbers")
    return np.array(rows)
