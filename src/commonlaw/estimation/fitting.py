"""Maximum-likelihood estimates of models, and the laws of these."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.diagnostics import Outcome, note
from commonlaw.differentiation.noise import noise_level
from commonlaw.errors import CommonlawError
from commonlaw.estimation.beginning import Beginning, NoiseGiven, beginning_of
from commonlaw.estimation.interchange import EqualMaximum, latent_states, with_fastest_latent_states
from commonlaw.estimation.one_sided import MAX_PROFILES, VAGUE, OneSided, moments_along, one_sided
from commonlaw.estimation.problem import NormalPrior, Problem
from commonlaw.estimation.search import (
    DRAWS,
    EVENT_SHARES,
    GROWING_SHARES,
    LACK_OF_FIT,
    REACH,
    Optimum,
    confounded,
    is_solved,
    maximize,
    summarized,
    under_errors,
    with_step_limit,
    without_outliers,
)
from commonlaw.formulation import column_scales
from commonlaw.law import Law, Misfit, Provenance, Step, Uncertainty
from commonlaw.law.alignment import matched, matched_noise
from commonlaw.law.law import object_index
from commonlaw.law.objects import of_all_objects
from commonlaw.law.observation import Observation, TrialEstimate, TrialEstimates
from commonlaw.law.parameters import named_parameters, restrictions_of
from commonlaw.law.parse import Product, read_equations
from commonlaw.law.provenance import Domain, error_steps
from commonlaw.law.restrictions import OBJECT, by_trial
from commonlaw.law.text import with_error
from commonlaw.law.uncertainty import AtBound, OneSidedLimit
from commonlaw.library import Term, Terms, with_rates
from commonlaw.library.bounds import NEAR_BOUND
from commonlaw.likelihood import ERRORS
from commonlaw.likelihood.linearization import HETEROGENEITY_LEVEL, heterogeneity_p_value
from commonlaw.likelihood.observation_model import HUBER_THRESHOLD
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.runtime.forking import cached_property
from commonlaw.runtime.progress import ProgressCallback
from commonlaw.text import counted, shown
from commonlaw.trials import Trials
from commonlaw.trials.transformations import with_logarithms
from commonlaw.trials.trial import property_names

_SETTINGS = ("log_states", "input_interpolation", "noise", "errors", "huber_threshold", "seed", "n_jobs", "progress")
"""Settings of fits that may be made here."""
_OF_ESTIMATES = ("estimate-at-bound", "one-sided-limit")
"""Notes on estimates, which new trials decide anew."""
OF_FIT = (
    *_OF_ESTIMATES,
    "dead-time-at-bound-of-misfit",
    "latent-state-ambiguous",
    "parameters-without-limits",
    "residuals-exceed-noise",
    "starts-in-steady-state",
    "trials-differ",
)
"""Notes on a fit, which another one decides anew."""


def checked_errors(changed: Mapping[str, Any]) -> ErrorKind | None:
    """Return the error model that is asked for among changed settings; None by default.

    Settings of other fits than of trajectories under errors of measurements are refused.
    """
    errors: ErrorKind | Literal["auto"] = changed.get("errors", "auto")
    if errors != "auto" and ERRORS[errors].group == "law":
        raise CommonlawError("process-noise-with-observation", errors=errors)
    if refused := refused_settings(changed):
        raise CommonlawError("not-with-observation", settings=refused)
    return None if errors == "auto" else errors


def refused_settings(changed: Mapping[str, Any]) -> list[str]:
    """Return the changed settings of fits that shooting refuses."""
    errors = changed.get("errors", "auto")
    is_process_noise = errors != "auto" and ERRORS[errors].group == "law"
    return [name for name in changed if name not in _SETTINGS or (name == "errors" and is_process_noise)]


def threshold_of(changed: Mapping[str, Any]) -> float:
    """Return the Huber threshold of changed settings, which white noise by name does without."""
    return np.inf if changed.get("errors") == "white" else float(changed.get("huber_threshold", HUBER_THRESHOLD))


def refit(
    law: Law,
    trials: Trials,
    *,
    equations: Sequence[str] | None = None,
    inputs: Literal["same", "any"] = "same",
    noise: Mapping[str, float] | None = None,
    errors: ErrorKind | None = None,
    huber_threshold: float = HUBER_THRESHOLD,
    log_states: Sequence[str] | None = None,
    input_interpolation: str | None = None,
    seed: int = 0,
    progress: ProgressCallback,
) -> "Fitted":
    """Fit a law to trials, all parameters and initial values that it does not give anew; those it has are first values.

    Observation equations, given initial values and restrictions stay, but for noise of known standard deviation, and so
    do its equations where no other `equations` are given, and the kind of errors by default. A law without observation
    equations has parameters of each object. Only with `inputs` "any" may the trials have other inputs than the law.

    Raises
    ------
    CommonlawError
        If the objects do not share their equations, time is discrete, an object is not in the law, restrictions were
        not recorded, or the equations cannot be fitted to the trials.
    """
    levels = matched_noise(law, trials, noise)
    trials = matched(law, trials, inputs=inputs)
    groups = {name: by for name, by in restrictions_of(law).noise.items() if isinstance(by, str)}
    given_noise: dict[str, NoiseGiven] = {**groups, **(levels or {})}
    if errors is None:
        errors = "white" if law.uncertainty.error_model.of_law else law.uncertainty.error_model.kind
    begun = beginning_of(law, trials, given_noise, equations, log_states, input_interpolation, errors)
    return fit_model(replace(begun, huber_threshold=huber_threshold), seed, progress)


def updated(law: Law, trials: Trials) -> Law:
    """Return a law of known noise whose parameters were updated by trials of its objects, see `Law.update`.

    The parameters of the law, with their covariance, are the prior of the likelihood of the trials, under the errors of
    the law; those that had only a limit, or were at a bound, have none. Objects that share a parameter are updated
    together, others each by its own trials. What differs between trials, and initial values, has the priors of the
    law's fit. Terms of a library that the law does not have are left out.
    """
    known_noise, parts = law.uncertainty.noise, list[Law]()
    assert known_noise is not None
    noise: dict[str, NoiseGiven] = dict(zip(trials.schema.states, known_noise.tolist(), strict=True))
    noise |= law.uncertainty.noise_of
    known = np.any([trial.known_noise for trial in trials], axis=0)
    errors = law.uncertainty.error_model
    if errors.by_object:
        of_objects = {owner: errors.noise_of(owner, known_noise).tolist() for owner in trials.objects}
        noise |= {
            name: {owner: levels[j] for owner, levels in of_objects.items()}
            for j, name in enumerate(trials.schema.states)
        }
    levels = {name: noise[name] for name in np.array(trials.schema.states)[~known].tolist()}
    depend = any(by != OBJECT and not by_trial(by, trials.schema) for by in restrictions_of(law).shared.values())
    for owners in [trials.objects] if depend else [(owner,) for owner in trials.objects]:
        begun = beginning_of(law, trials.select(object=owners), levels, errors=law.uncertainty.error_model.kind)
        begun = replace(_with_prior(begun, law), huber_threshold=law.uncertainty.huber_threshold)
        parts.append(fit_model(begun, 0, lambda _: None).law(()))
    coefficients, covariance = of_all_objects(parts)
    likelihood = sum(known_log_likelihood(part) for part in parts)
    limits = tuple(limit for part in parts for limit in part.uncertainty.limits)
    pairs = [(part.objects[0] if len(parts) > 1 else "", part) for part in parts]
    noted = [replace(outcome, where=where) for where, part in pairs for outcome in part.provenance.outcomes]
    outcomes = *(outcome for outcome in law.diagnostics if outcome.code not in _OF_ESTIMATES), *noted
    return replace(
        law,
        objects=trials.objects,
        terms=parts[0].terms,
        coefficients=coefficients,
        uncertainty=Uncertainty(
            covariance=covariance,
            shared_factor=parts[0].uncertainty.shared_factor if len(parts) == 1 else None,
            noise=known_noise,
            noise_of=law.uncertainty.noise_of,
            error_model=law.uncertainty.error_model,
            huber_threshold=law.uncertainty.huber_threshold,
            degrees_of_freedom=law.uncertainty.degrees_of_freedom,
            limits=limits,
            at_bounds=tuple(estimate for part in parts for estimate in part.uncertainty.at_bounds),
            misfit=law.uncertainty.misfit,
        ),
        properties={owner: attribute for part in parts for owner, attribute in part.properties.items()},
        provenance=replace(
            law.provenance,
            equations=parts[0].provenance.equations,
            log_likelihood=likelihood,
            outcomes=tuple(dict.fromkeys(outcomes)),
        ),
        trial_estimates=TrialEstimates(estimate for part in parts for estimate in part.trial_estimates),
    )


def _with_prior(begun: Beginning, law: Law) -> Beginning:
    """Return a beginning under the errors of a law, whose parameters are the prior of its unknowns."""
    named, names, places = named_parameters(law), begun.unknowns.names, dict[int, tuple[int, int]]()
    differ = [by_trial(begun.restrictions.shared.get(name, OBJECT), begun.trials.schema) for name in names]
    for trial, indices in zip(begun.trials, begun.unknowns.parameters, strict=True):
        o = object_index(law, trial.object)
        for k in (k for k in indices if k >= 0 and names[k] in named.names and not differ[k]):
            p = named.names.index(names[k])
            if 0 < named.errors[o, p] < np.inf and not named.limited[o, p]:
                places.setdefault(k, (o, p))
    others = [prior for prior in begun.problem.priors if not {*prior.indices.tolist()} & {*places}]
    if places:
        mean = np.array([named.values[place] for place in places.values()])
        others.append(NormalPrior.joint([*places], mean, named.joint_covariance([*places.values()])))
    guessed = begun.guessed.copy()
    guessed[[*places]] = True
    problem = replace(begun.problem, errors=law.uncertainty.error_model, priors=tuple(others))
    return replace(begun, guessed=guessed, problem=problem)


def known_log_likelihood(law: Law) -> float:
    """Return the log-likelihood of the measurements that a law was fitted to."""
    assert law.provenance.log_likelihood is not None
    return law.provenance.log_likelihood


def fit_model(begun: Beginning, seed: int, progress: ProgressCallback, draws: int = DRAWS) -> "Fitted":
    """Return the maximum of the likelihood, see `maximized`, with the limits of parameters that have only one.

    Raises `CommonlawError` if the solution is finite from none of the first values, or the measurements do not
    determine all unknowns.
    """
    return limited(maximized(begun, seed, progress, draws))


def maximized(begun: Beginning, seed: int, progress: ProgressCallback, draws: int = DRAWS) -> "Fitted":
    """Return the maximum of the likelihood, from so many first values.

    Where first values are those of a fit, others are tried only if the maximum that these lead to has a lack of fit, or
    is near a bound, where there may be another one.

    Raises `CommonlawError` if the solution is finite from none of them.
    """
    begun = replace(begun, problem=with_step_limit(begun.problem, begun.first))
    search = partial(
        maximize, begun.problem, begun.first, begun.guessed, begun.bounds, None, seed, progress, likely=begun.likely
    )
    optimum, lack_of_fit = None, list[str]()
    if begun.likely is not None and draws > 1 and is_solved(begun.problem, begun.first):
        optimum = search(draws=1)
        lack_of_fit = _lack_of_fit(begun, optimum)
    if optimum is None or lack_of_fit or len(_lost(optimum)) or _is_near_bound(begun, optimum):
        optimum = search(draws=draws, shares=EVENT_SHARES if begun.problem.events_move and draws > 1 else (1.0,))
        lack_of_fit = _lack_of_fit(begun, optimum)
    if draws > 1 and lack_of_fit:
        optimum = max(
            optimum, search(draws=draws, shares=GROWING_SHARES), key=lambda candidate: candidate.log_likelihood
        )
        lack_of_fit = _lack_of_fit(begun, optimum)
    others = tuple[EqualMaximum, ...]()
    if draws > 1 and not len(_lost(optimum)):
        optimum, others = with_fastest_latent_states(begun.problem, optimum, begun.bounds)
    problem, threshold = begun.problem, begun.huber_threshold
    is_determined = not len(_lost(optimum)) and not len(_vague(begun, optimum))
    if np.isfinite(threshold) and not problem.censored.any() and is_determined:
        problem, optimum = without_outliers(problem, threshold, optimum, begun.first, begun.bounds)
    if problem is not begun.problem:
        begun = replace(begun, problem=problem)
        lack_of_fit = _lack_of_fit(begun, optimum)
    fitted = Fitted(begun, optimum, lack_of_fit, others)
    return fitted if begun.errors == "white" else fitted.under(begun.errors)


def limited(fitted: "Fitted") -> "Fitted":
    """Return a fit with the limits of parameters that have only one.

    Raises `CommonlawError` if the measurements do not determine all unknowns.
    """
    begun = fitted.begun
    optimum, limits = _with_limits(begun, fitted.optimum)
    vague, names = np.setdiff1d(_vague(begun, optimum), [*limits]), np.array(begun.unknowns.names)
    everywhere = [k for k in vague if np.isin(np.flatnonzero(names == names[k]), vague).all()]
    # Given a limit of one of them the others would have small errors
    together = confounded(begun.problem, fitted.optimum)
    together = together if np.setdiff1d(together, [*limits]).size else together[:0]
    if len(lost := np.unique([*_lost(optimum), *everywhere, *together]).astype(int)):
        raise CommonlawError("parameters-not-identified", names=[begun.unknowns.labels[i] for i in lost[:8]])
    return replace(fitted, optimum=optimum, limits=limits)


def _lost(optimum: Optimum) -> Indices:
    """Return the unknowns that the measurements do not determine, by index."""
    return np.flatnonzero(~np.isfinite(np.diagonal(optimum.covariance) + optimum.unknowns))


def _is_near_bound(begun: Beginning, optimum: Optimum) -> bool:
    """Return whether an unknown is within a few standard errors of a bound."""
    errors, bounds = np.sqrt(np.diagonal(optimum.covariance)), begun.bounds
    room = np.minimum(optimum.unknowns - bounds.low, bounds.high - optimum.unknowns)
    return bool(np.any(optimum.at_bound | (room < NEAR_BOUND * errors)))


def _vague(begun: Beginning, optimum: Optimum) -> Indices:
    """Return the unknowns whose standard errors exceed any likely value, by index."""
    errors = np.sqrt(np.diagonal(optimum.covariance))
    return np.flatnonzero(~begun.guessed & (errors > np.exp(REACH) * np.abs(begun.first)))


def _with_limits(begun: Beginning, optimum: Optimum) -> tuple[Optimum, dict[int, OneSided]]:
    """Return limits of the parameters that have only one, by index, and the optimum given those in the flat part.

    These are held there where standard errors, which are those of a parabola, exceed the estimates, but for those
    between a limit and a bound: with their profile as weights, covariances of others are those given these, plus second
    moments along it (law of total variance).
    """
    shared, schema, names = begun.restrictions.shared, begun.trials.schema, begun.unknowns.names
    bounded = set[int]()
    of_objects = {k for row in begun.unknowns.parameters for k in row if k >= 0}

    def vague(share: float) -> list[int]:
        errors = np.sqrt(np.diagonal(optimum.covariance))
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = np.where(optimum.at_bound, 0.0, errors / np.abs(optimum.unknowns))
        return [
            k
            for k in np.argsort(-relative, kind="stable").tolist()
            if relative[k] > share and k in of_objects and not by_trial(shared.get(names[k], OBJECT), schema)
        ]

    problem, limits, degrees = begun.problem, dict[int, OneSided](), float(np.min(optimum.degrees_of_freedom))
    for k in vague(VAGUE)[:MAX_PROFILES]:
        error = float(np.sqrt(optimum.covariance[k, k]))
        limit = one_sided(problem, optimum.unknowns, optimum.noise, begun.bounds, k, error, degrees)
        if limit is not None:
            limits[k] = limit
    for k, limit in limits.items():
        moments = moments_along(problem, optimum.unknowns, optimum.noise, begun.bounds, k, limit)
        covariance = optimum.covariance
        if moments is not None and 0 < covariance[k, k] < np.inf:
            given = covariance - np.outer(covariance[k], covariance[k]) / covariance[k, k]
            optimum, bounded = replace(optimum, covariance=given + moments), {*bounded, k}
    held, log_likelihood = list[int](), optimum.log_likelihood
    while beyond := [k for k in vague(1.0) if k in limits and k not in held and k not in bounded]:
        unknowns = optimum.unknowns if held else limits[beyond[0]].unknowns
        held.append(beyond[0])
        optimum = summarized(problem, unknowns, optimum.noise, begun.bounds, optimum.starts_alike, held)
    return replace(optimum, log_likelihood=max(log_likelihood, optimum.log_likelihood)), limits


def _lack_of_fit(begun: Beginning, optimum: Optimum) -> list[str]:
    """Return the quantities whose residuals exceed the noise by differences of neighbouring samples, with both.

    Residuals are three times as large, and more than a fiftieth of the standard deviation of the measurements. Under
    other errors than white noise, or noise that is known, neighbouring differences are those of standardized residuals.
    """
    listed, schema, problem, levels = list[str](), begun.trials.schema, begun.problem, _levels(begun.problem, optimum)
    apart = problem.known_noise | bool(problem.errors)
    parts = [*problem.standardized(optimum.unknowns, optimum.noise, False)] if apart.any() else []
    outliers = problem.outliers(optimum.unknowns, optimum.noise)
    for k, name in enumerate(problem.model.observables):
        if name in begun.logarithmic or name not in schema.states or name in schema.noise_columns:
            continue
        columns = [(trial.times, trial.states[:, schema.states.index(name)], np.False_) for trial in begun.trials]
        seen = _long(columns)
        if not seen:
            continue
        residual, least = float(levels[k]), 0.02 * float(np.std(np.concatenate([column for _, column in seen])))
        if apart[k]:
            pairs = zip(parts, outliers, strict=True)
            seen = _long([(part.trial.times, levels[k] * part.z[:, k], far[:, k]) for part, far in pairs])
        if problem.known_noise[k]:
            residual = float(np.sqrt(np.mean(np.concatenate([column for _, column in seen]) ** 2)))
        level = float(np.sqrt(np.mean([noise_level(times, column[:, np.newaxis]) ** 2 for times, column in seen])))
        if residual > max(LACK_OF_FIT * level, 0.0 if problem.errors else least):
            listed.append(f"{name}: {residual:.2g} (noise {level:.2g})")
    return listed


def _long(columns: Sequence[tuple[Floats, Floats, Bools | np.bool_]]) -> list[tuple[Floats, Floats]]:
    """Return the times and values of series that have twenty values or more, without their outliers."""
    return [
        (times[seen & ~outlying], values[seen & ~outlying])
        for times, values, outlying in columns
        if (seen := np.isfinite(values)).sum() >= 20
    ]


def _levels(problem: Problem, optimum: Optimum) -> Floats:
    """Return the noise of each observable; where each measurement has its own, the median."""
    levels = optimum.noise.copy()
    for k in np.flatnonzero(problem.known_noise):
        of_each = np.concatenate([(data.trial.std(levels) / data.trial.averaging)[:, k] for data in problem.trials])
        known = np.concatenate([np.isfinite(data.trial.noise[:, k]) for data in problem.trials])
        levels[k] = np.median(of_each[known])
    return levels


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model with its maximum-likelihood estimates and equal ones, and quantities whose residuals exceed the noise.

    Limits are those of unknowns that have only one, by index.
    """

    begun: Beginning
    optimum: Optimum
    lack_of_fit: Sequence[str]
    equal: Sequence[EqualMaximum] = ()
    limits: Mapping[int, OneSided] = field(default_factory=dict)

    def under(self, kind: ErrorKind) -> "Fitted":
        """Return the fit under errors of measurements, from this one under white noise."""
        problem, optimum = under_errors(self.begun.problem, kind, self.optimum, self.begun.bounds)
        begun = replace(self.begun, problem=problem, errors=problem.errors.kind)
        return replace(self, begun=begun, optimum=optimum, lack_of_fit=_lack_of_fit(begun, optimum))

    @property
    def parameters(self) -> int:
        """How many unknown parameters an object has, initial values apart."""
        trials = self.begun.trials
        rows = zip(trials, self.begun.unknowns.parameters, strict=True)
        return len({k for trial, indices in rows for k in indices if k >= 0 and trial.object == trials.objects[0]})

    def law(self, calls: tuple[str, ...]) -> Law:
        """Return the law, which records the calls."""
        begun, optimum = self.begun, self.optimum
        model, trials, problem, unknowns = begun.model, begun.trials, begun.problem, begun.unknowns
        groups = begun.groups
        of_objects = property_names(trials.properties)
        given = read_equations(model.text.equations, model.schema, properties=of_objects, determined=model.parameters)
        inside = {coefficient.name for coefficient in given.coefficients}
        extra = [name for name in model.parameters if name not in inside]
        variables = replace(given.terms.variables, parameters=(*given.terms.variables.parameters, *extra))
        extra_terms = tuple(Term(parameter=variables.index(name)) for name in extra)
        terms = Terms(variables, (*given.terms.terms, *extra_terms))
        products = (*given.products, *(Product(0, len(given.terms) + i, 1.0, ((n, 1),)) for i, n in enumerate(extra)))
        known = np.nan_to_num(np.pad(given.known, ((0, 0), (0, len(extra)))))
        coefficients = np.tile(known, (len(trials.objects), 1, 1))
        for owner, whole in zip(trials.objects, coefficients, strict=True):
            values = self.values(owner)
            for product in products:
                whole[product.equation, product.term] = float(product.value(values))
        support = np.any(coefficients != 0, axis=0)
        covariance, shared = self._covariance(products, support)
        noise = dict(zip(problem.model.observables, _levels(problem, optimum).tolist(), strict=True))
        noise_of = {
            name: {owner: noise[f"{name} of {group}"] for owner, group in group_of.items()}
            for name, group_of in groups.items()
        }
        freedom = dict(zip(problem.model.observables, optimum.degrees_of_freedom.tolist(), strict=True))
        freedom |= {
            name: min(freedom[f"{name} of {group}"] for group in group_of.values()) for name, group_of in groups.items()
        }
        noise = {name: noise.get(name) or float(np.median(list(noise_of[name].values()))) for name in model.observables}
        estimated_noise = [freedom[name] for name in trials.schema.states if freedom[name] < np.inf]
        degrees = [min(freedom[name], sum(estimated_noise)) for name in trials.schema.states]
        largest = [
            np.abs(problem.predicted(trial, optimum.unknowns, False).states).max(axis=0) for trial in problem.trials
        ]
        # A state may always be zero
        sizes = dict(zip(model.variables.states, np.maximum(np.max(largest, axis=0), 1e-300).tolist(), strict=True))
        errors = np.sqrt(np.diagonal(optimum.covariance))
        apart = [by_trial(begun.restrictions.shared.get(name, OBJECT), trials.schema) for name in model.parameters]
        estimated = TrialEstimates(
            TrialEstimate(trial.object, trial.name, unknowns.names[k], float(optimum.unknowns[k]), float(errors[k]))
            for trial, parameter, indices in zip(trials, unknowns.parameters, unknowns.initial, strict=True)
            for k in [*np.array(parameter, dtype=int)[apart].tolist(), *indices]
            if k >= 0
        )
        schema = replace(trials.schema, logarithmic=begun.logarithmic)
        observation = Observation(
            schema,
            dict(model.text.observed),
            dict(model.text.initial),
            begun.start,
            model.text.events,
            model.text.functions,
        )
        steps = (
            Step("equations", "; ".join(given.texts), "as given"),
            *(Step("observation", f"{name} = {right}", "as given") for name, right in model.text.observed.items()),
            *(
                Step("event" if ": " in line else "start" if "(0) = " in line else "parameters", line, "as given")
                for line in observation.lines(trials.objects, begun.restrictions.shared)[len(model.text.observed) :]
            ),
            *self._zeros_before_doses(),
            *self.steps,
        )
        states, second = model.schema.states, with_rates(model.order, len(model.schema.states)).tolist()
        rates = zip((states[j] for j in second), model.variables.states[len(states) :], strict=True)
        measured = [pair for pair in rates if pair[0] in {*trials.schema.states} - {*model.text.observed}]
        provenance = Provenance(
            outcomes=tuple(self._outcomes()),
            history=steps,
            equations=given.texts,
            calls=calls,
            domain=replace(Domain.of(trials, measured), sizes=sizes),
            log_likelihood=optimum.log_likelihood,
        )
        properties = {owner: values for owner, values in trials.properties.items() if owner in trials.objects}
        measurements = sum(int(np.isfinite(trial.states).sum()) for trial in trials)
        return Law(
            terms,
            model.schema,
            model.order,
            trials.objects,
            coefficients,
            Uncertainty(
                covariance=covariance,
                shared_factor=shared,
                noise=np.array([noise[name] for name in trials.schema.states]),
                noise_of=noise_of,
                error_model=problem.errors,
                huber_threshold=begun.huber_threshold,
                degrees_of_freedom=np.array(degrees) if estimated_noise else None,
                limits=tuple(self._limits()),
                at_bounds=tuple(self._at_bounds()),
                misfit=Misfit.of(with_logarithms(trials, begun.logarithmic), self._outlying, measurements),
            ),
            provenance=provenance,
            properties=properties,
            observation=observation,
            restrictions=begun.restrictions,
            scheme="shooting",
            trial_estimates=estimated,
        )

    @cached_property
    def _outlying(self) -> int:
        """How many measurements are outliers."""
        problem, optimum = self.begun.problem, self.optimum
        return int(sum(far.sum() for far in problem.outliers(optimum.unknowns, optimum.noise)))

    def _limits(self) -> Iterator[OneSidedLimit]:
        """Yield the only limits of parameters, of each object that they are of."""
        trials, unknowns = self.begun.trials, self.begun.unknowns
        for k, limit in self.limits.items():
            rows = zip(trials, unknowns.parameters, strict=True)
            for owner in dict.fromkeys(trial.object for trial, indices in rows if k in indices):
                yield OneSidedLimit(owner, unknowns.names[k], limit.limit, limit.is_lower)

    def _at_bounds(self) -> Iterator[AtBound]:
        """Yield the parameters at bounds, of each object that they are of."""
        trials, unknowns = self.begun.trials, self.begun.unknowns
        for k in np.flatnonzero(self.optimum.at_bound).tolist():
            rows = zip(trials, unknowns.parameters, strict=True)
            for owner in dict.fromkeys(trial.object for trial, indices in rows if k in indices):
                yield self._at_bound(owner, k)

    def _at_bound(self, owner: str, k: int) -> AtBound:
        end = float(self.optimum.unknowns[k])
        value, error = (float(column[k]) for column in self.optimum.beyond)
        is_low, name = end == self.begun.bounds.low[k], self.begun.unknowns.names[k]
        return AtBound(owner, name, end, is_low, value, error if 0 < error < np.inf else None)

    @property
    def steps(self) -> tuple[Step, ...]:
        """What was chosen in the fit: outliers, if there are any, errors, and the maximum."""
        begun, problem, optimum, alike = self.begun, self.begun.problem, self.optimum, self.optimum.starts_alike
        schema, unknowns = replace(begun.trials.schema, logarithmic=begun.logarithmic), len(begun.unknowns.names)
        why = "estimates of restricted maximum likelihood"
        how = f"maximum likelihood of {counted(unknowns, 'parameter')} by least squares of trajectories"
        return (
            *error_steps(problem.errors, optimum.noise, schema, why, self._outlying, problem.huber_threshold),
            Step(
                "fit",
                f"-log L = {-optimum.log_likelihood:.6g}",
                how + (f"; {alike} of the best starts end there" if alike else ""),
            ),
        )

    def _zeros_before_doses(self) -> Iterator[Step]:
        """Yield the states that are zero before the first dose of some trials, if there are any."""
        model, trials = self.begun.model, self.begun.trials
        zero = {j for t in trials if not t.cycle for j in {*model.free_of(t)} - {*model.free_in(t)}}
        if zero:
            names = ", ".join(f"{model.variables.states[j]} = 0" for j in sorted(zero))
            yield Step("start", names, "before the first dose, in trials that begin with one")

    def _outcomes(self) -> Iterator[Outcome]:
        """Yield notes on parameters at bounds or without limits, and on what the model does not fit."""
        begun, optimum, labels = self.begun, self.optimum, self.begun.unknowns.labels
        if self.lack_of_fit:
            yield note("residuals-exceed-noise", residuals=self.lack_of_fit)
        for i in np.flatnonzero(optimum.at_bound):
            name, estimate = begun.unknowns.names[i], self._at_bound("", int(i))
            text = next((bound.text for bound in begun.model.text.bounds if bound.name == name), name)
            where = labels[i].removeprefix(f"{name} of ") if labels[i] != name else ""
            degrees = float(np.min(optimum.degrees_of_freedom))
            result = _note_at_bound(estimate, where, text, degrees)
            # A written bound may cause the misfit; that of a dead time, which is never negative, does not
            is_dead_time = text == name and self.lack_of_fit
            yield note("dead-time-at-bound-of-misfit", where, estimate=result.text) if is_dead_time else result
        vague = np.setdiff1d(_vague(begun, optimum), [*self.limits])
        yield from notes_of_limits([*self._limits()], begun.trials.objects)
        if len(vague):
            yield note("parameters-without-limits", parameters=[labels[i] for i in vague[:8]])
        if steady := [trial.label for trial in begun.trials if trial.cycle]:
            where = "" if len(steady) == len(begun.trials) else shown(steady)
            yield note("starts-in-steady-state", where, states=begun.model.variables.states)
        if self.equal:
            names = dict.fromkeys(name for maximum in self.equal for name in maximum.objects)
            states = [begun.model.variables.states[j] for j in latent_states(begun.model) or [0]]
            others = "; ".join(map(str, self.equal[:5]))
            yield note("latent-state-ambiguous", object=shown([*names]), others=others, states=", ".join(states))
        if differing := _differing_trials(self):
            yield note("trials-differ", objects=shown(differing))

    def values(self, owner: str) -> dict[str, Floats]:
        """Return the value of each parameter of an object, the mean over its trials."""
        shares, known = self.begun.unknowns.means(self.begun.trials, owner)
        values = shares @ self.optimum.unknowns + known
        return dict(zip(self.begun.model.parameters, map(np.asarray, values), strict=True))

    def _covariance(self, products: Sequence[Product], support: Bools) -> tuple[Floats, Floats | None]:
        """Return the covariance of each object's coefficients, and the factor of that between objects.

        Given what objects share they are independent: with the shared unknowns s of covariance S, Cov(a, b) = A S B'
        for A = Cov(a, s) inv(S).
        """
        model, trials, unknowns, optimum = self.begun.model, self.begun.trials, self.begun.unknowns, self.optimum
        place = {(j, k): i for i, (j, k) in enumerate(np.argwhere(support).tolist())}
        size, covariance = int(support.sum()), optimum.covariance
        means = {owner: unknowns.means(trials, owner)[0] for owner in trials.objects}
        uses = np.sum([mean.any(axis=0) for mean in means.values()], axis=0)
        shared = np.flatnonzero((uses > 1) & ~optimum.at_bound)
        result, factors = np.zeros((len(trials.objects), size, size)), list[Floats]()
        std = np.sqrt(np.diagonal(covariance)[shared])
        std = np.where(std > 0, std, 1.0)
        # Of nearly collinear unknowns the rounded correlations are hardly positive definite
        correlations = covariance[np.ix_(shared, shared)] / std / std[:, np.newaxis] + 1e-13 * np.eye(len(shared))
        root = std[:, np.newaxis] * np.linalg.cholesky(correlations)
        for i, owner in enumerate(trials.objects):
            values = self.values(owner)
            slopes = np.zeros((size, len(model.parameters)))
            for product in products:
                if (product.equation, product.term) in place:
                    for name, slope in product.slopes(values).items():
                        slopes[place[product.equation, product.term], model.parameters.index(name)] += slope
            slopes = slopes @ means[owner]
            result[i] = slopes @ covariance @ slopes.T
            if len(shared):
                half = np.linalg.solve(root, covariance[shared] @ slopes.T)
                factors.append(half.T)
        return result, np.array(factors) if len(shared) and len(trials.objects) > 1 else None


