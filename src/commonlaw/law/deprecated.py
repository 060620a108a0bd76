"""Names of members of earlier versions: deprecated, for one release."""

import warnings
from collections.abc import Callable
from functools import partial
from operator import attrgetter
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any


def _by_function(function: str) -> Callable[[Any], Any]:
    return lambda law: resolve_name(f"commonlaw.law.{function}")(law)


def _by_method(function: str) -> Callable[[Any], Any]:
    return lambda law: partial(resolve_name(f"commonlaw.law.{function}"), law)


def _by_parameters(value: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda law: value(resolve_name("commonlaw.law.parameters:named_parameters")(law))


DEPRECATED: dict[str, str | tuple[str, Callable[[Any], Any]]] = {
    "adapt": "update(trials)",
    "alternatives": "provenance.alternatives",
    "average": "commonlaw.law.average_law(law)",
    "bounds": "commonlaw.bounds(law, trials)",
    "candidates": (
        "comparison",
        lambda law: partial(resolve_name("commonlaw.law.tables:candidate_frame"), law.provenance.alternatives),
    ),
    "coefficient_intervals": ("conf_int(level)", _by_method("parameters:coefficient_intervals")),
    "coefficient_units": ("params", _by_method("parameters:coefficient_units")),
    "coefficients_of": (
        "commonlaw.law.select_objects(law, [name]).coefficients",
        lambda law: lambda name: resolve_name("commonlaw.law:select_objects")(law, [name]).coefficients[0],
    ),
    "covariance": "uncertainty.covariance",
    "differentiation": "provenance.differentiation",
    "domain": (
        "provenance.domain.to_frame(units)",
        lambda law: partial(law.provenance.domain.to_frame, law.schema.units),
    ),
    "draws": ("sample(n)", lambda law: lambda count=1000, *rest, **named: law.sample(count, *rest, **named)),
    "each_other": "uncertainty.map_other_laws",
    "evaluate": "rhs(name, values)",
    "explanation": "uncertainty.explanation",
    "export": "save(path)",
    "from_json": "commonlaw.law.from_json(text)",
    "has_std": "uncertainty.has_std",
    "inclusion_probabilities": "uncertainty.inclusion_probabilities",
    "index": ("objects.index(name)", _by_method("law:object_index")),
    "interval_ends": ("conf_int(level)", _by_method("parameters:coefficient_intervals")),
    "intervals": ("conf_int(level)", _by_method("tables:interval_frame")),
    "latex_structure": ("commonlaw.law.to_latex(law)", _by_method("printing:latex_structure")),
    "left_hand_sides": ("structure", _by_function("parameters:left_hand_sides")),
    "letter_interval_ends": ("conf_int(level)", _by_parameters(lambda parameters: parameters.intervals)),
    "letter_units": ("params", _by_parameters(lambda parameters: lambda: parameters.units)),
    "letter_values": ("params", _by_parameters(lambda parameters: lambda: (parameters.values, parameters.errors))),
    "letters": ("params", _by_parameters(lambda parameters: parameters.names)),
    "named_coefficients": ("params", _by_parameters(lambda parameters: parameters.definitions)),
    "named_products": ("structure", _by_parameters(lambda parameters: parameters.products)),
    "noise": "uncertainty.noise",
    "other_laws": ("models[1:]", lambda law: law.uncertainty.other_laws),
    "outcomes": "diagnostics",
    "parameter_intervals": ("conf_int(level)", _by_parameters(lambda parameters: parameters.intervals)),
    "parameters": ("params", _by_function("parameters:named_parameters")),
    "partial_pooling": "commonlaw.law.pool_objects(law)",
    "path": "provenance.path()",
    "plausible": "models",
    "pool": "commonlaw.law.pool_objects(law)",
    "rates": ("terms.variables.states", _by_function("parameters:rate_names")),
    "relations": "commonlaw.law.relations_frame(law)",
    "select": "commonlaw.law.select_objects(law, objects)",
    "shared": ("support", _by_function("law:shares_terms")),
    "standard_errors": ("params", _by_function("parameters:standard_errors")),
    "state_rates": ("terms.variables.states", _by_function("parameters:state_rates")),
    "states": "schema.states",
    "to_frame": "commonlaw.law.to_frame(law)",
    "to_json": "commonlaw.law.to_json(law)",
    "to_latex": "commonlaw.law.to_latex(law)",
    "to_script": "commonlaw.law.to_script(law, path)",
    "to_sympy": "commonlaw.law.to_sympy(law)",
    "vector_field": ("rhs(name, values)", _by_method("parameters:vector_field")),
    "verdict": "assess(trials)",
    "with_discrepancy": "provenance.with_discrepancy",
    "with_others": ("uncertainty", _by_method("law:with_other_laws")),
}
"""What each name is replaced by, and what gives its value where that is not what the present name gives."""


def deprecated_member(law: Any, name: str) -> Any:
    """Return a member of a law by its earlier name, with a `DeprecationWarning` that gives the present one."""
    if name not in DEPRECATED:
        raise AttributeError(f"'Law' object has no attribute {name!r}", name=name, obj=law)
    now = DEPRECATED[name]
    instead, value = now if isinstance(now, tuple) else (now, None)
    member, _, arguments = instead.partition("(")
    is_function = member.startswith("commonlaw.")
    warn_deprecated(f"Law.{name}", instead if is_function else f"Law.{instead}", stacklevel=3)
    if value is not None:
        return value(law)
    if not is_function:
        return attrgetter(member)(law)
    return partial(resolve_name(member), law) if arguments.startswith("law") else resolve_name(member)


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
