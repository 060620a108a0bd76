"""Names of members of earlier versions: deprecated, for one release."""

import warnings
from collections.abc import Callable
from functools import partial
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any


def _value(function: str) -> Callable[[Any], Any]:
    """Return what gives a property by a function of laws."""
    return lambda law: resolve_name(f"commonlaw.law.{function}")(law)


def _method(function: str) -> Callable[[Any], Any]:
    """Return what gives a method by a function of laws and arguments."""
    return lambda law: partial(resolve_name(f"commonlaw.law.{function}"), law)


def _parameters(law: Any) -> Any:
    return resolve_name("commonlaw.law.parameters:named_parameters")(law)


DEPRECATED: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "adapt": ("update(trials)", lambda law: law.update),
    "alternatives": ("provenance.alternatives", lambda law: law.provenance.alternatives),
    "average": ("commonlaw.law.average_law(law)", _method("objects:average_law")),
    "bounds": ("commonlaw.bounds(law, trials)", lambda law: partial(resolve_name("commonlaw.inference:bounds"), law)),
    "candidates": (
        "comparison",
        lambda law: partial(resolve_name("commonlaw.law.tables:candidate_frame"), law.provenance.alternatives),
    ),
    "coefficient_intervals": ("conf_int(level)", _method("parameters:coefficient_intervals")),
    "coefficient_units": ("params", _method("parameters:coefficient_units")),
    "coefficients_of": (
        "commonlaw.law.select_objects(law, [name]).coefficients",
        lambda law: lambda name: resolve_name("commonlaw.law:select_objects")(law, [name]).coefficients[0],
    ),
    "covariance": ("uncertainty.covariance", lambda law: law.uncertainty.covariance),
    "differentiation": ("provenance.differentiation", lambda law: law.provenance.differentiation),
    "domain": (
        "provenance.domain.to_frame(units)",
        lambda law: partial(law.provenance.domain.to_frame, law.schema.units),
    ),
    "draws": ("sample(n)", lambda law: lambda count=1000, *rest, **named: law.sample(count, *rest, **named)),
    "each_other": ("uncertainty.map_other_laws", lambda law: law.uncertainty.map_other_laws),
    "evaluate": ("rhs(name, values)", lambda law: law.rhs),
    "explanation": ("uncertainty.explanation", lambda law: law.uncertainty.explanation),
    "export": ("save(path)", lambda law: law.save),
    "from_json": ("commonlaw.law.from_json(text)", lambda _: resolve_name("commonlaw.law:from_json")),
    "has_std": ("uncertainty.has_std", lambda law: law.uncertainty.has_std),
    "history": ("provenance.history", lambda law: law.provenance.history),
    "inclusion_probabilities": (
        "uncertainty.inclusion_probabilities",
        lambda law: law.uncertainty.inclusion_probabilities,
    ),
    "index": ("objects.index(name)", _method("law:object_index")),
    "interval_ends": ("conf_int(level)", _method("parameters:coefficient_intervals")),
    "intervals": ("conf_int(level)", _method("tables:interval_frame")),
    "latex_structure": ("commonlaw.law.to_latex(law)", _method("printing:latex_structure")),
    "left_hand_sides": ("structure", _value("parameters:left_hand_sides")),
    "letter_interval_ends": ("conf_int(level)", lambda law: _parameters(law).intervals),
    "letter_units": ("params", lambda law: lambda: _parameters(law).units),
    "letter_values": ("params", lambda law: lambda: (_parameters(law).values, _parameters(law).errors)),
    "letters": ("params", lambda law: _parameters(law).names),
    "named_coefficients": ("params", lambda law: _parameters(law).definitions),
    "named_products": ("structure", lambda law: _parameters(law).products),
    "noise": ("uncertainty.noise", lambda law: law.uncertainty.noise),
    "other_laws": ("models[1:]", lambda law: law.uncertainty.other_laws),
    "outcomes": ("diagnostics", lambda law: law.diagnostics),
    "parameter_intervals": ("conf_int(level)", lambda law: _parameters(law).intervals),
    "parameters": ("params", _parameters),
    "partial_pooling": ("commonlaw.law.pool_objects(law)", _method("pooling:pool_objects")),
    "path": ("provenance.path()", lambda law: law.provenance.path),
    "plausible": ("models", lambda law: law.models),
    "pool": ("commonlaw.law.pool_objects(law)", _method("pooling:pool_objects")),
    "rates": ("terms.variables.states", _value("parameters:rate_names")),
    "relations": ("commonlaw.law.relations_frame(law)", _method("printing:relations_frame")),
    "score": (
        "predict(trials).metric(metric)",
        lambda law: lambda trials, metric="r2", *, start=None: law.predict(trials, start=start).metric(metric),
    ),
    "select": ("commonlaw.law.select_objects(law, objects)", _method("objects:select_objects")),
    "shared": ("support", _value("law:shares_terms")),
    "standard_errors": ("params", _value("parameters:standard_errors")),
    "state_rates": ("terms.variables.states", _value("parameters:state_rates")),
    "states": ("schema.states", lambda law: law.schema.states),
    "to_frame": ("commonlaw.law.to_frame(law)", _method("tables:to_frame")),
    "to_json": ("commonlaw.law.to_json(law)", _method("io:to_json")),
    "to_latex": ("commonlaw.law.to_latex(law)", _method("printing:to_latex")),
    "to_script": ("commonlaw.law.to_script(law, path)", _method("script:to_script")),
    "to_sympy": ("commonlaw.law.to_sympy(law)", _method("printing:to_sympy")),
    "vector_field": ("rhs(name, values)", _method("parameters:vector_field")),
    "verdict": ("assess(trials)", lambda law: law.assess),
    "with_discrepancy": ("provenance.with_discrepancy", lambda law: law.provenance.with_discrepancy),
    "with_others": ("uncertainty", _method("law:with_other_laws")),
}
"""What each name is replaced by, and the function that still gives it."""


