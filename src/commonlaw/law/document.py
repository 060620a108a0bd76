"""The schema of saved laws: what their JSON holds, level by level."""

from typing import Literal

import msgspec

from commonlaw.hierarchy import RelationKind
from commonlaw.law.domain import Domain
from commonlaw.law.provenance import Alternative, Step
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
    """What else a law could be: which terms (by their index) are in which equation, and by object what they have.

    Terms, and the constants inside of them, where they are not those of the law.
    """

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
