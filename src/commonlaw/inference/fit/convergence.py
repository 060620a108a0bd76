"""Convergence of reported estimates in iterations, mesh refinement and residual noise.

Coefficients of the selected law are converged to `CONVERGED` standard errors, with the noise of their residuals; during
the search, meshes are refined until the evidence does not depend on them.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.inference import settings
from commonlaw.inference.data.noise import noise_floor
from commonlaw.inference.fit.annealing import FROM_RESIDUALS
from commonlaw.inference.fit.covariance import (
    deviations_of,
    factors,
    no_prior,
    outliers,
    relative_residuals,
    residual_degrees_of_freedom,
    residuals_by_group,
    total_degrees_of_freedom,
)
from commonlaw.inference.fit.fit import NO_MODEL_ERROR, Fit
from commonlaw.inference.fit.shared_coefficients import maximum
from commonlaw.likelihood import ERRORS, ByGroup, ErrorModel, Estimate, NotPositiveError, fit_each
from commonlaw.likelihood.levels import MOVED, Deviations, LinearizedFit, likeliest_levels
from commonlaw.likelihood.outliers import capped, likelier_loss, median_noise
from commonlaw.runtime.fit_options import ErrorKind


def converged(fit: Fit, least_squares: bool = False) -> tuple[Fit, bool]:
    """Return the fit on a resolved mesh under the noise of its residuals, and whether it converged.

    Fits with a random walk, or with coefficients fixed at pooled values, are returned as they are, and so are those
    that do not converge. The Huber loss is replaced by least squares, always if `least_squares`, unless the evidence
    for outliers is very strong, under white noise: these are rejected. Other errors of measurements have levels of
    largest restricted likelihood.
    """
    if any(fit.problem.fixed_at_pooled(index).any() for index in range(len(fit.estimates))):
        return replace(fit, shared=None), True
    if fit.has_model_error:
        return fit if fit.shared is None else _fitted(fit), True
    before, is_fitted, kind = fit, False, fit.errors
    with suppress(NotPositiveError):
        if ERRORS[kind].group == "measurement" and not isinstance(
            ERRORS[kind], ByGroup
        ):  # Under white noise it would be all outliers
            white = fit.problem.under_white_noise
            fit = replace(fit, problem=white, estimates=white.padded(fit.estimates))
        squares = _under_residual_noise(replace(fit, problem=fit.problem.with_huber_threshold(np.inf)))
        threshold = np.inf if least_squares else fit.problem.models[0].observation.huber_threshold
        robust = (robust for start in (squares, fit) for robust in _without_outliers(start, threshold))
        fit = likelier_loss(squares, robust, _minus_twice_log_likelihood)
        if not ERRORS[kind].is_independent:  # Rejected one by one, the noise among correlated errors would vanish
            threshold = fit.problem.models[0].observation.huber_threshold
            fit = replace(fit, problem=fit.problem.with_huber_threshold(threshold))
        is_grouped = isinstance(ERRORS[kind], ByGroup)
        if is_grouped and not np.any(fit.problem.scatters & (residuals_by_group(fit, kind).evidence > 0)):
            # It was scattered by outliers alone
            fit = _under_residual_noise(replace(fit, problem=fit.problem.under_white_noise))
        elif ERRORS[kind].group == "measurement":
            fit = _under_likeliest_levels(fit, kind)
        is_fitted, resolved = True, _resolved(fit)
        if resolved is not None:
            return _rescaled(resolved), True  # What is left of the change of the noise is a small share of it
    return before, is_fitted and before.is_resolved


def _resolved(fit: Fit) -> Fit | None:
    """Return the fit on the mesh that moved it least, by less than `CONVERGED` standard errors; None without one.

    A move of `RESOLVED` is enough. Where solutions diverge, moves grow again on finer meshes; those of chaotic ones
    grow from the first on, and none is taken where three in a row do.
    """
    resolved, least, last, growing = None, settings.CONVERGED, np.inf, 0
    with suppress(NotPositiveError):
        while fit.problem.points < settings.MAX_MESH_POINTS[-1] and growing < settings.MAX_GROWING_MOVES:
            estimates = fit.problem.on_half_steps(fit.estimates)
            fit, before = _under_residual_noise(replace(fit, problem=fit.problem.finer(), estimates=estimates)), fit
            moved = _moved(fit, before.estimates, _metric(fit))
            growing, last = growing + 1 if moved >= last else 0, moved
            if moved < least:
                resolved, least = fit, moved
            elif resolved is not None:
                break
            if least < settings.RESOLVED:
                break
    return resolved


def apart(fit: Fit) -> Fit:
    """Return the fit of each object by itself, on the mesh of the joint one; the joint one where it has no maximum."""
    alone = replace(fit, shared=None)
    try:
        return _under_residual_noise(alone)
    except NotPositiveError:
        return alone


def _without_outliers(start: Fit, threshold: float) -> Iterator[Fit]:
    """Yield the converged fit that rejects outliers, if there are any under the noise of median residuals.

    It begins from that under the Huber loss.
    """
    problem, sizes = start.problem.with_huber_threshold(threshold), relative_residuals(start)
    if not _keeps_noise(start):
        floor, latent = noise_floor(problem.trials) / problem.noise, problem.trials.schema.is_latent
        scale = np.where(latent, 1.0, np.maximum(median_noise(sizes), floor))
        problem = problem.with_scaled_noise(scale, FROM_RESIDUALS)
    robust = replace(start, problem=problem)
    if outliers(robust).any():
        with suppress(NotPositiveError):
            robust = _under_residual_noise(robust)
            yield _under_residual_noise(
                replace(robust, problem=robust.problem.with_huber_threshold(threshold, rejects=True))
            )


def _minus_twice_log_likelihood(fit: Fit) -> float:
    """Return minus twice the log-likelihood, see `capped`."""
    problem = fit.problem
    sizes, (squares, repeated) = relative_residuals(fit), problem.pure_error
    deviance = np.nansum(capped(sizes, problem.models[0].observation.huber_threshold), axis=0)
    deviance += squares / problem.noise**2 + 2 * (np.isfinite(sizes).sum(axis=0) + repeated) * np.log(problem.noise)
    ones, places = np.ones(len(problem.noise)), np.concatenate(problem.trial_of_points)
    counts = np.zeros((len(problem.in_order), len(ones)))
    np.add.at(counts, places, np.isfinite(sizes))
    for (trial, of_trial), count in zip(problem.replication, counts, strict=True):
        deviance += 2 * (count + of_trial.freedom) * np.log(problem.errors.noise_of_trial(trial, ones))
    return float(deviance.sum())


def _metric(fit: Fit) -> list[tuple[Floats, Bools]]:
    """Return the factor of the information of each object's free coefficients, and which these are."""
    return list(zip(factors(fit), fit.free_coefficients, strict=True))