def deprecated_member(law: Any, name: str) -> Any:
    """Return a member of a law by its earlier name, with a `DeprecationWarning` that gives the present one."""
    if name not in DEPRECATED:
        raise AttributeError(f"'Law' object has no attribute {name!r}", name=name, obj=law)
    instead, value = DEPRECATED[name]
    warn_deprecated(f"Law.{name}", instead if instead.startswith("commonlaw.") else f"Law.{instead}", stacklevel=3)
    return value(law)


class DeprecatedClassMembers(type):
    """The class of `Law`, which gives `Law.from_json` by its earlier name."""

    if not TYPE_CHECKING:

        def __getattr__(cls, name: str) -> Any:
            if name != "from_json":
                raise AttributeError(f"type object 'Law' has no attribute {name!r}", name=name, obj=cls)
            return deprecated_member(cls, name)


class Structure(tuple[str, ...]):
    """The equations of a law with names for its parameters; calling it is deprecated."""

    __slots__ = ()

    if not TYPE_CHECKING:

        def __call__(self) -> "Structure":
            warn_deprecated("Law.structure()", "Law.structure", stacklevel=2)
            return self


def renamed(of: str, until_now: str, now: str) -> property:
    """Return a property that gives an attribute of a class by its earlier name."""

    def value(instance: Any) -> Any:
        warn_deprecated(f"{of}.{until_now}", f"{of}.{now}", stacklevel=2)
        return getattr(instance, now)

    return property(value, doc=f"Deprecated name of `{now}`.")


def warn_deprecated(name: str, instead: str, stacklevel: int) -> None:
    """Warn that a name is deprecated, at the line so many calls above."""
    warnings.warn(f"{name} is deprecated; use {instead}", DeprecationWarning, stacklevel=stacklevel + 1)
