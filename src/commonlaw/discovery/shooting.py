"""Given equations that are fitted by shooting."""

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from commonlaw.diagnostics import note
from commonlaw.discovery.hints import law_under_errors, outcomes_of_inputs, outcomes_of_units
from commonlaw.discovery.known_physics import unfitted
from commonlaw.discovery.regression import suitable_differentiation
from commonlaw.discovery.request import FitRequest
from commonlaw.errors import CommonlawError
from commonlaw.estimation.beginning import Beginning, begin, with_values_of
from commonlaw.estimation.fitting import Fitted, checked_errors, limited, maximized, refused_settings, threshold_of
from commonlaw.estimation.model import ModelText
from commonlaw.estimation.search import DRAWS, is_solved
from commonlaw.inference.propose.nonlinear_parameters import outcomes_of_parameters, with_initial_parameters
from commonlaw.inference.search.error_models import outcomes_of_departures, under_likeliest_errors
from commonlaw.inference.search.setup import RefitOptions, possible_interpolations, supported_interpolation
from commonlaw.inference.settings import STRONG
from commonlaw.inference.verbs.collocation import collocated
from commonlaw.law import Law, Provenance, Step
from commonlaw.law.parameters import named_parameters
from commonlaw.law.parse import read_equations
from commonlaw.law.restrictions import Restrictions
from commonlaw.library.equation import split_equations
from commonlaw.runtime.progress import on_terminal
from commonlaw.trials import Trials
from commonlaw.trials.transformations import (
    objects_at_rest,
    outcome_of_rest,
    outcome_of_undosed,
    without_objects,
)
from commonlaw.trials.trial import property_names


def by_shooting(request: FitRequest, reason: str, resting: tuple[str, ...] = ()) -> Law:
    """Return the law of a request; without objects at rest, where these do not determine a parameter."""
    if request.functions:
        raise CommonlawError("function-with-observation", function=request.functions[0].text)
    if (refused := refused_settings(request.changed)) and not request.beyond_collocation:
        settings = [f"{name}={request.changed[name]!r}" for name in refused]
        is_asked = request.scheme == "shooting"
        why, omitted = "`scheme='shooting'`" if is_asked else reason, [*refused, *["the scheme"] * is_asked]
        raise CommonlawError("beyond-shooting", settings=settings, reason=why, omitted=omitted)
    moving = without_objects(request.dosed, resting)
    try:
        law = _of_model(request, moving)
    except CommonlawError as error:
        others = objects_at_rest(moving)
        if error.code != "parameters-not-identified" or not others:
            raise
        return by_shooting(request, reason, others)
    outcomes = (*law.diagnostics, *outcome_of_undosed(request.undosed), *outcome_of_rest(resting))
    domain, history = replace(law.provenance.domain, at_rest=resting), list(law.history)
    history.insert(1, Step("scheme", "shooting", reason))
    if checked_errors(request.changed) is None and not law.uncertainty.error_model:
        why = "by default: no evidence for noise that grows with states or differs between objects; "
        why += "autocorrelated errors are taken by name"
        history.insert(2, Step("errors", "white noise", why))
    rates = suitable_differentiation(moving, law.order)
    provenance = replace(
        law.provenance, differentiation=rates, outcomes=outcomes, domain=domain, history=tuple(history)
    )
    return replace(law, provenance=provenance)


