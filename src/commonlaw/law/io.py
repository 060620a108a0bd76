"""Saved laws: JSON of a versioned schema, or for very many objects Parquet, a row for each of them."""

import json
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import compress, product
from math import prod
from typing import Any, Literal, cast

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.diagnostics import Outcome
from commonlaw.differentiation import format_differentiation, parse_differentiation
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.law.export import exported
from commonlaw.law.law import Law, with_other_laws
from commonlaw.law.objects import select_objects
from commonlaw.law.observation import STATES, Observation, Scheme, TrialEstimate, TrialEstimates
from commonlaw.law.parameters import named_parameters
from commonlaw.law.parse import read_equations
from commonlaw.law.provenance import Alternative, Domain, Provenance, Step
from commonlaw.law.restrictions import ALL, Restrictions
from commonlaw.law.uncertainty import (
    AtBound,
    Explanation,
    IntervalInflation,
    Misfit,
    ObjectEstimates,
    OneSidedLimit,
    PlausibleLaw,
    Uncertainty,
)
from commonlaw.library import Terms, Variables, parse_terms
from commonlaw.library.functions import Function, functions_in
from commonlaw.library.grammar import FUNCTIONS
from commonlaw.likelihood import HUBER_THRESHOLD, ErrorModel
from commonlaw.runtime.arguments import checks_types
from commonlaw.runtime.files import LARGEST_JSON, MOST_CELLS, MOST_COLUMNS, check_size, path_of, read_json
from commonlaw.trials import Schema
from commonlaw.trials.files import parquet_bytes, parquet_columns
from commonlaw.trials.trial import nearest

VERSION = 8

_LARGEST = float(np.sqrt(np.finfo(np.float64).max))
"""Of a number in a file: deviances, covariances and lengths of vectors take squares, and that of a larger one, 1.3e154,
is infinite. No law of measurements comes near it."""
_CALL = re.compile(r"`(?:[^`]|``)+`|(?<!\w)([^\W\d]\w*)\(")
"""The name of a function in an expression; nothing in a name between backticks is one."""
_FRACTION = re.compile(r"-?\d+(/\d+)?", re.ASCII)
"""As fractions are written; what else Python reads as one, 1e999999999, may take all memory."""


class HeaderDocument(msgspec.Struct):
    """What says whether the rest can be read."""

    format: Literal["commonlaw law"]
    version: int