def _moved(fit: Fit, before: Sequence[Estimate], metric: Sequence[tuple[Floats, Bools]]) -> float:
    """Return the Mahalanobis distance of coefficients from earlier ones, the largest of all objects."""
    with np.errstate(all="ignore"):  # Of estimates that run away
        return max(
            float(np.linalg.norm(factor[:, :-1] @ (after.coefficients - one.coefficients)[free]))
            for (factor, free), one, after in zip(metric, before, fit.estimates, strict=True)
        )


def _fitted(fit: Fit) -> Fit:
    """Return the fit iterated to `CONVERGED_NOISE` standard errors.

    Raises `NotPositiveError` if the likelihood is not computable.
    """
    metric: Sequence[tuple[Floats, Bools]] = ()
    for _ in range(settings.MAX_ITERATIONS):
        estimates = _next(fit)
        if not all(np.isfinite(estimate.objective) for estimate in estimates):
            raise NotPositiveError
        fit, before = replace(fit, estimates=estimates), fit.estimates
        if len(metric) and _moved(fit, before, metric) >= settings.CONVERGED_NOISE:
            continue  # The information takes longer than a step
        metric = _metric(fit)
        if _moved(fit, before, metric) < settings.CONVERGED_NOISE:
            break
    return fit


def _next(fit: Fit) -> tuple[Estimate, ...]:
    """Return estimates closer to the maximum; shared coefficients are those of all objects, linearized about these."""
    models, final = fit.problem.models, fit.problem.errors_to_fit(fit.model_error)
    if fit.shared is None:
        return fit_each(models, fit.estimates, fit.supports, final[-1:])
    free = fit.free_coefficients
    starts = [
        replace(estimate, coefficients=np.where(inside, moved, estimate.coefficients))
        for estimate, inside, moved in zip(fit.estimates, free, maximum(factors(fit), free, fit.shared), strict=True)
    ]
    return fit_each(models, starts, fit.supports & ~fit.shared, final)