def _of_model(request: FitRequest, trials: Trials) -> Law:
    """Return the law of all trials, under the interpolation of inputs of largest likelihood."""
    settings = request.changed
    errors = checked_errors(settings)
    between = settings.get("input_interpolation") or ("linear" if trials.schema.doses else "auto")
    if between != "auto" or not any(np.ptp(trial.inputs, axis=0).any() for trial in trials):
        tried = [between.replace("auto", trials.schema.input_interpolation)]
    else:
        supported = supported_interpolation(trials)
        tried = [supported, *(between for between in possible_interpolations(trials) if between != supported)]
    noise, log_states = settings.get("noise"), settings.get("log_states") or ()
    search = partial(maximized, seed=settings.get("seed", 0), progress=settings.get("progress") or on_terminal())
    begins, fits = list[Beginning](), list[Fitted]()
    for interpolation in tried:
        interpolated = replace(trials, schema=replace(trials.schema, input_interpolation=interpolation))
        begun = begin(
            request.text,
            interpolated,
            request.initial_values,
            request.at,
            request.groups,
            request.guesses,
            request.priors,
            log_states=log_states,
            noise=noise,
            errors=errors or "white",
        )
        begun = replace(begun, huber_threshold=threshold_of(settings))
        if fits:
            begun = _near(begun, fits[0])
        elif not request.guesses and (law := _by_collocation(request.text, interpolated, settings)):
            begun = with_values_of(law, begun)
        # Maxima of interpolations lie close to each other
        fitted = search(begun, draws=1 if fits and is_solved(begun.problem, begun.first) else DRAWS)
        begins.append(begun)
        # Refused before others are tried
        fits.append(fitted if fits else limited(fitted))
    likelihoods = np.array([fitted.optimum.log_likelihood for fitted in fits])
    gains = 2 * (likelihoods - likelihoods[0])
    best = int(np.argmax(gains)) if max(gains) > STRONG else 0
    chosen = limited(search(_near(begins[best], fits[best]))) if best else fits[best]
    white, chosen = chosen, chosen if errors else under_likeliest_errors(chosen)
    law = law_under_errors(chosen, white, request.calls)
    departures = outcomes_of_departures(chosen, tried_errors=errors is None)
    outcomes = [
        *law.provenance.outcomes,
        *departures,
        *outcomes_of_parameters(law),
        *outcomes_of_units(law, trials),
    ]
    outcomes += outcomes_of_inputs(law, trials)
    if len(tried) == 1:
        return replace(law, provenance=replace(law.provenance, outcomes=tuple(outcomes)))
    plausible = np.flatnonzero(gains > gains[best] - STRONG).tolist()
    why = f"between samples; the inputs support {tried[0]}; twice the log-likelihood ratio to it is {gains[best]:.3g}"
    history = (*law.history, Step("inputs", tried[best], why))
    # Dead times that depend on how inputs go between samples, where measurements do not decide it
    named = named_parameters(law)
    for name in dict.fromkeys(name for signal in law.schema.inputs for name in re.findall(r"\(t - (\w+)\)$", signal)):
        at, differ = named.names.index(name), np.ptp(named.values[:, named.names.index(name)]) > 0
        for o, owner in enumerate(law.objects if differ else law.objects[:1]):
            value, error = named.values[o, at], named.errors[o, at]
            delays = {tried[i]: float(fits[i].values(owner)[name]) for i in plausible if i != best}
            if apart := [
                f"{delay:.4g} ({interpolation})"
                for interpolation, delay in delays.items()
                if abs(delay - value) > 2 * error
            ]:
                where = owner if differ else ""
                outcomes.append(
                    note("delay-by-interpolation", where, name=name, value=value, between=tried[best], others=apart)
                )
    return replace(law, provenance=replace(law.provenance, history=history, outcomes=tuple(outcomes)))


def _near(begun: Beginning, fitted: Fitted) -> Beginning:
    """Return a beginning whose first values are the estimates of a fit, but for those that are zero."""
    near, likely = fitted.optimum.unknowns, begun.first if begun.likely is None else begun.likely
    return replace(begun, first=np.where(near != 0, near, begun.first), likely=likely)


def _by_collocation(text: ModelText, trials: Trials, settings: Mapping[str, Any]) -> Law | None:
    """Return the law of the same equations by collocation, where the fit of the model begins.

    None of models with latent states, observation equations, events, jumps, delays or doses, and where it does not
    fit each object by itself.
    """
    states = {equation.state for equation in split_equations(text.equations)}
    if states != {*trials.schema.states} or trials.schema.doses or replace(text, initial={}).beyond_equations:
        return None
    try:
        given = read_equations(text.equations, trials.schema, properties=property_names(trials.properties))
        provenance = Provenance(suitable_differentiation(trials, given.order), equations=given.texts)
        start = unfitted(given, trials, provenance, Restrictions())
        between = trials.schema.input_interpolation
        options = RefitOptions(log_states=settings.get("log_states"))
        inside = {coefficient.name for coefficient in given.coefficients}  # Others are in initial values alone
        bounds = [bound for bound in text.bounds if bound.name in inside]
        begun = with_initial_parameters(start, trials, options, bounds)
        return collocated(begun, trials, replace(options, input_interpolation=between))
    except CommonlawError:
        return None
