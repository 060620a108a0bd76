"""Names of members of `Law` of earlier versions: deprecated, for one release."""

import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

DEPRECATED: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "adapt": ("update(trials)", lambda law: law.update),
    "alternatives": ("provenance.alternatives", lambda law: law.provenance.alternatives),
    "candidates": ("comparison", lambda law: lambda: _candidates(law)),
    "coefficients_of": ("coefficients[index(name)]", lambda law: lambda name: law.coefficients[law.index(name)]),
    "covariance": ("uncertainty.covariance", lambda law: law.uncertainty.covariance),
    "differentiation": ("provenance.differentiation", lambda law: law.provenance.differentiation),
    "draws": ("sample(n)", lambda law: lambda count=1000, *rest, **named: law.sample(count, *rest, **named)),
    "each_other": ("uncertainty.map_other_laws", lambda law: law.uncertainty.map_other_laws),
    "evaluate": ("rhs(name, values)", lambda law: law.rhs),
    "explanation": ("uncertainty.explanation", lambda law: law.uncertainty.explanation),
    "has_std": ("uncertainty.has_std", lambda law: law.uncertainty.has_std),
    "inclusion_probabilities": (
        "uncertainty.inclusion_probabilities",
        lambda law: law.uncertainty.inclusion_probabilities,
    ),
    "interval_ends": ("coefficient_intervals(level)", lambda law: law.coefficient_intervals),
    "intervals": (
        "conf_int(level)",
        lambda law: lambda level=0.95, averaged=True: _intervals(law, level, averaged),
    ),
    "letter_interval_ends": ("parameter_intervals(level)", lambda law: law.parameter_intervals),
    "letter_units": ("parameters.units", lambda law: lambda: law.parameters.units),
    "letter_values": (
        "parameters.values and parameters.errors",
        lambda law: lambda: (law.parameters.values, law.parameters.errors),
    ),
    "letters": ("parameters.names", lambda law: law.parameters.names),
    "named_coefficients": ("parameters.definitions", lambda law: law.parameters.definitions),
    "named_products": ("parameters.products", lambda law: law.parameters.products),
    "other_laws": ("models[1:]", lambda law: law.uncertainty.other_laws),
    "outcomes": ("diagnostics", lambda law: law.diagnostics),
    "partial_pooling": ("pool()", lambda law: law.pool),
    "plausible": ("models", lambda law: law.models),
    "verdict": ("assess(trials)", lambda law: law.assess),
    "with_discrepancy": ("provenance.with_discrepancy", lambda law: law.provenance.with_discrepancy),
}
"""What each name is replaced by, and the function that still gives it."""


def deprecated_member(law: Any, name: str) -> Any:
    """Return a member of a law by its earlier name, with a `DeprecationWarning` that gives the present one.

    Raises
    ------
    AttributeError
        If there never was such a member.
    """
    if name not in DEPRECATED:
        raise AttributeError(f"'Law' object has no attribute {name!r}", name=name, obj=law)
    instead, value = DEPRECATED[name]
    _warn(f"Law.{name}", f"Law.{instead}", stacklevel=3)
    return value(law)


class Structure(tuple[str, ...]):
    """The equations of a law with names for its parameters; calling it is deprecated."""

    __slots__ = ()

    if not TYPE_CHECKING:

        def __call__(self) -> "Structure":
            _warn("Law.structure()", "Law.structure", stacklevel=2)
            return self


def _warn(name: str, instead: str, stacklevel: int) -> None:
    warnings.warn(f"{name} is deprecated; use {instead}", DeprecationWarning, stacklevel=stacklevel + 1)


def _candidates(law: Any) -> "pd.DataFrame":
    from commonlaw.law.tables import candidate_frame

    return candidate_frame(law.provenance.alternatives)


def _intervals(law: Any, level: float, averaged: bool) -> "pd.DataFrame":
    from commonlaw.law.tables import interval_frame

    return interval_frame(law, level, averaged)