class ErrorsDocument(msgspec.Struct, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """Levels by state, see `ErrorModel`; heteroscedastic ones by kind, but for those in proportion to the state.

    Those by object, and by the label of a trial, are factors of the noise.
    """

    proportional: Floats | None = None
    heteroscedastic: dict[str, Floats] = {}
    correlated: Floats | None = None
    memory: float | None = None
    force: Floats | None = None
    force_time: float | None = None
    walk: Floats | None = None
    sensor_walk: Floats | None = None
    offset: Floats | None = None
    slope: Floats | None = None
    trend: Floats | None = None
    by_object: dict[str, Floats] = {}
    by_trial: dict[str, Floats] = {}


class EstimatesDocument(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """See `ObjectEstimates`; by object."""

    coefficients: dict[str, list[float]]
    covariance: dict[str, list[float]]


class UncertaintyDocument(msgspec.Struct, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """Matrices by object; of a covariance the rows of its lower triangle, one after the other.

    The Huber threshold is null for least squares.
    """

    covariance: dict[str, list[float]] | None = None
    shared_factor: dict[str, list[list[float]]] | None = None
    noise: Floats | None = None
    noise_of: dict[str, dict[str, float]] = {}
    inclusion_probabilities: Floats | None = None
    error_model: ErrorsDocument | None = None
    huber_threshold: float | None = HUBER_THRESHOLD
    unpooled: EstimatesDocument | None = None
    pooled: EstimatesDocument | None = None
    degrees_of_freedom: Floats | None = None
    interval_inflation: IntervalInflation | None = None
    limits: tuple[OneSidedLimit, ...] = ()
    at_bounds: tuple[AtBound, ...] = ()
    misfit: Misfit | None = None


class ProvenanceDocument(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """See `Provenance`; the differentiation as text."""

    differentiation: str | None = None
    outcomes: tuple[Outcome, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    history: tuple[Step, ...] = ()
    equations: tuple[str, ...] = ()
    calls: tuple[str, ...] = ()
    domain: Domain = Domain()
    log_likelihood: float | None = None
    searched: str = ""


class OtherDocument(msgspec.Struct, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """A plausible other law: indices of its terms by equation, coefficients by object; terms where they are its own."""

    probability: float
    support: list[list[int]]
    coefficients: dict[str, list[float]]
    uncertainty: UncertaintyDocument
    explanation: Explanation | None = None
    terms: list[str] | None = None
    constants: list[str] = []
    restrictions: Restrictions | None = None


class LawDocument(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """See `Law`; terms are expressions, coefficients lists by object, constants the names of those inside terms."""

    format: Literal["commonlaw law"] = "commonlaw law"
    version: Literal[8] = 8
    order: Literal[0, 1, 2] | tuple[Literal[1, 2], ...]
    schema: Schema
    rates: list[str]
    terms: list[str]
    coefficients: dict[str, list[list[float]]]
    uncertainty: UncertaintyDocument
    provenance: ProvenanceDocument
    properties: dict[str, dict[str, float | str]] = {}
    explanation: Explanation | None = None
    with_discrepancy: "LawDocument | None" = None
    other_laws: list[OtherDocument] = []
    constants: list[str] = []
    observation: Observation | None = None
    restrictions: Restrictions | None = None
    scheme: Scheme = "collocation"
    trial_estimates: tuple[TrialEstimate, ...] = ()


_BAYES_FACTOR = "2 log B"
_UNCERTAINTY = {
    "covariance": "covariance",
    "common": "shared_factor",
    "noise": "noise",
    "inclusion": "inclusion_probabilities",
}
_PROVENANCE = ("differentiation", "outcomes", "alternatives", "history")
_ALTERNATIVES = {"settings": "hyperparameters", "evidence lost": _BAYES_FACTOR}


def as_now(document: dict[str, Any], version: int) -> dict[str, Any]:
    """Return a document of an earlier version, or of a law in it, by the names of version 8; it need not be valid."""
    current = _renamed(document) if version < 3 else dict(document)
    if "version" in current:
        current["version"] = VERSION
    if isinstance(uncertainty := current.get("uncertainty"), dict):
        current["uncertainty"] = uncertainty = dict(uncertainty)
        inflation = uncertainty.pop("widening", None)
        if isinstance(errors := uncertainty.get("error_model"), dict) and "widening" in errors:
            factor = errors["widening"]
            uncertainty["error_model"] = {name: error for name, error in errors.items() if name != "widening"} or None
            inflation = inflation or (None if factor == 1 else {"horizons": [0.0], "factors": [factor]})
        if inflation is not None:
            uncertainty["interval_inflation"] = inflation
    observation = current.get("observation")
    if version < 5 and isinstance(observation, dict) and isinstance(observation.get("estimated"), list):
        named = [
            {"name": f"{estimate['state']}(0)", **{key: value for key, value in estimate.items() if key != "state"}}
            if isinstance(estimate, dict) and "state" in estimate
            else estimate
            for estimate in observation["estimated"]
        ]
        current["observation"] = observation = observation | {"estimated": named}
    if isinstance(observation, dict) and "restrictions" in observation:
        current["observation"] = {name: value for name, value in observation.items() if name != "restrictions"}
        current["restrictions"] = observation["restrictions"]
    if version < 8 and isinstance(observation := current.get("observation"), dict):
        current |= _estimates_apart(current, observation)
    if isinstance(others := current.get("other_laws"), list):
        current["other_laws"] = [as_now(law, VERSION) if isinstance(law, dict) else law for law in others]
    if isinstance(wider := current.get("with_discrepancy"), dict):
        current["with_discrepancy"] = as_now(wider, VERSION)
    return current


_OF_OBSERVATION = ("noise", "noise_of", "sizes", "estimated", "log_likelihood", "degrees_of_freedom")


def _estimates_apart(document: dict[str, Any], observation: dict[str, Any]) -> dict[str, Any]:
    """Return the parts of a document before version 8 whose observation had the estimates of a fit by shooting."""
    measured, uncertainty, provenance = (
        part if isinstance(part, dict) else {}
        for part in (observation.get("measured"), document.get("uncertainty"), document.get("provenance"))
    )
    empty: dict[str, Any] = {key: {} for key in _OF_OBSERVATION} | {"estimated": [], "log_likelihood": None}
    names, known = measured.get("states"), {name: observation.get(name, part) for name, part in empty.items()}
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return {}
    noise, degrees = known["noise"], known["degrees_of_freedom"]
    for levels in (noise, degrees):
        if not isinstance(levels, dict) or not all(isinstance(level, int | float) for level in levels.values()):
            raise CommonlawError("not-a-law", error="levels of noise are not numbers")
        for name in levels:
            check_choice("measured quantity", name, names)
    every = sum(degrees.values())
    levels_now = {
        "noise": [noise[name] for name in names] if {*names} <= {*noise} else None,
        "noise_of": known["noise_of"],
        "degrees_of_freedom": [degrees.get(name, every) for name in names] if degrees else None,
    }
    domain = provenance.get("domain")
    sized = {"domain": {**(domain if isinstance(domain, dict) else {}), "sizes": known["sizes"]}}
    return {
        "observation": {name: value for name, value in observation.items() if name not in _OF_OBSERVATION},
        "uncertainty": {**uncertainty, **levels_now},
        "provenance": {**provenance, **sized, "log_likelihood": known["log_likelihood"]},
        "scheme": "shooting",
        "trial_estimates": known["estimated"],
    }


def _renamed(document: dict[str, Any]) -> dict[str, Any]:
    """Return a document of version 1 or 2."""
    moved = {*_UNCERTAINTY, *_PROVENANCE}
    provenance = {key: document[key] for key in _PROVENANCE if key in document}
    if isinstance(provenance.get("outcomes"), list):
        provenance["outcomes"] = [
            outcome | {"kind": "model error"}
            if isinstance(outcome, dict) and outcome.get("kind") == "not obeyed"
            else outcome
            for outcome in provenance["outcomes"]
        ]
    if isinstance(provenance.get("alternatives"), list):
        provenance["alternatives"] = list(map(_alternative, provenance["alternatives"]))
    return {
        **{key: value for key, value in document.items() if key not in moved},
        "version": VERSION,
        "uncertainty": {name: document[key] for key, name in _UNCERTAINTY.items() if key in document},
        "provenance": provenance,
    }


def compared_with_the_best(alternatives: Sequence[Alternative]) -> tuple[Alternative, ...]:
    """Return alternatives whose Bayes factors are against the best of their equation, no more against the chosen."""

    def value_of(alternative: Alternative) -> float:
        value = alternative.measures.get(_BAYES_FACTOR)
        return np.inf if value is None else value

    def compared(alternative: Alternative) -> Alternative:
        best = min(value_of(rival) for rival in alternatives if rival.equation == alternative.equation)
        difference = {_BAYES_FACTOR: value_of(alternative) - best} if value_of(alternative) < np.inf else {}
        return replace(alternative, measures={**alternative.measures, **difference})

    return tuple(map(compared, alternatives))


def _alternative(value: Any) -> Any:
    """Return an alternative, or the measures in it, by the present names."""
    if not isinstance(value, dict):
        return value
    return {_ALTERNATIVES.get(key, key): _alternative(entry) for key, entry in value.items()}


@checks_types
def to_json(law: Law) -> str:
    """Return the law as JSON in a versioned schema, with terms as expressions such as ``x**2*v``."""
    document = document_of(law)
    check_numbers(msgspec.to_builtins(document, enc_hook=_plain))
    return msgspec.json.format(msgspec.json.encode(document, enc_hook=_plain), indent=1).decode() + "\n"


def document_of(law: Law) -> LawDocument:
    """Return what is saved of a law."""
    terms, provenance, wider = law.terms, law.provenance, law.provenance.with_discrepancy
    method = provenance.differentiation
    return LawDocument(
        order=cast(Literal[0, 1, 2], law.order),
        schema=law.schema,
        rates=list(terms.variables.states[len(law.schema.states) :]),
        constants=list(terms.variables.parameters),
        terms=_saved_terms(terms),
        coefficients=dict(zip(law.objects, law.coefficients.tolist(), strict=True)),
        uncertainty=_saved_uncertainty(law.objects, law.uncertainty),
        provenance=ProvenanceDocument(
            **{name: getattr(provenance, name) for name in ProvenanceDocument.__struct_fields__}
            | {"differentiation": None if method is None else format_differentiation(method)}
        ),
        properties={name: {**values} for name, values in law.properties.items()},
        explanation=law.uncertainty.explanation,
        with_discrepancy=None if wider is None else document_of(wider),
        other_laws=[_saved_other(model.probability, model.law, terms) for model in law.uncertainty.other_laws],
        observation=law.observation if law.scheme == "shooting" else None,
        restrictions=law.restrictions,
        scheme=law.scheme,
        trial_estimates=law.trial_estimates,
    )


def _saved_terms(terms: Terms) -> list[str]:
    return [term.expression(terms.variables.names) for term in terms.terms]


def _saved_other(probability: float, law: Law, terms: Terms) -> OtherDocument:
    """Return the document of what else a law of these terms could be."""
    support, has_own_terms = np.any(law.coefficients != 0, axis=0), law.terms != terms
    return OtherDocument(
        probability=probability,
        support=[np.flatnonzero(row).tolist() for row in support],
        coefficients=dict(zip(law.objects, law.coefficients[:, support].tolist(), strict=True)),
        uncertainty=_saved_uncertainty(law.objects, law.uncertainty),
        explanation=law.uncertainty.explanation,
        terms=_saved_terms(law.terms) if has_own_terms else None,
        constants=list(law.terms.variables.parameters) if has_own_terms else [],
        restrictions=law.restrictions,
    )


def _saved_uncertainty(objects: Sequence[str], uncertainty: Uncertainty) -> UncertaintyDocument:
    def by_object(values: Floats | None) -> Any:
        return None if values is None else dict(zip(objects, values.tolist(), strict=True))

    def triangles(covariance: Floats | None) -> Any:
        return None if covariance is None else by_object(covariance[:, *np.tril_indices(covariance.shape[1])])

    def estimates(known: ObjectEstimates | None) -> EstimatesDocument | None:
        if known is None:
            return None
        return EstimatesDocument(coefficients=by_object(known.coefficients), covariance=triangles(known.covariance))

    levels = {name: level for name, level in vars(uncertainty.error_model).items() if level is not None}
    grown, factors = (
        {**levels.pop("heteroscedastic")},
        {name: {**levels.pop(name)} for name in ("by_object", "by_trial")},
    )
    errors = {name: level for name, level in levels.items() if np.isfinite(level).all()}
    if grown:
        errors |= {"proportional": grown.pop("proportional", None), "heteroscedastic": grown}
    errors |= {name: known for name, known in factors.items() if known}
    return UncertaintyDocument(
        covariance=triangles(uncertainty.covariance),
        shared_factor=by_object(uncertainty.shared_factor),
        noise=uncertainty.noise,
        noise_of={name: {**levels} for name, levels in uncertainty.noise_of.items()},
        inclusion_probabilities=uncertainty.inclusion_probabilities,
        error_model=ErrorsDocument(**errors) if errors else None,
        huber_threshold=uncertainty.huber_threshold if np.isfinite(uncertainty.huber_threshold) else None,
        unpooled=estimates(uncertainty.unpooled),
        pooled=estimates(uncertainty.pooled),
        degrees_of_freedom=uncertainty.degrees_of_freedom,
        interval_inflation=uncertainty.interval_inflation,
        limits=uncertainty.limits,
        at_bounds=uncertainty.at_bounds,
        misfit=uncertainty.misfit,
    )


def _plain(value: Any) -> Any:
    """Return a fraction as text, or an array as a list."""
    return str(value) if isinstance(value, Fraction) else value.tolist()


def _parsed(kind: Any, value: Any) -> Any:
    """Return a fraction from its text, or an array from a list."""
    if kind is not Fraction:
        return np.array(msgspec.convert(value, list[float | list[float]]), dtype=np.float64)
    try:
        if not _FRACTION.fullmatch(value):
            raise ValueError("not a fraction")
        return Fraction(value)
    except (TypeError, ValueError, ZeroDivisionError):
        raise CommonlawError("law-exponents", exponents=[value]) from None


@checks_types
def from_json(content: str | bytes, functions: Iterable[Callable[..., Any]] = ()) -> Law:
    """Return the law in JSON that was written by `to_json`; its terms may call the given Python functions.

    Raises `CommonlawError` if the text is damaged or of a newer schema, or if a function is missing.

    Examples
    --------
    >>> import commonlaw as cl
    >>> law = cl.Law.from_text("T' = -k T", {"k": 0.5})
    >>> cl.law.from_json(cl.law.to_json(law)) == law
    True
    """
    try:
        raw = read_json(content.encode() if isinstance(content, str) else content, dict[str, Any])
    except CommonlawError as error:
        raise CommonlawError("not-a-law", error=error) from None
    return decode_document(raw, functions)


def decode_document(raw: dict[str, Any], functions: Iterable[Callable[..., Any]] = ()) -> Law:
    """Return the law of a document of any version, which may call these functions of Python."""
    try:
        version = msgspec.convert(raw, HeaderDocument).version
        if 1 <= version <= VERSION:
            document = msgspec.convert(as_now(raw, version), type=LawDocument, dec_hook=_parsed)
            check_numbers(raw)
    except (CommonlawError, msgspec.ValidationError) as error:
        raise (
            error.__cause__ if isinstance(error.__cause__, CommonlawError) else CommonlawError("not-a-law", error=error)
        ) from None
    if not 1 <= version <= VERSION:
        raise CommonlawError("law-version", version=version, supported=VERSION)
    if version < 3:
        document.provenance.alternatives = compared_with_the_best(document.provenance.alternatives)
    wider = document.with_discrepancy
    if wider is not None and wider.with_discrepancy is not None:
        raise CommonlawError("law-nested-discrepancy")
    called = functions_in(functions)
    law = _read_law(document, called)
    if version < 7 and law.scheme == "collocation":
        law = _with_recorded_sharing(law)
    others = tuple(PlausibleLaw(saved.probability, _read_other(saved, law)) for saved in document.other_laws)
    provenance = replace(law.provenance, with_discrepancy=None if wider is None else _read_law(wider, called))
    return with_other_laws(replace(law, provenance=provenance), others)


def _with_recorded_sharing(law: Law) -> Law:
    """Return a law that was saved before its restrictions were, with parameters that all objects have in common."""
    if law.uncertainty.shared_factor is None or law.uncertainty.explanation is not None:
        return law
    parameters = named_parameters(law)
    in_common = (np.ptp(parameters.values, axis=0) == 0) & np.all(parameters.errors > 0, axis=0)
    return replace(law, restrictions=Restrictions(dict.fromkeys(compress(parameters.names, in_common), ALL)))


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


def _read_other(saved: OtherDocument, law: Law) -> Law:
    """Return the plausible laws that are saved with a law."""
    terms, objects = law.terms, law.objects
    if saved.terms is not None:
        terms = parse_terms(saved.terms, replace(terms.variables, parameters=tuple(saved.constants)))
    shape = (len(law.schema.states), len(terms))
    support = np.zeros(shape, dtype=np.bool_)
    if len(saved.support) != len(support) or not all(0 <= k < len(terms) for row in saved.support for k in row):
        raise CommonlawError("law-average-terms")
    for row, indices in zip(support, saved.support, strict=True):
        row[indices] = True
    rows = [saved.coefficients.get(name, []) for name in objects]
    parameters = int(support.sum())
    values = np.zeros((len(objects), *shape))
    values[:, support] = _matrix(rows, "coefficients of other probable laws are", (len(objects), parameters))
    if not np.array_equal(np.any(values != 0, axis=0), support):
        raise CommonlawError("law-average-coefficients")
    uncertainty = _read_uncertainty(saved, objects, shape, parameters)
    return Law(
        terms,
        law.schema,
        law.order,
        objects,
        values,
        uncertainty,
        properties=law.properties,
        restrictions=saved.restrictions,
    )


def _read_law(document: LawDocument, functions: tuple[Function, ...]) -> Law:
    schema, known = document.schema, (*FUNCTIONS, *(function.name for function in functions))
    if missing := {name for text in document.terms for name in _CALL.findall(text)} - {"", *known}:
        raise CommonlawError("functions-missing", names=sorted(missing))
    variables = Variables(
        (*schema.states, *document.rates),
        schema.inputs,
        schema.time,
        schema.logarithmic,
        tuple(document.constants),
        document.order if isinstance(document.order, tuple) else (),
        functions,
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
    is_given = bool(document.constants and provenance.equations)
    if is_given and read_equations(saved.equations, schema, variables).terms != terms:
        # Before 0.2 what stood before several terms was a constant of each: such laws are as their terms say
        provenance = replace(provenance, equations=())
    return Law(
        terms,
        schema,
        document.order,
        objects,
        coefficients,
        uncertainty,
        provenance,
        document.properties,
        document.observation or STATES,
        document.restrictions,
        document.scheme,
        TrialEstimates(document.trial_estimates),
    )


def _read_uncertainty(
    document: LawDocument | OtherDocument, objects: tuple[str, ...], shape: tuple[int, int], parameters: int
) -> Uncertainty:
    saved, shared = document.uncertainty, None
    inclusion = saved.inclusion_probabilities
    if inclusion is not None and inclusion.shape != shape:
        raise CommonlawError("law-table-size", table="its inclusion probabilities are", rows=shape[0], columns=shape[1])
    levels = msgspec.structs.asdict(saved.error_model) if saved.error_model else {}
    levels = {name: level for name, level in levels.items() if level is not None}
    grown = {kind: levels.pop(kind) for kind in ("proportional",) if kind in levels} | levels.pop("heteroscedastic", {})
    if saved.shared_factor is not None:
        columns = max((len(row) for rows in saved.shared_factor.values() for row in rows), default=parameters)
        matrices = [
            _matrix(saved.shared_factor.get(name, []), f"the shared factor of {name!r} is", (parameters, columns))
            for name in objects
        ]
        shared = np.array(matrices).reshape(len(objects), parameters, columns)

    def estimates(known: EstimatesDocument | None) -> ObjectEstimates | None:
        if known is None:
            return None
        rows = [known.coefficients.get(name, []) for name in objects]
        values = _matrix(rows, "its own estimates are", (len(objects), parameters))
        return ObjectEstimates(values, _covariance(known.covariance, objects, parameters))

    return Uncertainty(
        None if saved.covariance is None else _covariance(saved.covariance, objects, parameters),
        shared,
        saved.noise,
        saved.noise_of,
        inclusion,
        ErrorModel(grown, **levels),
        np.inf if saved.huber_threshold is None else saved.huber_threshold,
        estimates(saved.unpooled),
        estimates(saved.pooled),
        saved.degrees_of_freedom,
        saved.interval_inflation,
        document.explanation,
        saved.limits,
        saved.at_bounds,
        misfit=saved.misfit,
    )


def _covariance(saved: Mapping[str, list[float]], objects: tuple[str, ...], parameters: int) -> Floats:
    """Return the covariance of each object's coefficients from its lower triangle, in the order of the coefficients."""
    rows, columns = np.tril_indices(parameters)
    result = np.zeros((len(objects), parameters, parameters))
    for matrix, name in zip(result, objects, strict=True):
        triangle = saved.get(name, [])
        if len(triangle) != len(rows):
            raise CommonlawError("law-covariance-size", name=name, expected=len(rows))
        matrix[rows, columns] = matrix[columns, rows] = triangle
    return result


def _matrix(rows: list[list[float]], what: str, shape: tuple[int, int]) -> Floats:
    if len(rows) != shape[0] or any(len(row) != shape[1] for row in rows):
        raise CommonlawError("law-table-size", table=what, rows=shape[0], columns=shape[1])
    return np.array(rows)


_METADATA = b"commonlaw law"
"""The key under which a file keeps all of a law that is not by object, as JSON."""

_PARQUET = b"PAR1"
"""What Parquet files begin with."""

_BY_OBJECT = ("coefficients", "covariance", "shared_factor", "properties")
"""Parts of a law's document that are mappings from objects; each becomes columns of the table."""

_OBJECTS = "object"


def file_content(
    law: Law, path: str | os.PathLike[str], name: str | None = None, initial: ArrayLike | None = None
) -> bytes:
    """Return the content of a file of a law in the format of its extension, see `Law.save`."""
    if path_of(path).suffix.lower() not in ("", ".json", ".parquet"):
        return exported(law, path, name, initial)
    if initial is not None:
        raise CommonlawError("export-initial-of-law", path=str(path))
    law = law if name is None else select_objects(law, [name])
    file, content = law_file(law, str(path))
    if file != str(path):
        raise CommonlawError("law-too-large-for-json", objects=len(law.objects))
    return content


def law_file(law: Law, path: str) -> tuple[str, bytes]:
    """Return name and content of the file of a law: the path, or where JSON is too large that of a Parquet file."""
    document = msgspec.to_builtins(document_of(law), enc_hook=_plain)
    try:
        check_numbers(document)
    except CommonlawError as error:
        raise CommonlawError("law-not-saved", where=path, error=error) from None
    if not path.endswith(".parquet"):
        content = to_json(law).encode()
        if len(content) <= LARGEST_JSON:
            return path, content
        path += ".parquet"
    columns: dict[str, Any] = {_OBJECTS: law.objects}

    def as_columns(key: str, each: dict[str, Any], name: str) -> dict[str, Any]:
        if key == "properties":
            kinds = list(dict.fromkeys(kind for attributes in each.values() for kind in attributes))
            columns.update(
                {f"{name}{kind}": [each.get(owner, {}).get(kind) for owner in law.objects] for kind in kinds}
            )
            return {"names": kinds}
        array = np.array([each[owner] for owner in law.objects])
        columns.update({_column(name, index): array[:, *index] for index in np.ndindex(*array.shape[1:])})
        return {"shape": array.shape[1:]}

    rest = _walked(document, "", as_columns)
    check_size(path, len(law.objects), len(columns))
    return path, parquet_bytes(columns, {_METADATA: json.dumps(rest).encode()})


def _walked(value: Any, path: str, change: Callable[[str, dict[str, Any], str], Any]) -> Any:
    """Return a document with what is by object changed, given its key and the path to it."""
    if isinstance(value, list):
        return [_walked(part, f"{path}{i} ", change) for i, part in enumerate(value)]
    if not isinstance(value, dict):
        return value
    return {
        key: change(key, part, f"{path}{key} ")
        if key in _BY_OBJECT and isinstance(part, dict)
        else _walked(part, f"{path}{key} ", change)
        for key, part in value.items()
    }


def decoded_file(content: bytes, functions: Iterable[Callable[..., Any]] = ()) -> Law:
    """Return the law of a file, which may call these functions of Python."""
    if not content.startswith(_PARQUET):
        return from_json(content, functions)
    columns, metadata = parquet_columns("the law", content)
    if _METADATA not in metadata or _OBJECTS not in columns:
        raise CommonlawError("not-a-law-but-measurements")
    objects = columns[_OBJECTS]

    def of_columns(key: str, each: dict[str, Any], name: str) -> dict[str, Any]:
        if key != "properties":
            return dict(zip(objects, _nested(each["shape"], name, len(objects), columns), strict=True))
        cells = {kind: columns[f"{name}{kind}"] for kind in each["names"]}
        return {
            owner: {kind: column[i] for kind, column in cells.items() if column[i] is not None}
            for i, owner in enumerate(objects)
        }

    try:
        if len({*objects}) < len(objects):
            raise ValueError("an object stands in two rows")
        rest = read_json(metadata[_METADATA], dict[str, Any])
        raw = _walked(rest, "", of_columns)
    except KeyError as error:
        raise CommonlawError("not-a-law", error=f"it lacks {error}") from None
    except (CommonlawError, TypeError, ValueError) as error:
        raise CommonlawError("not-a-law", error=error) from None
    assert isinstance(raw, dict)
    return decode_document(raw, functions)


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