def _under_residual_noise(fit: Fit) -> Fit:
    """Return the converged fit under its residual noise, by fixed-point iteration.

    Noise that is given, or estimated from more samples than are fitted, is kept, and so is that with errors of the law.
    Other errors of measurements are those of `_under_likeliest_levels`.
    """
    if ERRORS[fit.errors].group == "measurement":
        return _under_likeliest_levels(fit, fit.errors)
    fit = _fitted(fit)
    if _keeps_noise(fit):
        return fit
    for _ in range(settings.MAX_ITERATIONS):
        scale = residual_scale(fit)
        if np.abs(np.log(scale)).max() < settings.CONVERGED_NOISE:
            break
        fit = _fitted(replace(fit, problem=fit.problem.with_scaled_noise(scale, FROM_RESIDUALS)))
    return fit


def _under_likeliest_levels(fit: Fit, kind: ErrorKind) -> Fit:
    """Return the fit under errors of measurements, with which levels of largest restricted likelihood alternate."""
    why = "estimate of restricted maximum likelihood under this error model"
    for _ in range(settings.MAX_ITERATIONS):
        problem = fit.problem.about(fit.estimates)
        if not isinstance(ERRORS[kind], ByGroup):
            problem = problem.with_errors(*likeliest_errors(fit, kind), why)
        elif not problem.noise_given:
            problem = problem.with_noise_by_group(kind, residuals_by_group(fit, kind), problem.scatters, why)
        before, fit = fit, _fitted(replace(fit, problem=problem, estimates=problem.padded(fit.estimates)))
        if _moved(fit, before.estimates, _metric(fit)) < MOVED:
            break
    return fit


def likeliest_errors(fit: Fit, kind: ErrorKind) -> tuple[Floats, ErrorModel]:
    """Return the noise of each state, shape (d,), and errors of measurements of largest restricted likelihood."""
    problem, states, free = fit.problem, len(fit.problem.noise), fit.free_coefficients
    trials, latent, errors = problem.trials, problem.trials.schema.is_latent, problem.errors
    objects = deviations_of(fit)
    if fit.shared is not None:
        objects = [[part for parts in _side_by_side(objects, free, fit.shared) for part in parts]]
    floor = noise_floor(trials)
    levels = likeliest_levels(
        ERRORS[kind],
        [LinearizedFit(parts, no_prior(parts)).orthogonal for parts in objects],
        problem.noise,
        problem.noise_given | latent,
        floor,
        problem.scales,
        np.concatenate([problem.noise, errors.levels]) if errors else None,
    )
    return levels[:states], ERRORS[kind].model(levels[states:])


def _side_by_side(
    objects: Sequence[Sequence[Deviations]], free: Sequence[Bools], shared: Bools
) -> list[list[Deviations]]:
    """Return the trials of all objects with slopes by the unknowns of all, of which the shared ones come last."""
    result, last, before = list[list[Deviations]](), int(shared.sum()), 0
    places = np.cumsum(shared).reshape(shared.shape) - 1
    widths = [parts[0].jacobian.shape[2] - int(mask[shared].sum()) for parts, mask in zip(objects, free, strict=True)]
    for parts, mask, width in zip(objects, free, widths, strict=True):
        starts = parts[0].jacobian.shape[2] - int(mask.sum())
        is_shared = np.append(np.zeros(starts, dtype=np.bool_), shared[mask])
        wide = [np.zeros((*part.jacobian.shape[:2], sum(widths) + last)) for part in parts]
        for part, slopes in zip(parts, wide, strict=True):
            slopes[:, :, before : before + width] = part.jacobian[:, :, ~is_shared]
            slopes[:, :, sum(widths) + places[mask & shared]] = part.jacobian[:, :, is_shared]
        result.append([replace(part, slopes=slopes) for part, slopes in zip(parts, wide, strict=True)])
        before += width
    return result


