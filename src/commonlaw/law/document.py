"""The schema of saved laws, level by level, and documents of its earlier versions."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import msgspec

from commonlaw.hierarchy import RelationKind
from commonlaw.law.provenance import Alternative, Domain, Step
from commonlaw.outcomes import Outcome
from commonlaw.trials import Schema


class HeaderDocument(msgspec.Struct):
    """What says whether the rest can be read."""

    format: Literal["commonlaw law"]
    version: int


class ErrorsDocument(msgspec.Struct, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """Levels by state, see `ErrorModel`."""

    proportional: list[float] | None = None
    correlated: list[float] | None = None
    memory: float | None = None
    force: list[float] | None = None
    force_time: float | None = None
    walk: list[float] | None = None


class EstimatesDocument(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """See `ObjectEstimates`; by object."""

    coefficients: dict[str, list[float]]
    covariance: dict[str, list[float]]


class WideningDocument(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """See `Widening`."""

    horizons: list[float]
    factors: list[float]


class UncertaintyDocument(msgspec.Struct, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """Matrices by object; of a covariance the rows of its lower triangle, one after the other."""

    covariance: dict[str, list[float]] | None = None
    shared_factor: dict[str, list[list[float]]] | None = None
    noise: list[float] | None = None
    inclusion_probabilities: list[list[float]] | None = None
    error_model: ErrorsDocument | None = None
    unpooled: EstimatesDocument | None = None
    pooled: EstimatesDocument | None = None
    degrees_of_freedom: list[float] | None = None
    widening: WideningDocument | None = None


class RelationDocument(msgspec.Struct, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """See `Relation`; exponents are fractions as text."""

    kind: RelationKind
    factors: tuple[float, ...]
    errors: tuple[float, ...]
    properties: tuple[str, ...] = ()
    exponents: tuple[str, ...] = ()
    scatter: float = 0.0
    scatter_error: float = 0.0
    relative: bool = True
    probability: float = 1.0
    typical: float = 1.0


class ExplanationDocument(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """See `Explanation`."""

    relations: list[RelationDocument | None]
    covariance: list[list[float]]


class ProvenanceDocument(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """See `Provenance`; the differentiation as text."""

    differentiation: str | None = None
    outcomes: tuple[Outcome, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    history: tuple[Step, ...] = ()
    equations: tuple[str, ...] = ()
    calls: tuple[str, ...] = ()
    domain: Domain = Domain()


class OtherDocument(msgspec.Struct, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """A plausible other law: indices of its terms by equation, coefficients by object; terms where they are its own."""

    probability: float
    support: list[list[int]]
    coefficients: dict[str, list[float]]
    uncertainty: UncertaintyDocument
    explanation: ExplanationDocument | None = None
    terms: list[str] | None = None
    constants: list[str] = []


class LawDocument(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """See `Law`; terms are expressions, coefficients lists by object, constants the names of those inside of terms."""

    format: Literal["commonlaw law"] = "commonlaw law"
    version: Literal[4] = 4
    order: Literal[0, 1, 2] | tuple[Literal[1, 2], ...]
    schema: Schema
    rates: list[str]
    terms: list[str]
    coefficients: dict[str, list[list[float]]]
    uncertainty: UncertaintyDocument
    provenance: ProvenanceDocument
    properties: dict[str, dict[str, float | str]] = {}
    explanation: ExplanationDocument | None = None
    with_discrepancy: "LawDocument | None" = None
    other_laws: list[OtherDocument] = []
    constants: list[str] = []


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
    """Return a document of an earlier version, which need not be valid, by the names of version 4."""
    found = _with_widening(_renamed(document) if version < 3 else {**document, "version": 4})
    others = found.get("other_laws")
    if isinstance(others, list):
        found |= {"other_laws": [_with_widening(each) if isinstance(each, dict) else each for each in others]}
    wider = found.get("with_discrepancy")
    return found | {"with_discrepancy": _with_widening({**wider, "version": 4})} if isinstance(wider, dict) else found


def _with_widening(document: dict[str, Any]) -> dict[str, Any]:
    """Return a document whose factor of intervals, if its errors have one, is a widening that no horizon changes."""
    known = document.get("uncertainty")
    errors = known.get("error_model") if isinstance(known, dict) else None
    if not (isinstance(known, dict) and isinstance(errors, dict) and "widening" in errors):
        return document
    factor = errors["widening"]
    left = {"error_model": {name: each for name, each in errors.items() if name != "widening"} or None}
    wider = known.get("widening") or (None if factor == 1 else {"horizons": [0.0], "factors": [factor]})
    return document | {"uncertainty": known | left | {"widening": wider}}


def _renamed(document: dict[str, Any]) -> dict[str, Any]:
    """Return a document of version 1 or 2."""
    moved = {*_UNCERTAINTY, *_PROVENANCE}
    provenance = {key: document[key] for key in _PROVENANCE if key in document}
    if isinstance(provenance.get("outcomes"), list):
        provenance["outcomes"] = [
            each | {"kind": "model error"} if isinstance(each, dict) and each.get("kind") == "not obeyed" else each
            for each in provenance["outcomes"]
        ]
    if isinstance(provenance.get("alternatives"), list):
        provenance["alternatives"] = list(map(_alternative, provenance["alternatives"]))
    return {
        **{key: value for key, value in document.items() if key not in moved},
        "version": 4,
        "uncertainty": {name: document[key] for key, name in _UNCERTAINTY.items() if key in document},
        "provenance": provenance,
    }


def compared_with_the_best(alternatives: Sequence[Alternative]) -> tuple[Alternative, ...]:
    """Return alternatives whose Bayes factors are against the best of their equation, no more against the chosen."""
    known = [(each.equation, value) for each in alternatives if (value := each.measures.get(_BAYES_FACTOR)) is not None]
    least = {name: min(value for other, value in known if other == name) for name, _ in known}

    def compared(each: Alternative) -> Alternative:
        value = each.measures.get(_BAYES_FACTOR)
        if value is None:
            return each
        return replace(each, measures={**each.measures, _BAYES_FACTOR: value - least[each.equation]})

    return tuple(map(compared, alternatives))


def _alternative(value: Any) -> Any:
    """Return an alternative, or the measures in it, by the present names."""
    if not isinstance(value, dict):
        return value
    return {_ALTERNATIVES.get(key, key): _alternative(each) for key, each in value.items()}
