"""The choice among error models, each with its supports and its levels by maximum marginal likelihood."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from commonlaw.array_types import Bools, Floats, evenly_spaced
from commonlaw.diagnostics import Outcome, note
from commonlaw.estimation.fitting import Fitted, limited
from commonlaw.inference import settings
from commonlaw.inference.data.noise import noise_floor
from commonlaw.inference.fit.annealing import (
    anneal,
    fit_solutions,
    fit_supports,
    fit_with,
    refine_support,
    rescale_noise,
)
from commonlaw.inference.fit.covariance import residuals_by_group
from commonlaw.inference.fit.fit import NO_MODEL_ERROR, Fit, fitted, model_error_penalty
from commonlaw.inference.fit.lack_of_fit import OF_NOISE, UNEQUAL, Departures, departures_of_series
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.score.evidence import NoiseScale, minus_twice_log_evidence
from commonlaw.inference.score.trajectories import TrajectoryScore
from commonlaw.inference.search.pool import Pool
from commonlaw.inference.search.setup import error_kinds
from commonlaw.inference.search.strange_objects import outcomes_of_misfit
from commonlaw.law import Step
from commonlaw.likelihood import (
    ERRORS,
    ByGroup,
    ErrorModel,
    Heteroscedastic,
    LinearizedObjects,
    NotPositiveError,
    groupings,
)
from commonlaw.likelihood.levels import free_levels, least, level_bounds, level_starts
from commonlaw.runtime.checkpoint import at_checkpoint
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.runtime.progress import ProgressCallback, Stage, part, unannounced
from commonlaw.text import counted
from commonlaw.trials import Schema, Trials

MISFIT = "misfit"
"""Stage of a history: the errors that were chosen."""
GROUPS = ("white", "measurement", "law")
"""White noise, other measurement errors, and model errors: supports are searched for under the best of each group."""


def choose_errors(
    pool: Pool,
    *,
    errors: ErrorKind | Literal["auto"],
    propose: Callable[[Fit], Bools | None],
    progress: ProgressCallback,
) -> Pool:
    """Return a pool under the chosen error model.

    With ``"auto"`` it is that of largest evidence if the residuals are not white noise. Compared are the supports of
    the pool, and that which `propose` returns for the best fit among plain terms, shape (equations, terms).
    """
    best, schema = pool.best, pool.best.problem.trials.schema
    reason = best.reason_for_error_model if errors == "auto" else "as asked for"
    if not reason:
        return pool
    progress(Stage(f"{reason}: estimating errors jointly with the law", 0.2))
    kinds = (
        error_kinds(errors, schema)
        if errors != "auto"
        else kinds_for(best.lack_of_fit, schema, best.problem.errors.kind)
    )
    proposed = None if pool.plain is None else propose(pool.plain)
    return with_error_models(pool, proposed, kinds, part(progress, 0.2, 0.9))


def kinds_for(lack_of_fit: str, schema: Schema, present: ErrorKind = "white") -> tuple[ErrorKind, ...]:
    """Return the error models that residuals are a reason for: those of the noise, and others of a lack of fit."""
    of_noise: tuple[ErrorKind, ...] = ("proportional", "by-object", "by-trial")
    reasons = {"white", *(of_noise if present in ("white", *of_noise) else (present,))}
    return tuple(kind for kind in error_kinds("auto", schema) if lack_of_fit or kind in reasons)


def under_likeliest_errors(fitted: Fitted) -> Fitted:
    """Return a fit by shooting under white noise, or under errors of measurements that its residuals are evidence for.

    Of a lack of fit it stays under white noise: autocorrelated errors or a drift would hide it, as shooting has no
    process noise to compare them with.
    """
    scored = TrajectoryScore(fitted)
    departures = departures_of(scored)
    if not departures or fitted.lack_of_fit or not all(departures.values()) or scored.has_few_measurements:
        return fitted
    return among_errors(fitted, kinds_for("", _schema(fitted)))


def among_errors(fitted: Fitted, kinds: Sequence[ErrorKind]) -> Fitted:
    """Return the fit under the error model of largest evidence, from one under white noise, see `most_probable`.

    Those of noise by property are white, and those of values below limits are independent, and of one noise.
    """
    begun = fitted.begun
    kinds = _distinct(kinds, begun.trials)
    possible = () if begun.groups else [kind for kind in kinds if ERRORS[kind].group == "measurement"]
    is_censored = begun.problem.censored.any()
    others = [
        kind
        for kind in possible
        if not is_censored or (ERRORS[kind].is_independent and not isinstance(ERRORS[kind], ByGroup))
    ]
    compared = [fitted, *(fitted.under(kind) for kind in others)]
    scores = [TrajectoryScore(fit).score.total for fit in compared]
    best = compared[_order([fit.begun.errors for fit in compared], scores, settings.VERY_STRONG)[0]]
    return fitted if best is fitted else limited(best)


def _distinct(kinds: Sequence[ErrorKind], trials: Trials) -> Sequence[ErrorKind]:
    """Return the kinds without noise by trial where it is that by object, which is among them, or there is one."""
    is_same = "by-object" in kinds and "by-trial" not in groupings(trials)
    return [kind for kind in kinds if not (is_same and kind == "by-trial")]


def misfit_step_of(chosen: Fitted, white: Fitted) -> Step:
    """Return which errors a fit by shooting has in place of white noise, and how much more evidence."""
    more = TrajectoryScore(white).score - TrajectoryScore(chosen).score
    label = ERRORS[chosen.begun.problem.errors.kind].label
    return Step(MISFIT, label, f"2 log B: {more:.3g} over {ERRORS['white'].label}")


def departures_of(scored: TrajectoryScore) -> Departures:
    """Return the departures of residuals of a fit by shooting from white noise, see `departures`."""
    fitted, schema = scored.fitted, _schema(scored.fitted)
    problem, optimum = fitted.begun.problem, fitted.optimum
    is_measured = optimum.noise > 1.001 * scored.noise_floor
    is_unequal = np.zeros(len(is_measured), dtype=np.bool_)
    if not problem.errors:
        for kind in groupings([data.trial for data in problem.trials]):
            residuals = problem.noise_by_group(kind, optimum.unknowns, optimum.noise, ~optimum.at_bound)
            is_unequal |= is_measured & (residuals.evidence > settings.VERY_STRONG) & ~problem.known_noise
    return {
        f"residuals of {name} are {words}": words in OF_NOISE
        for k, name in enumerate(problem.model.observables)
        for words in (
            *departures_of_series(scored.standardized(k), bool(is_measured[k]), name in schema.logarithmic),
            *[UNEQUAL] * int(is_unequal[k]),
        )
    }


def outcomes_of_departures(fitted: Fitted, *, tried_errors: bool) -> tuple[Outcome, ...]:
    """Return notes on departures of residuals from white noise that nothing else explains, and on misfits of a few."""
    scored = TrajectoryScore(fitted)
    departures = {} if fitted.begun.problem.errors or fitted.lack_of_fit else departures_of(scored)
    code = "residuals" if tried_errors else "residuals-under-white-noise"
    result = (note(code, residuals="; ".join(departures)),) if departures else ()
    return (*result, *outcomes_of_misfit(scored.residuals_by_object))


def _schema(fitted: Fitted) -> Schema:
    return replace(fitted.begun.trials.schema, logarithmic=fitted.begun.logarithmic)


def with_error_models(
    pool: Pool, proposed: Bools | None, kinds: Sequence[ErrorKind], progress: ProgressCallback
) -> Pool:
    """Return a pool with the law of largest evidence under these error models; given terms are kept."""
    near = [*pool.fits[: 1 + settings.MAX_RIVALS]]
    if pool.plain is not None and pool.plain not in near and not any(fit.problem.solver for fit in near):
        near.append(pool.plain)
    fits, deterministic = list[Fit](), list[Fit]()
    for fit in near:
        problem = fit.problem
        if problem.solver is None:
            compared = fit_each_kind(problem, fit.supports, kinds)
        else:
            pools = search_each_group(fit, kinds, part(progress, 0.0, 0.5))
            others = [explored.supports for explored in pool.explored]
            others += [] if proposed is None else [proposed & problem.allowed]
            progress(Stage("comparing laws under each error model", 0.5))
            compared = _fit_all_pairs(pools, others)
            if compared:
                progress("comparing error models of the chosen law")
                compared += fit_each_kind(problem, most_probable(compared).supports, kinds)
        if not compared:
            fits.append(fit)
            continue
        # Given terms are fitted by least squares unless the evidence against it is very strong
        best = most_probable(compared, settings.VERY_STRONG if problem.solver is None else 0.0)
        kind = best.errors
        # Levels at the optimum of the chosen law, so that the result does not depend on units and origins
        exact = best if kind == "white" else estimate_error_model(best, kind)
        alternatives = [alternative for alternative in compared if alternative.errors == kind]
        chosen = (exact if exact.is_usable else best).with_alternatives(alternatives)
        before = [step for step in fit.steps if step.stage == MISFIT and step.choice == ERRORS[kind].label]
        kept = [step for step in fit.steps if step.stage != MISFIT]
        is_chosen = kind != "white" or any(fit.errors != kind for fit in compared)
        fits.append(chosen.with_steps((*kept, *(before or [misfit_step(best, compared)] * is_chosen))))
        if best.has_process_noise:
            # Noise by object, or trial, would be what the law misses in each
            explained = [fit for fit in compared if not isinstance(ERRORS[fit.errors], ByGroup) or not fit.lack_of_fit]
            groups = ([fit for fit in explained if ERRORS[fit.errors].group == group] for group in GROUPS[:2])
            deterministic += [min(of_group) for of_group in groups if of_group]
    return Pool.of(fits, pool.explored, deterministic)


def misfit_step(best: Fit, compared: Sequence[Fit]) -> Step:
    """Return which errors were chosen, and how much more evidence they have than others, each with its best terms."""
    least = {kind: min(fit for fit in compared if fit.errors == kind) for kind in {fit.errors for fit in compared}}
    others = sorted((fit for kind, fit in least.items() if kind != best.errors), key=lambda fit: fit.score.total)
    reasons = list[str]()
    for fit in others:
        more = fit.size - best.size
        terms = f" with {counted(abs(more), 'term')} {'more' if more > 0 else 'fewer'}" if more else ""
        reasons.append(f"{fit.score - best.score:.3g} over {ERRORS[fit.errors].label}{terms}")
    why = f"2 log B: {', '.join(reasons)}" if reasons else "no other errors were compared"
    return Step(MISFIT, ERRORS[best.errors].label, why)


def search_each_group(fit: Fit, kinds: Sequence[ErrorKind], progress: ProgressCallback) -> list[Pool]:
    """Return a pool for the best error model of each group, with supports searched for under it, the best first.

    The best model of a group is that of largest evidence for the supports of the fit.
    """
    progress("comparing error models")
    starts, pools = fit_each_kind(fit.problem, fit.supports, kinds), list[Pool]()
    for number, group in enumerate(GROUPS, start=1):
        show = part(progress, number / (len(GROUPS) + 1), (number + 1) / (len(GROUPS) + 1))
        of_group = [begun for begun in starts if ERRORS[begun.errors].group == group]
        if of_group:
            start = min(of_group)
            show(f"searching for a law with {ERRORS[start.errors].label}")
            pools.append(_alternate(start, show))
    return sorted((pool for pool in pools if pool.best.is_usable), key=lambda pool: pool.best.score)


@unannounced()
def fit_each_kind(problem: SearchProblem, supports: Bools, kinds: Sequence[ErrorKind]) -> list[Fit]:
    """Return fits of supports, shape (equations, terms), under each error model with its levels estimated.

    Those whose levels are all none are white noise, where it is one of the kinds.
    """
    fits, white, kinds = list[Fit](), problem.under_white_noise, _distinct(kinds, problem.trials)
    for begin in (white, problem) if problem.errors else (white,):
        solved = fit_solutions(begin, supports)
        possible = [kind for kind in kinds if begin is white or kind == problem.errors.kind]
        fits += [estimate_error_model(solved, kind) for kind in possible if kind != "random-walk"]
    if "random-walk" in kinds:
        fits.append(estimate_error_model(fit_supports(white, supports), "random-walk"))
    usable = [fit for fit in fits if fit.is_usable]
    if "white" not in kinds:
        return usable
    best_white = sorted(fit for fit in usable if fit.errors == "white")[:1]
    return [*best_white, *(fit for fit in usable if not is_white(fit))]


def is_white(fit: Fit) -> bool:
    """Return whether the noise is white, or all levels of other errors are at their bounds, which stand for none."""
    errors, scales = fit.problem.errors, fit.problem.noise_prior.scales
    if fit.has_model_error:
        return not model_error_penalty(fit.problem, fit.model_error)
    return fit.errors == "white" or (errors.levels.size > 0 and not free_levels(errors, scales).any())


def _alternate(fit: Fit, progress: ProgressCallback) -> Pool:
    """Return a fit by alternating between the search for supports and the estimation of error levels."""
    kind, explored = fit.errors, list[Fit]()
    for _ in range(settings.ALTERNATIONS):
        if fit.has_model_error:
            explored = [refine_support(fit.problem, fit.supports, fit.estimates, fit.model_error)]
        else:
            fits = sorted(anneal(fit.problem, progress, settings.SCHEDULES[:1]))
            explored = [candidate for candidate in fits if not candidate.has_model_error]
        others = [candidate for candidate in explored if not np.array_equal(candidate.supports, fit.supports)]
        changed = estimate_error_model(others[0], kind) if others else fit
        if not changed < fit:
            break
        fit = changed
    return Pool((fit,), explored)


@unannounced()
def _fit_all_pairs(pools: Sequence[Pool], others: Sequence[Bools]) -> list[Fit]:
    """Return fits under each error model of the most probable among the supports found under any of them."""
    listed = [*(supports for pool in pools for supports in pool.proposals()), *others]
    most = max((pool.best.problem.most_terms for pool in pools[:1]), default=0)
    distinct = list(
        {proposed.tobytes(): proposed for proposed in listed if proposed.sum(axis=1).max() <= most}.values()
    )
    fits = list[Fit]()
    for pool in pools:
        best = pool.best
        values = [best.evidence.value(proposed) for proposed in distinct]
        for supports in (distinct[i] for i in np.argsort(values)[: settings.MAX_PROPOSED]):
            fit = fit_with(best.problem, supports, best.model_error)
            fits.append(rescale_noise(fit) if best.errors == "white" else estimate_error_model(fit, best.errors))
    return [fit for fit in fits if fit.is_usable]


def most_probable(fits: Sequence[Fit], needed: float = 0.0) -> Fit:
    """Return the fit of largest evidence whose solutions exist over the whole of its trials.

    Error models other than white noise must exceed its evidence by 2 log B = `needed`.
    """
    order = _order([fit.errors for fit in fits], [fit.score.total for fit in fits], needed)
    return next((fits[i] for i in order if fits[i].is_solved), fits[order[0]])


def _order(kinds: Sequence[ErrorKind], scores: Sequence[float], needed: float) -> list[int]:
    """Return the order of fits by their evidence, which must exceed that of white noise by 2 log B = `needed`."""
    values = [score + (0.0 if kind == "white" else needed) for kind, score in zip(kinds, scores, strict=True)]
    return [int(i) for i in np.argsort(values, kind="stable")]


def estimate_error_model(fit: Fit, kind: ErrorKind) -> Fit:
    """Return the fit of the same supports under an error model.

    Its levels and correlation times maximize the evidence with the likelihood linearised about the fit (empirical
    Bayes).
    """
    if not fit.is_usable:
        return fit
    if isinstance(ERRORS[kind], ByGroup):
        return _with_noise_by_group(fit, kind)
    grows = isinstance(ERRORS[kind], Heteroscedastic)
    fit = _with_levels(fit.problem.about(fit.estimates) if grows else fit.problem, fit, kind)
    for _ in range(1, fit.problem.errors.rounds):
        fit = _with_levels(fit.problem.about(fit.estimates), fit, kind) if fit.is_usable else fit
    fit = rescale_noise(fit)
    return fit.with_score(fit.score_at_estimates) if fit.is_usable and not fit.has_converged else fit


def _with_noise_by_group(fit: Fit, kind: ErrorKind) -> Fit:
    """Return the fit with the noise of each group by its residuals, of states for which the evidence is for scatter.

    It is the same fit if there are none.
    """
    scatters = fit.problem.scatters
    for _ in range(settings.ALTERNATIONS):
        if not fit.is_usable or fit.problem.noise_given:
            break
        residuals = residuals_by_group(fit, kind)
        scatters = scatters if scatters.any() else residuals.evidence > 0
        if not scatters.any():
            break
        why = "maximum-marginal-likelihood estimate under this error model"
        problem = fit.problem.with_noise_by_group(kind, residuals, scatters, why)
        fit = fitted(problem, fit.estimates, fit.supports, NO_MODEL_ERROR)
    return fit.with_score(fit.score_at_estimates) if fit.is_usable and not fit.has_converged else fit


def _with_levels(problem: SearchProblem, fit: Fit, kind: ErrorKind) -> Fit:
    """Return the fit with the levels of errors of largest evidence, with the likelihood linearised about the fit.

    Variables are the logarithms of all levels and correlation times: the noise of each state first, times last.
    """
    trials, model, d = problem.trials, ERRORS[kind], len(problem.noise)
    estimate, fixed = problem.noise_estimate, problem.noise_given | trials.schema.is_latent
    bounds = level_bounds(model, problem.scales, noise_floor(trials), np.where(fixed, estimate, np.nan))
    starts = level_starts(model, problem.noise, *bounds)

    def levels(logs: Floats) -> tuple[Floats, ErrorModel, float]:
        """Return the noise of each state, shape (d,), other errors, and the random walk, relative to the noise."""
        values = np.exp(logs)
        return values[:d], model.model(values[d:]), float(np.exp(logs[-1])) if kind == "random-walk" else NO_MODEL_ERROR

    def at(logs: Floats, before: SearchProblem) -> SearchProblem:
        noise, errors, _ = levels(logs)
        return before.with_errors(noise, errors, "maximum-marginal-likelihood estimate under this error model")

    wanted = np.ceil(settings.LEVEL_MEASUREMENTS / np.mean(problem.measured))
    count = int(np.clip(wanted, settings.MIN_OBJECTS, settings.MAX_OBJECTS))
    indices = evenly_spaced(len(problem.models), count)
    subset = at(starts[0], problem.of_objects(indices))
    estimates = subset.padded([fit.estimates[i] for i in indices])
    about, measured = LinearizedObjects(subset.models, estimates, fit.supports & subset.allowed), sum(subset.measured)

    def value(logs: Floats) -> float:
        """Return minus twice the log-evidence given the number of levels."""
        noise, errors, model_error = levels(logs)
        std = subset.white_std_at(noise, errors)
        try:
            factors, log_determinant = about.linearize(std, errors.latent, subset.errors_to_fit(model_error)[-1])
        except NotPositiveError:
            return 1e12
        relative = subset.relative_noise_at(noise, std)
        prior = subset.noise_prior.posterior(noise, errors, relative).prior
        evidence = minus_twice_log_evidence(factors, np.arange(factors.shape[2] - 1), NoiseScale(measured))
        total = evidence + prior + log_determinant + subset.noise_prior.penalty(noise, errors, relative)
        return total if np.isfinite(total) else 1e12

    def most_probable_levels() -> Floats:
        optimum = least(value, model, starts, *bounds, d, measured)
        _, errors, model_error = levels(optimum)
        cost = problem.noise_prior.of_levels(errors) + model_error_penalty(problem, model_error)
        needed = cost * measured / sum(problem.measured) + settings.SAME_DEVIANCE
        none = min((np.append(logs[:d], bounds[0][d:]) for logs in (optimum, starts[0])), key=value)
        # Levels that are not worth their cost stand for no such errors
        return none if value(none) <= value(optimum) + needed else optimum

    key = _with_levels.__qualname__, problem, fit.estimates, fit.supports, kind
    optimum = at_checkpoint(most_probable_levels, *key)
    changed = at(optimum, problem)
    return fitted(changed, changed.padded(fit.estimates), fit.supports, levels(optimum)[2])