def _rescaled(fit: Fit) -> Fit:
    """Return the fit after one more iteration of `_under_residual_noise` under white noise."""
    if _keeps_noise(fit) or fit.problem.errors:
        return fit
    scale = residual_scale(fit)
    return (
        fit
        if np.all(scale == 1)
        else _fitted(replace(fit, problem=fit.problem.with_scaled_noise(scale, FROM_RESIDUALS)))
    )


def _keeps_noise(fit: Fit) -> bool:
    return fit.problem.noise_given or bool(fit.problem.samples) or fit.problem.errors.of_law


def residual_scale(fit: Fit) -> Floats:
    """Return the residual standard deviation of each state over its noise in the problem, shape (states,).

    The variance is the sum of squared residuals over their degrees of freedom,

        s_j^2 = sum r_ij^2 / nu_j,    nu_j = n_j - p_j,

    where p_j is the effective number of initial states and coefficients that the measurements of this state determine,
    see `residual_degrees_of_freedom` (restricted maximum likelihood, Patterson and Thompson 1971). Outliers count as
    neither, unless most measurements are. A state with less than one degree of freedom has the scale of all.
    """
    problem, sizes, measured = fit.problem, relative_residuals(fit), ~fit.problem.trials.schema.is_latent
    squares = np.nansum(np.where(outliers(fit), 0.0, sizes) ** 2, axis=0) + problem.pure_error[0] / problem.noise**2
    freedom = residual_degrees_of_freedom(fit)
    total = total_degrees_of_freedom(freedom[measured])
    if total < 1:
        return np.ones(len(measured))
    common = np.sum(squares[measured]) / total
    variances = np.where(freedom < 1, common, squares / np.maximum(freedom, 1))
    rounding = np.finfo(float).eps * np.nanmax(np.abs(problem.measurements), axis=0) / problem.noise
    return np.where(measured, np.maximum(np.sqrt(variances), rounding), 1.0)


def on_finer_mesh(fit: Fit, model_errors: Sequence[float]) -> Fit | None:
    """Return the fit on a finer mesh; None if the change is below `MAX_MESH_CHANGE`, or the mesh is the finest."""
    problem = fit.problem
    if problem.points >= settings.MAX_MESH_POINTS[1]:
        return None
    finer, total = problem.finer(), 0.0
    estimates = fit_each(finer.models, finer.starts_with(fit.estimates), fit.supports, model_errors)
    # Squared changes of measured states, relative to the noise
    for model, estimate, after in zip(problem.models, fit.estimates, estimates, strict=True):
        for mesh, states, finest in zip(model.meshes, estimate.states, after.states, strict=True):
            indices = mesh.indices_on(finer.points // problem.points)
            change = (finest[indices] - states)[:, : len(problem.noise)] / problem.std_of(mesh)
            total += float(np.sum(change[mesh.observed] ** 2))
    # Squared changes of coefficients, relative to their standard errors
    for linearized, known, one, after in zip(
        fit.evidence.problems, problem.known, fit.estimates, estimates, strict=True
    ):
        free = fit.supports & np.isnan(known)
        moved = linearized.factor[:, np.flatnonzero(free)] @ (after.coefficients - one.coefficients)[free]
        total += float(np.sum(moved**2))
    if total < settings.MAX_MESH_CHANGE * min(1.0, fit.evidence.noise_variance(fit.supports)):
        return None
    others = tuple(
        replace(alternative, problem=finer, estimates=finer.starts_with(alternative.estimates))
        for alternative in fit.alternatives
    )
    return replace(fit, problem=finer, estimates=estimates, alternatives=others)


def until_resolved(fit: Fit, refit: Callable[[Fit], Fit]) -> Fit:
    """Return the fit, refitted on finer meshes until `on_finer_mesh` changes it no more."""
    while fit.is_usable and not fit.has_model_error:
        finer = on_finer_mesh(fit, fit.problem.errors_to_fit(NO_MODEL_ERROR))
        if finer is None or not (finer := refit(finer)).is_usable:
            break
        fit = finer
    return fit
