"""What is said of a law: the choices on the way to it, and what else was to choose from."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools, Floats, evenly_spaced
from commonlaw.diagnostics import Outcome, OutcomeKind, note
from commonlaw.errors import CommonlawError
from commonlaw.forecast import fitted
from commonlaw.inference import settings
from commonlaw.inference.data.noise import by_columns, estimated_noise
from commonlaw.inference.fit.covariance import outliers, relative_residuals
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.score.score import Kind
from commonlaw.inference.search.pool import Pool
from commonlaw.inference.search.strange_objects import outcomes_of_misfit
from commonlaw.law import Alternative, Law, Step
from commonlaw.law.parameters import left_hand_sides, named_parameters
from commonlaw.law.provenance import WITHOUT_QUANTITIES, error_steps, levels_in_words
from commonlaw.law.tables import LOG_SCORE
from commonlaw.likelihood import Estimate, fit as fitted_states, linearize
from commonlaw.likelihood.linearization import HETEROGENEITY_LEVEL, heterogeneity_p_value
from commonlaw.text import counted, shown
from commonlaw.trials import Trials

Compared = dict[tuple[str, ...], float]
"""Names of the terms of an equation, the chosen ones first, with 2 log B of those against them; or with twice the
difference of log scores where forecasts chose."""


def names_in(law: Law, support: Bools) -> tuple[str, ...]:
    """Return the names of the terms of a support, but not of parameters inside them."""
    return tuple(law.terms.names[k] for k in np.flatnonzero(support & law.terms.is_factor))


def alternatives(law: Law, compared: Sequence[Compared], chosen_by: str) -> tuple[Alternative, ...]:
    """Return the terms that each equation was chosen from, the best first, with what they were chosen by."""
    result = []
    for equation, listed in zip(left_hand_sides(law), compared, strict=True):
        likely = probabilities(listed)
        for i, (names, difference) in enumerate(listed.items()):
            if i < settings.MAX_MODELS or likely[i] > settings.MIN_PROBABILITY:
                probability = float(likely[i]) if likely[i] >= np.finfo(float).tiny else 0.0
                measures: dict[str, float | None] = {"2 log B": difference, "probability": probability}
                if chosen_by == Kind.FORECASTS:  # Their scores are no evidence, and none if these diverge
                    measures = {LOG_SCORE: difference / 2 if np.isfinite(difference) else None}
                result.append(Alternative(equation, names, measures, False, chosen=i == 0))
    return tuple(result)


def inclusion_probabilities(law: Law, compared: Sequence[Compared]) -> Floats:
    """Return the probability that a term is in its equation, among the sets compared, shape (equations, terms).

    A constant is in it with the terms that it is inside.
    """
    rows = []
    for listed in compared:
        weights = probabilities(listed)
        supports = np.array([[name in names for name in law.terms.names] for names in listed])
        inside, outside = weights @ supports, weights @ ~supports
        rows.append(inside / (inside + outside))
    result, terms = np.array(rows), law.terms
    for place in terms.parameters:
        of = [k for k in np.flatnonzero(terms.is_factor) if terms.terms[k].columns() >= terms.terms[place].columns()]
        result[:, place] = result[:, of].max(axis=1)
    return result


def probabilities(listed: Compared) -> Floats:
    """Return how probable each set of terms is among those compared, by its evidence (Kass and Raftery 1995)."""
    factors = np.array([*listed.values()])
    weights = np.exp((factors.min() - factors) / 2)
    return np.asarray(weights / weights.sum())


_LEVELS = "maximum-marginal-likelihood estimates of the error parameters"


def outcomes(law: Law, fit: Fit, is_converged: bool, *, tried_errors: bool) -> tuple[Outcome, ...]:
    """Return what a user should know of a law that was chosen by these trials."""
    result = [*outcomes_of_fit(law, fit, is_converged, tried_errors=tried_errors, chosen=True)]
    lefts = left_hand_sides(law)
    result += [
        note("no-term", side)
        for j, side in enumerate(lefts)
        if not any(estimate.coefficients[j].any() for estimate in fit.estimates)
    ]
    most = fit.problem.most_terms
    result += [
        note("as-many-terms-as-samples", side, terms=most)
        for side, support in zip(lefts, fit.supports, strict=True)
        if support.sum() == most < min(settings.MAX_TERMS, fit.problem.allowed.sum(axis=1).max())
    ]
    return tuple(result)


LACKS_OF_FIT = OutcomeKind.APPROXIMATION, OutcomeKind.MODEL_ERROR, OutcomeKind.RESIDUALS
"""What may be known of the fit of a law."""


def outcomes_of_fit(
    law: Law, fit: Fit, is_converged: bool, *, tried_errors: bool, chosen: bool = False
) -> tuple[Outcome, ...]:
    """Return what to know of a law by its fit: errors that are not explained, and samples.

    The remedies depend on whether errors of other kinds were tried, and whether the law was chosen from a library.
    """
    result = list[Outcome]()
    if not (fit.has_model_error or (is_converged and fit.is_resolved)):
        result.append(note("fit-not-converged" if chosen else "fit-not-converged-from-guesses"))
    elif fit.diverges and not fit.has_model_error and _has_no_solution(law, fit.problem.trials):
        result.append(note("fit-diverges"))
    if not fit.has_process_noise and (lack := _left(fit)):
        result.append(note("residuals" if tried_errors else "residuals-under-white-noise", residuals=lack))
    if not fit.has_process_noise:
        result += outcomes_of_misfit(_residuals_by_object(fit))
    if fit.problem.samples:
        result.append(note("samples-fitted", samples=fit.problem.samples))
    problem, schema = fit.problem, fit.problem.trials.schema
    is_estimated = problem.noise_given or problem.noise_is_identifiable
    if not is_estimated and np.array_equal(problem.noise, estimated_noise(problem.trials)[0], equal_nan=True):
        levels = levels_in_words(problem.noise, schema)
        result.append(note("noise-assumed", levels=levels, name=schema.measured[0]))
    return tuple(result)


def _residuals_by_object(fit: Fit) -> list[tuple[str, Floats]]:
    """Return differences of measurements and trajectories of each segment and state, with the object."""
    schema, listed = fit.problem.trials.schema, list[tuple[str, Floats]]()
    for name, model, estimate in zip(fit.problem.trials.objects, fit.problem.models, fit.estimates, strict=True):
        for mesh, states in zip(model.meshes, estimate.states, strict=True):
            segments = np.concatenate([[0], np.cumsum(~mesh.contiguous)])
            for j in np.flatnonzero(~schema.is_latent):
                seen = (mesh.observed & ~mesh.still)[:, j]
                residuals = (mesh.measured - states[:, : len(schema.states)])[seen, j]
                ends = np.flatnonzero(np.diff(segments[seen])) + 1
                listed += [(name, series) for series in np.split(residuals, ends)]
    return listed


def with_approximation(pool: Pool, outcomes: Iterable[Outcome]) -> tuple[Outcome, ...]:
    """Return the outcomes of a law; if it `is_approximation`, with the size of its lack of fit."""
    if not pool.is_approximation:
        return tuple(outcomes)
    problem, schema = pool.best.problem, pool.best.problem.trials.schema
    squares = (relative_residuals(pool.best) * problem.white_std) ** 2
    parts = [
        f"{value:.3g} {schema.units.get(name, '')}".rstrip() + f" in {name} (noise {level:.2g})"
        for name, value, level, is_latent in zip(
            schema.states,
            np.sqrt(np.nanmean(squares, axis=0)),
            problem.noise_estimate,
            schema.is_latent,
            strict=True,
        )
        if not is_latent
    ]
    of = "this law" if problem.solver is None else "this law, the best of its library,"
    lack = note("lack-of-fit", law=of, residuals=parts)
    return (lack, *(outcome for outcome in outcomes if outcome.kind not in LACKS_OF_FIT))


def _has_no_solution(law: Law, trials: Trials) -> bool:
    """Return whether a law diverges in a trial from the initial values that are estimated from all of its samples."""
    try:
        return any(outcome.kind is OutcomeKind.DIVERGED for outcome in fitted(law, trials).outcomes)
    except CommonlawError:  # Not finite near the samples
        return True


def outcomes_of_unmeasured(law: Law, problem: SearchProblem) -> tuple[Outcome, ...]:
    """Return notes on coefficients of laws with latent states that are not, or not well, identifiable."""
    result, parameters, schema = list[Outcome](), named_parameters(law), problem.trials.schema
    uncertain = dict[str, list[str]]()  # Objects by parameters of which the standard errors exceed the values
    states = ", ".join(schema.initial_values)
    for name, values, errors in zip(law.objects, parameters.values, parameters.errors, strict=True):
        if states and (unsure := [parameters.names[i] for i in np.flatnonzero(errors > abs(values))]):
            uncertain.setdefault(", ".join(unsure), []).append(name)
    for names, objects in uncertain.items():
        result.append(note("parameters-with-latent-states", ", ".join(objects), states=states, parameters=names))
    optima = [
        ", ".join(f"{definition.name} = {float(definition.of(theta)):.3g}" for definition in parameters.definitions)
        for theta in problem.equivalent_optima
    ]
    if optima:
        others = "; or ".join(optima)
        result.append(note("latent-state-ambiguous", object=law.objects[0], others=others, states=states))
    return tuple(result)


def differing_trials(fit: Fit) -> tuple[Outcome, ...]:
    """Return a note on the objects with heterogeneous trials, by F tests with Bonferroni correction."""
    trials = fit.problem.trials
    names = [name for name in trials.objects if len(trials.of_object(name)) > 1]
    names = [names[i] for i in evenly_spaced(len(names), settings.MAX_CHECKED_OBJECTS)] if names else []
    differing = [name for name in names if p_value_of_trials(fit, name) < HETEROGENEITY_LEVEL / len(names)]
    return (note("trials-differ", objects=shown(differing)),) if differing else ()


def p_value_of_trials(fit: Fit, name: str) -> float:
    """Return the p-value of the F test for between-trial heterogeneity of an object, see `heterogeneity_p_value`.

    It is one if single trials cannot be fitted.
    """
    problem, index, factors = fit.problem, fit.problem.trials.objects.index(name), list[Floats]()
    group, estimate = problem.trials.of_object(name), fit.estimates[index]
    alone = [replace(trial, object=f"{i}", name="1") for i, trial in enumerate(group)]
    known = np.repeat(problem.known[index : index + 1], len(group), axis=0)
    free: Bools = (estimate.coefficients != 0) & np.isnan(problem.known[index])
    last = fit.fitted_model_error
    errors = [error for error in settings.SHORT_SCHEDULE[1:] if error > last] + [last]
    try:
        part = problem.of_trials(alone, known, np.array([estimate.coefficients] * len(group)))
        for model, start in zip(part.models, part.starts, strict=True):
            start = Estimate(start.states, estimate.coefficients)
            fitted = fitted_states(model, start, np.zeros_like(free), errors)
            factors.append(linearize(model, fitted, last, free).problem.factor)
    except CommonlawError:
        return 1.0
    measurements = sum(part.measured) - part.models[0].width * len(group)
    return heterogeneity_p_value(factors, measurements, problem.least_variance)


def without_outcomes_of_fit(outcomes: Iterable[Outcome]) -> tuple[Outcome, ...]:
    """Return outcomes of a law without those that a fit to other measurements decides anew."""
    of_fit = OutcomeKind.AMBIGUOUS, OutcomeKind.BOUND, OutcomeKind.ERRORS, OutcomeKind.SAMPLES
    kinds = {*LACKS_OF_FIT, *WITHOUT_QUANTITIES, *of_fit}
    return tuple(outcome for outcome in outcomes if outcome.kind not in kinds)


def _left(fit: Fit) -> str:
    """Return in words which patterns of the residuals white noise does not explain; nothing under other errors."""
    return "" if fit.problem.errors else "; ".join(fit.departures)


def sample_steps(problem: SearchProblem) -> tuple[Step, ...]:
    """Return where inputs jump, which samples were fitted, if not all, and which states a trial never measured."""
    why = "sample limit of the trajectory likelihood"
    unknown = "between two samples, when exactly is unknown: states begin anew after it"
    trials, states = problem.trials, problem.trials.schema.states
    counts = np.sum([np.isnan(trial.states).all(axis=0) for trial in trials], axis=0)
    pairs = zip(states, counts, strict=True)
    unmeasured = ", ".join(f"{name} in {count} of {len(trials)} trials" for name, count in pairs if count)
    latent = Step("latent states", unmeasured, "estimated jointly with the law, identified by the other trials")
    steps = (Step("jumps", problem.jumps, unknown), Step("samples", problem.samples, why), latent)
    return tuple(step for step in steps if step.choice)


def history(law: Law, fit: Fit, compared: Sequence[Compared], chosen_by: str) -> tuple[Step, ...]:
    """Return every choice that was made, in order, and what terms were chosen by."""
    problem = fit.problem
    resolved = f"a finer mesh changes the coefficients by less than {settings.CONVERGED:g} standard errors"
    mesh = resolved if problem.points < settings.MAX_MESH_POINTS[-1] else "finest mesh available"
    steps = [
        *sample_steps(problem),
        noise_step(problem),
        Step(
            "library",
            counted(int(law.terms.is_factor.sum()) + problem.excluded_terms, "term")
            + (f" for each of {len(law.schema.states)} equations" if len(law.schema.states) > 1 else ""),
            ", ".join(law.terms.names[:10]) + (", ..." if len(law.terms) > 10 or problem.excluded_terms else ""),
        ),
        Step(
            "mesh",
            f"{problem.points} step{'s' if problem.points > 1 else ''} from sample to sample",
            "laws with process noise need no finer mesh" if fit.has_model_error else mesh,
        ),
    ]
    for equation, listed in zip(left_hand_sides(law), compared, strict=True):
        steps.append(Step(f"terms of {equation}", ", ".join(next(iter(listed))) or "none", _why(listed, chosen_by)))
    return (*steps, *fit_steps(fit))


def noise_step(problem: SearchProblem) -> Step:
    """Return what noise was taken."""
    reason = f"as given{by_columns(problem.trials.schema)}" if problem.noise_given else problem.noise_reason
    return Step("noise", levels_in_words(problem.noise, problem.trials.schema), reason)


def fit_steps(fit: Fit) -> tuple[Step, ...]:
    """Return what errors there are besides noise, how the coefficients were found, and what the trajectories leave."""
    problem, schema = fit.problem, fit.problem.trials.schema
    outlying, observation = int(outliers(fit).sum()), problem.models[0].observation
    deviance, count = sum(estimate.deviance for estimate in fit.estimates), sum(problem.measured)
    deviance += float(np.sum(problem.pure_error[0] / problem.noise**2))
    if observation.rejects:  # Each counts as one at the threshold
        deviance, count = deviance - observation.huber_threshold**2 * outlying, count - outlying
    threshold = observation.huber_threshold
    return (
        *error_steps(problem.errors, problem.noise, schema, problem.noise_reason, outlying, threshold),
        model_error_step(fit),
        Step(
            "coefficients",
            f"maximum likelihood of {len(problem.trials)} trajectories",
            f"deviance {deviance / count:.3f} per measurement ({count} measurements; about 1 expected)",
        ),
    )


def model_error_step(fit: Fit) -> Step:
    """Return what error the law itself has."""
    why, errors, schema = _LEVELS, fit.problem.errors, fit.problem.trials.schema
    if errors.force is not None:
        levels = (f"{name}: {level:.3g}" for name, level in zip(schema.states, errors.force, strict=True))
        time = f"{errors.force_time:.3g} {schema.units.get(schema.time, '')}".rstrip()
        return Step("model error", f"a smooth force on {', '.join(levels)}; over {time}", why)
    if fit.has_model_error:
        return Step("model error", f"a random walk with steps of {fit.model_error:.3g} times the noise", why)
    lack = _left(fit)
    fine = "no lack of fit: residuals are within the noise"
    return Step(
        "model error",
        "none",
        f"no model error was included, although the residuals are not white noise: {lack}" if lack else fine,
    )


def _why(listed: Compared, chosen_by: str) -> str:
    if len(listed) == 1:
        return "no other support was compared" if chosen_by == Kind.EVIDENCE else chosen_by
    _, (names, ahead), *_ = listed.items()
    runner = ", ".join(names) or "no term"
    if chosen_by == Kind.FORECASTS:
        if np.isinf(ahead):
            return f"{chosen_by}; those of all others diverge"
        return f"{chosen_by}; the next, {runner}, has a log score {ahead / 2:.3g} lower"
    return f"{chosen_by}; the next, {runner}, is {np.exp(min(ahead / 2, 700)):.3g} times less probable"
