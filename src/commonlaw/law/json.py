"""The saved form of a law: JSON of a versioned schema."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from fractions import Fraction
from typing import Any, Literal, NamedTuple, cast

import msgspec
import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation import format_differentiation, parse_differentiation
from commonlaw.errors import CommonlawError
from commonlaw.foreign import read_json
from commonlaw.hierarchy import Relation
from commonlaw.law.averages import AbstractAverages
from commonlaw.law.document import (
    ErrorsDocument,
    EstimatesDocument,
    ExplanationDocument,
    HeaderDocument,
    LawDocument,
    OtherDocument,
    ProvenanceDocument,
    RelationDocument,
    UncertaintyDocument,
    WideningDocument,
)
from commonlaw.law.earlier_versions import as_now, compared_with_the_best
from commonlaw.law.explanation import Explanation
from commonlaw.law.from_text import read_equations
from commonlaw.law.provenance import Provenance
from commonlaw.law.uncertainty import ObjectEstimates, Uncertainty
from commonlaw.law.widening import Widening
from commonlaw.library import Order, Terms, Variables, parse_terms
from commonlaw.likelihood import ErrorModel
from commonlaw.trials import Schema
from commonlaw.trials.trial import ObjectProperties, nearest

VERSION = 4

_LARGEST = float(np.sqrt(np.finfo(np.float64).max))
"""Of a number in a file: deviances, covariances and lengths of vectors take squares, and that of a larger one, 1.3e154,
is infinite. No law of measurements comes near it."""
_FRACTION = re.compile(r"-?\d+(/\d+)?", re.ASCII)
"""As fractions are written; what else Python reads as one, 1e999999999, may take all memory."""

Fields = tuple[Terms, Schema, Order, tuple[str, ...], Floats, Uncertainty, Provenance, ObjectProperties]
"""What a law is made of: its fields, in order."""


class Decoded(NamedTuple):
    """What laws of a document are made of: the law, that with its discrepancy if it has one, and what else it could be.

    The others come with their probabilities.
    """

    own: Fields
    with_discrepancy: Fields | None
    others: tuple[tuple[float, Fields], ...]


def encode(law: AbstractAverages) -> bytes:
    """Return a law as JSON; terms are expressions such as ``x**2*v``, coefficients lists by object."""
    return msgspec.json.format(msgspec.json.encode(document_of(law)), indent=1) + b"\n"


def document_of(law: AbstractAverages) -> LawDocument:
    """Return what is saved of a law."""
    terms, provenance, wider = law.terms, law.provenance, law.with_discrepancy
    method = provenance.differentiation
    return LawDocument(
        order=cast(Literal[0, 1, 2], law.order),
        schema=law.schema,
        rates=list(terms.variables.states[len(law.schema.states) :]),
        constants=list(terms.variables.constants),
        terms=_saved_terms(terms),
        coefficients=dict(zip(law.objects, law.coefficients.tolist(), strict=True)),
        uncertainty=_saved_uncertainty(law.objects, law.uncertainty),
        provenance=ProvenanceDocument(
            differentiation=None if method is None else format_differentiation(method),
            outcomes=provenance.outcomes,
            alternatives=provenance.alternatives,
            history=provenance.history,
            equations=provenance.equations,
            calls=provenance.calls,
            domain=provenance.domain,
        ),
        properties={name: {**values} for name, values in law.properties.items()},
        explanation=None if law.explanation is None else _saved_explanation(law.explanation),
        with_discrepancy=None if wider is None else document_of(wider),
        other_laws=[_saved_other(each.probability, each.law, terms) for each in law.other_laws],
    )


def _saved_terms(terms: Terms) -> list[str]:
    return [term.expression(terms.variables.names) for term in terms.terms]


def _saved_other(probability: float, law: AbstractAverages, terms: Terms) -> OtherDocument:
    """Return the document of what else a law of these terms could be."""
    support, own = np.any(law.coefficients != 0, axis=0), law.terms != terms
    return OtherDocument(
        probability=probability,
        support=[np.flatnonzero(own).tolist() for own in support],
        coefficients=dict(zip(law.objects, law.coefficients[:, support].tolist(), strict=True)),
        uncertainty=_saved_uncertainty(law.objects, law.uncertainty),
        explanation=None if law.explanation is None else _saved_explanation(law.explanation),
        terms=_saved_terms(law.terms) if own else None,
        constants=list(law.terms.variables.constants) if own else [],
    )


def _saved_uncertainty(objects: Sequence[str], uncertainty: Uncertainty) -> UncertaintyDocument:
    covariance, wider = uncertainty.covariance, uncertainty.widening
    factors, noise, inclusion, degrees = (
        None if each is None else each.tolist()
        for each in (
            uncertainty.shared_factor,
            uncertainty.noise,
            uncertainty.inclusion_probabilities,
            uncertainty.degrees_of_freedom,
        )
    )
    return UncertaintyDocument(
        covariance=None if covariance is None else _triangles(objects, covariance),
        shared_factor=None if factors is None else dict(zip(objects, factors, strict=True)),
        noise=noise,
        inclusion_probabilities=inclusion,
        error_model=_saved_errors(uncertainty.error_model),
        unpooled=_saved_estimates(objects, uncertainty.unpooled),
        pooled=_saved_estimates(objects, uncertainty.pooled),
        degrees_of_freedom=degrees,
        widening=None
        if wider is None
        else WideningDocument(**{name: each.tolist() for name, each in vars(wider).items()}),
    )


def _saved_estimates(objects: Sequence[str], estimates: ObjectEstimates | None) -> EstimatesDocument | None:
    if estimates is None:
        return None
    coefficients = dict(zip(objects, estimates.coefficients.tolist(), strict=True))
    return EstimatesDocument(coefficients=coefficients, covariance=_triangles(objects, estimates.covariance))


def _triangles(objects: Sequence[str], covariance: Floats) -> dict[str, list[float]]:
    return dict(zip(objects, covariance[:, *np.tril_indices(covariance.shape[1])].tolist(), strict=True))


def _saved_explanation(explanation: Explanation) -> ExplanationDocument:
    saved = [None if each is None else _saved_relation(each) for each in explanation.relations]
    return ExplanationDocument(relations=saved, covariance=explanation.covariance.tolist())


def _saved_relation(relation: Relation) -> RelationDocument:
    return RelationDocument(**vars(relation) | {"exponents": tuple(map(str, relation.exponents))})


def _read_explanation(saved: ExplanationDocument) -> Explanation:
    """Return the relations; `Explanation.checked` says whether they fit the law."""
    relations = tuple(None if each is None else _read_relation(each) for each in saved.relations)
    count = sum(len(each.factors) for each in relations if each is not None)
    return Explanation(relations, _matrix(saved.covariance, "the covariance of its factors is", (count, count)))


def _read_relation(saved: RelationDocument) -> Relation:
    try:
        if not all(map(_FRACTION.fullmatch, saved.exponents)):
            raise ValueError("not a fraction")
        exponents = tuple(map(Fraction, saved.exponents))
    except (ValueError, ZeroDivisionError):
        raise CommonlawError("law-exponents", exponents=saved.exponents) from None
    return Relation(**msgspec.structs.asdict(saved) | {"exponents": exponents})


def _saved_errors(errors: ErrorModel) -> ErrorsDocument | None:
    values = {field.name: getattr(errors, field.name) for field in fields(errors)}
    kept = {name: each for name, each in values.items() if each is not None and np.all(np.isfinite(each))}
    return ErrorsDocument(**{name: np.asarray(each).tolist() for name, each in kept.items()}) if kept else None


def _read_errors(saved: ErrorsDocument | None) -> ErrorModel:
    values = {} if saved is None else msgspec.structs.asdict(saved)
    given: dict[str, Any] = {name: each for name, each in values.items() if each is not None}
    given |= {name: np.array(each) for name, each in given.items() if isinstance(each, list)}
    return ErrorModel(**given)


def decode(content: bytes) -> Decoded:
    """Return what the law of a JSON document is made of, see `decode_document`."""
    try:
        raw = read_json(content, dict[str, Any])
    except CommonlawError as error:
        raise not_a_law(error) from None
    return decode_document(raw)


def not_a_law(error: Exception) -> CommonlawError:
    """Return what is said of a document that is no law."""
    return CommonlawError("not-a-law", error=error)


def decode_document(raw: dict[str, Any]) -> Decoded:
    """Return what the law of a document is made of, the one with its discrepancy, and what else it could be.

    Documents of versions 1 to 3 are read too.

    Raises
    ------
    CommonlawError
        If it is not a law, is damaged, or is of another version.
    """
    try:
        version = msgspec.convert(raw, HeaderDocument).version
        if 1 <= version <= VERSION:
            document = msgspec.convert(as_now(raw, version), type=LawDocument)
            check_numbers(raw)
    except (CommonlawError, msgspec.ValidationError) as error:
        raise not_a_law(error) from None
    if not 1 <= version <= VERSION:
        raise CommonlawError("law-version", version=version, supported=VERSION)
    if version < 3:
        document.provenance.alternatives = compared_with_the_best(document.provenance.alternatives)
    wider = document.with_discrepancy
    if wider is not None and wider.with_discrepancy is not None:
        raise CommonlawError("law-nested-discrepancy")
    own = _fields(document)
    others = tuple((each.probability, _other_fields(each, own)) for each in document.other_laws)
    return Decoded(own, None if wider is None else _fields(wider), others)


def check_numbers(document: dict[str, Any]) -> None:
    """Refuse a document with numbers beyond the largest; the message says where."""
    if path := _beyond_computing(document):
        *keys, number = path
        place = "".join(f"[{key!r}]" for key in keys)
        raise CommonlawError("law-number-too-large", place=place, number=nearest(number), limit=_LARGEST)


def _beyond_computing(value: Any) -> list[Any]:
    """Return the path in a document to the first number beyond the largest, and that number; empty without one."""
    if isinstance(value, dict | list):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            if path := _beyond_computing(part):
                return [key, *path]
    elif isinstance(value, int | float) and abs(value) > _LARGEST:
        return [value]
    return []


def _other_fields(saved: OtherDocument, own: Fields) -> Fields:
    """Return what another law is made of, given what the law is made of that is saved with it."""
    terms, schema, order, objects, coefficients, _, _, properties = own
    if saved.terms is not None:
        terms = parse_terms(saved.terms, replace(terms.variables, constants=tuple(saved.constants)))
    shape = (coefficients.shape[1], len(terms))
    support = np.zeros(shape, dtype=np.bool_)
    if len(saved.support) != len(support) or not all(0 <= k < len(terms) for row in saved.support for k in row):
        raise CommonlawError("law-average-terms")
    for row, indices in zip(support, saved.support, strict=True):
        row[indices] = True
    rows = [saved.coefficients.get(name, []) for name in objects]
    parameters = int(support.sum())
    values = np.zeros((len(objects), *shape))
    values[:, support] = _matrix(rows, "coefficients of what else it could be are", (len(objects), parameters))
    if not np.array_equal(np.any(values != 0, axis=0), support):
        raise CommonlawError("law-average-coefficients")
    uncertainty = _read_uncertainty(saved, objects, shape, parameters)
    return terms, schema, order, objects, values, uncertainty, Provenance(), properties


def _fields(document: LawDocument) -> Fields:
    schema = document.schema
    variables = Variables(
        (*schema.states, *document.rates),
        schema.inputs,
        schema.time,
        schema.logarithmic,
        tuple(document.constants),
        document.order if isinstance(document.order, tuple) else (),
    )
    terms = parse_terms(document.terms, variables)
    shape, objects = (len(schema.states), len(terms)), tuple(document.coefficients)
    matrices = [
        _matrix(rows, f"the coefficients of {name!r} are", shape) for name, rows in document.coefficients.items()
    ]
    coefficients = np.array(matrices).reshape(len(objects), *shape)
    parameters = int(np.any(coefficients, axis=0).sum())
    uncertainty = _read_uncertainty(document, objects, shape, parameters)
    saved = document.provenance
    method = None if saved.differentiation is None else parse_differentiation(saved.differentiation)
    provenance = Provenance(**msgspec.structs.asdict(saved) | {"differentiation": method})
    if (
        document.constants
        and provenance.equations
        and read_equations(saved.equations, schema, variables).terms != terms
    ):
        # Before 0.2 what stood before several terms was a constant of each: such laws are as their terms say
        provenance = replace(provenance, equations=())
    return terms, schema, document.order, objects, coefficients, uncertainty, provenance, document.properties


def _read_uncertainty(
    document: LawDocument | OtherDocument, objects: tuple[str, ...], shape: tuple[int, int], parameters: int
) -> Uncertainty:
    saved, explanation = document.uncertainty, document.explanation
    inclusion = saved.inclusion_probabilities
    return Uncertainty(
        None if saved.covariance is None else _covariance(saved.covariance, objects, parameters),
        None if saved.shared_factor is None else _shared_factor(saved.shared_factor, objects, parameters),
        None if saved.noise is None else np.array(saved.noise),
        None if inclusion is None else _matrix(inclusion, "its inclusion probabilities are", shape),
        _read_errors(saved.error_model),
        None if saved.unpooled is None else _read_estimates(saved.unpooled, objects, parameters),
        None if saved.pooled is None else _read_estimates(saved.pooled, objects, parameters),
        None if saved.degrees_of_freedom is None else np.array(saved.degrees_of_freedom),
        None if saved.widening is None else Widening(*map(np.array, msgspec.structs.astuple(saved.widening))),
        None if explanation is None else _read_explanation(explanation),
    )


def _read_estimates(saved: EstimatesDocument, objects: tuple[str, ...], parameters: int) -> ObjectEstimates:
    rows = [saved.coefficients.get(name, []) for name in objects]
    values = _matrix(rows, "its own estimates are", (len(objects), parameters))
    return ObjectEstimates(values, _covariance(saved.covariance, objects, parameters))


def _covariance(saved: Mapping[str, list[float]], objects: tuple[str, ...], parameters: int) -> Floats:
    """Return the covariance of each object's coefficients from its lower triangle, in the order of the coefficients."""
    rows, columns = np.tril_indices(parameters)
    found = np.zeros((len(objects), parameters, parameters))
    for matrix, name in zip(found, objects, strict=True):
        own = saved.get(name, [])
        if len(own) != len(rows):
            raise CommonlawError("law-covariance-size", name=name, expected=len(rows))
        matrix[rows, columns] = matrix[columns, rows] = own
    return found


def _shared_factor(saved: Mapping[str, list[list[float]]], objects: tuple[str, ...], parameters: int) -> Floats:
    """Return what the errors of objects have in common, in the order of the coefficients."""
    columns = max((len(row) for rows in saved.values() for row in rows), default=parameters)
    shape = (parameters, columns)
    found = [_matrix(saved.get(name, []), f"the shared factor of {name!r} is", shape) for name in objects]
    return np.array(found).reshape(len(objects), *shape)


def _matrix(rows: list[list[float]], what: str, shape: tuple[int, int]) -> Floats:
    if len(rows) != shape[0] or any(len(row) != shape[1] for row in rows):
        raise CommonlawError("law-table-size", table=what, rows=shape[0], columns=shape[1])
    return np.array(rows)
