"""What goes with states on a logarithmic scale, and what does not."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, get_args

from commonlaw.errors import CommonlawError
from commonlaw.law import Law
from commonlaw.library import Terms
from commonlaw.likelihood import NO_ERRORS, ErrorKind
from commonlaw.trials import Schema
from commonlaw.trials.headers import find_name


def error_kinds(errors: ErrorKind | Literal["auto"], schema: Schema) -> tuple[ErrorKind, ...]:
    """Return the kinds of errors that are compared for trials of a schema.

    Raises
    ------
    CommonlawError
        If noise is to grow with the logarithm of a state.
    """
    if errors == "proportional" and schema.logarithmic:
        raise CommonlawError("log-states-with-errors", states=schema.logarithmic)
    kinds: tuple[ErrorKind, ...] = get_args(ErrorKind) if errors == "auto" else (errors,)
    return tuple(each for each in kinds if each != "proportional" or not schema.logarithmic)


def check_one_scale(laws: Sequence[Law]) -> None:
    """Refuse to compare laws that follow states on different scales."""
    scales = [", ".join(law.schema.logarithmic) or "none" for law in laws]
    if len(set(scales)) > 1:
        raise CommonlawError("log-states-differ", scales=dict.fromkeys(scales))


def on_log_scale(law: Law, states: Sequence[str]) -> Law:
    """Return a law with these states, and no others, on a logarithmic scale.

    Its equations are the same. Forecasts follow the logarithms of these states, so that they and their bands stay
    above zero, and errors of measurement are shares of the state. As they mean something else then, what is known of
    them goes if the scale changes.

    Raises
    ------
    CommonlawError
        If the law is not of order 1, or has no such state, or nobody measured it.
    """
    names = tuple(dict.fromkeys(find_name(name, law.states, "state") for name in states))
    if unmeasured := [name for name in names if name in law.schema.starts]:
        raise CommonlawError("log-states-latent", state=unmeasured[0])
    if names == law.schema.logarithmic:
        return law
    return replace(
        law,
        schema=replace(law.schema, logarithmic=names),
        terms=Terms(replace(law.terms.variables, logarithmic=names), law.terms.terms),
        uncertainty=replace(law.uncertainty, noise=None, error_model=NO_ERRORS, other_laws=()),
    )