def _differing_trials(fitted: Fitted, rounding: float = 1e-9) -> list[str]:
    """Return the objects whose parameters differ between trials, but for initial values and what may differ."""
    begun, optimum, p_values = fitted.begun, fitted.optimum, dict[str, float]()
    shared, names = begun.restrictions.shared, begun.unknowns.names
    may = np.array([by_trial(shared.get(name, OBJECT), begun.trials.schema) for name in names], dtype=np.bool_)
    for owner in begun.trials.objects:
        datasets = [data for data in begun.problem.trials if data.trial.object == owner]
        factors, measurements = list[Floats](), 0
        for data in datasets if len(datasets) > 1 else ():
            used = np.isin(np.arange(len(names)), data.parameter) & ~may & ~optimum.at_bound
            free = np.isin(np.arange(len(names)), [*data.initial, *data.parameter]) & ~used & ~optimum.at_bound
            residuals, slopes = replace(begun.problem, trials=(data,), priors=()).residuals(
                optimum.unknowns, optimum.noise
            )
            assert slopes is not None
            rows = np.column_stack([slopes[:, used], slopes[:, used] @ optimum.unknowns[used] - residuals])
            others = slopes[:, free]
            basis, sizes, _ = np.linalg.svd(others / column_scales(others), full_matrices=False)
            basis = basis[:, sizes > rounding * sizes.max(initial=0.0)]
            # Slopes that those by others, such as initial values, do not explain
            rest = rows - basis @ (basis.T @ rows)
            rest *= np.linalg.norm(rest, axis=0) > rounding * np.linalg.norm(rows, axis=0)
            factors.append(np.asarray(np.linalg.qr(rest, mode="r")))
            measurements += len(rows) - basis.shape[1]
        if factors:
            p_values[owner] = heterogeneity_p_value(factors, measurements)
    return [owner for owner, p_value in p_values.items() if p_value < HETEROGENEITY_LEVEL / len(p_values)]


def notes_of_limits(limits: Sequence[OneSidedLimit], objects: Sequence[str]) -> Iterator[Outcome]:
    """Yield notes on parameters of which only a limit can be given, once for objects that share one."""
    for name, text in dict.fromkeys((limit.parameter, limit.text) for limit in limits):
        of = [limit.object for limit in limits if (limit.parameter, limit.text) == (name, text)]
        where = "" if len(of) == len(objects) else shown(of)
        yield note("one-sided-limit", where, name=name, limit=text)


def _note_at_bound(estimate: AtBound, where: str, bound: str, degrees: float) -> Outcome:
    """Return that a parameter is at an end of its bound, with the 95 % interval on the other side."""
    limit, value, error = estimate.limit(0.95, degrees), estimate.value, estimate.error
    within = f"; 95 %: {'up' if estimate.is_low else 'down'} to {limit:.4g}" if np.isfinite(limit) else ""
    text = f"{value:.4g}" if error is None else with_error(value, error)
    return note(
        "estimate-at-bound",
        where,
        name=estimate.parameter,
        end=estimate.bound,
        estimate=text,
        within=within,
        bound=bound,
    )
