"""A law that somebody has in mind: exactly these terms, coefficients found in trials."""

import inspect
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Concatenate, ParamSpec

import numpy as np

from commonlaw.discovery.derivative_regression import suitable_differentiation
from commonlaw.discovery.discrete_time_regression import DiscreteTimeRegression
from commonlaw.discovery.model_structure import Known, ModelStructure
from commonlaw.errors import CommonlawError
from commonlaw.inference import refine
from commonlaw.law import Law, Provenance, Step, Uncertainty
from commonlaw.law.from_text import GivenEquations, read_equations
from commonlaw.law.script import call
from commonlaw.library import ExpressionLibrary
from commonlaw.outcomes import OutcomeKind
from commonlaw.progress import on_terminal
from commonlaw.solvers import STLSQ
from commonlaw.trials import Trials

P = ParamSpec("P")


def _with_settings_of(
    refinement: Callable[Concatenate[Law, Trials, P], Law],
) -> Callable[[Callable[..., Law]], Callable[Concatenate[str | Sequence[str], Trials, P], Law]]:
    """Give a function of equations and trials the settings of a refinement, so that they are listed in one place."""

    def decorate(function: Callable[..., Law]) -> Callable[Concatenate[str | Sequence[str], Trials, P], Law]:
        own = list(inspect.signature(function).parameters.values())[:2]
        settings = list(inspect.signature(refinement).parameters.values())[2:]
        vars(function)["__signature__"] = inspect.Signature([*own, *settings], return_annotation=Law)
        return function

    return decorate


@_with_settings_of(refine)
def fit(equations: str | Sequence[str], trials: Trials, **settings: Any) -> Law:
    """Fit a law that you have in mind: exactly these terms, their coefficients found in trials.

    The way is that of `refine`, maximum likelihood of whole trajectories; laws in discrete time, which have none, are
    fitted to the next samples by least squares and take no settings.

    Parameters
    ----------
    equations
        One for each state, in one text between semicolons or in several, see `Law.from_text`. Coefficients are found,
        numbers are known and stay: ``"x'' = -9.81 - c v"``; v is the rate of x, as is ``x'``.
    trials
        What was measured. Each object has its own coefficients.
    positive, input_between, noise, errors, huber_threshold, covariance, partial_pooling, seed, progress
        See `refine`.

    Raises
    ------
    CommonlawError
        If the text cannot be read, the message says at which character and lists the variables; or if the trials cannot
        be used as they are.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(noise=0.0)
    >>> print(cl.fit("x'' = -g - c v", drops).average())
    x'' = -9.80000 ± 0.00096 - (0.380000 ± 0.000086) v
    <BLANKLINE>
    with v = x', g = 9.80000 ± 0.00096, c = 0.380000 ± 0.000086
    """
    given = read_equations(equations, trials.schema)
    history = (Step("equations", "; ".join(given.texts), "as given"),)
    calls = (call(refine, settings, "cl.fit", repr("; ".join(given.texts)), "trials"),)
    if given.order == 0:
        law = _next_samples(given, trials, settings)
        # Of what a search says, only this concerns terms that were given
        outcomes = tuple(each for each in law.outcomes if each.kind is OutcomeKind.ILL_CONDITIONED)
        made = Provenance(None, outcomes, history=history, equations=given.texts, calls=calls)
        return replace(law, provenance=made)
    provenance = Provenance(suitable_differentiation(trials, given.order), history=history, equations=given.texts)
    law = refine(_unfitted(given, trials, provenance), trials, **({"input_between": "auto"} | settings))
    return replace(law, provenance=replace(law.provenance, calls=calls))


def _unfitted(given: GivenEquations, trials: Trials, provenance: Provenance) -> Law:
    """Return the law of given equations; coefficients that are to be found are 1, and only they have an error."""
    free = np.isnan(given.known)
    first = np.where(free, 1.0, given.known)
    errors = np.diag(free[first != 0].astype(np.float64))
    objects = trials.objects
    coefficients, covariance = (np.tile(each, (len(objects), 1, 1)) for each in (first, errors))
    return Law(
        given.terms, trials.schema, given.order, objects, coefficients, Uncertainty(covariance), provenance=provenance
    )


def _next_samples(given: GivenEquations, trials: Trials, settings: dict[str, Any]) -> Law:
    """Return the law in discrete time whose coefficients are those of least squares."""
    if set(settings) - {"progress"}:
        raise CommonlawError(
            f"a law in discrete time is fitted to the next samples, which takes no {', '.join(settings)}: leave it out"
        )
    names, terms = given.terms.variables.names, given.terms.terms
    library = ExpressionLibrary(*(each.expression(names) for each in terms))
    known: Known = {
        (trials.schema.states[j], given.terms.names[k]): float(given.known[j, k])
        for j, k in np.argwhere(~np.isnan(given.known)).tolist()
    }
    progress = settings.get("progress") or on_terminal()
    return DiscreteTimeRegression(solver=STLSQ(0.0)).find(trials, ModelStructure(0, library, known), progress)
