"""Laws that follow states by their logarithms."""

from collections.abc import Sequence
from dataclasses import replace

from commonlaw.law.law import Law
from commonlaw.library import Terms
from commonlaw.likelihood import NO_ERRORS
from commonlaw.trials.headers import find_name


def on_log_scale(law: Law, states: Sequence[str]) -> Law:
    """Return a law with these states, and no others, on a logarithmic scale.

    Its equations are the same. Forecasts follow the logarithms of these states, so that they and their bands stay
    above zero, and errors of measurement are shares of the state. As they mean something else then, what is known of
    them goes if the scale changes.

    Raises
    ------
    CommonlawError
        If the law is not of order 1, or has no such state.
    """
    names = tuple(dict.fromkeys(find_name(name, law.states, "state") for name in states))
    if names == law.schema.logarithmic:
        return law
    return replace(
        law,
        schema=replace(law.schema, logarithmic=names),
        terms=Terms(replace(law.terms.variables, logarithmic=names), law.terms.terms),
        uncertainty=replace(law.uncertainty, noise=None, error_model=NO_ERRORS, other_laws=()),
    )
