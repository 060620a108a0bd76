"""The covariance of coefficients by Fisher information or bootstrap, residual degrees of freedom, and the fitted law.

The scale of a state that was never measured on an object is not identifiable from its trials (see
`structural_identifiability`). Coefficients of terms with that state are therefore fixed at their mean over the objects
on which it was measured.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.errors import CommonlawError
from commonlaw.formulation import LeastSquaresProblem, column_scales
from commonlaw.inference import settings
from commonlaw.inference.data.noise import noise_floor
from commonlaw.inference.fit.fit import Fit, fully_measured
from commonlaw.inference.fit.noise_by_group import approximately_used, noise_by_group
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.shared_coefficients import leverage, maximum
from commonlaw.law import Law
from commonlaw.law.parameters import named_parameters
from commonlaw.likelihood import ERRORS, ErrorModel, NoiseByGroup, deviations, whitened
from commonlaw.likelihood.levels import Deviations, LinearizedFit, covariance_by_levels
from commonlaw.runtime.fit_options import CovarianceKind, ErrorKind


def fitted_law(law: Law, fit: Fit, covariance: CovarianceKind = "likelihood", seed: int = 0) -> Law:
    """Return the law with the coefficients of a fit, their covariance, the noise and the error model.

    Where objects share coefficients, the law has those by each object's own trials, which are to be pooled.

    Raises `CommonlawError` if no coefficient of an object changes its residuals.
    """
    problem, errors, schema = fit.problem, errors_of(fit.problem, fit.model_error), fit.problem.trials.schema
    given_starts = schema.is_latent & ~schema.with_free_start
    by_object = covariances(fit, covariance, seed)
    if not np.isfinite(by_object).all():
        products = named_parameters(law).products
        names = {name: None for product in products for name, _ in product.coefficients}
        raise CommonlawError("parameters-not-identified", names=[*names])
    return replace(
        law,
        properties=problem.trials.properties or law.properties,
        coefficients=own_coefficients(fit),
        uncertainty=replace(
            law.uncertainty,
            covariance=by_object,
            shared_factor=None,
            unpooled=None,
            pooled=None,
            noise=np.where(given_starts, noise_floor(problem.trials), problem.noise),
            error_model=errors,
            degrees_of_freedom=degrees_of_freedom(fit),
            interval_inflation=None,
            explanation=None,
            other_laws=(),
            misfit=None,
        ),
    )


def degrees_of_freedom(fit: Fit) -> Floats | None:
    """Return the degrees of freedom of the noise estimates, shape (states,); None if the noise is given.

    For unmeasured states, or with less than one, they are those of all states. Where the noise differs between objects,
    or trials, they are the fewest of one.
    """
    if fit.problem.noise_given:
        return None
    freedom = residual_degrees_of_freedom(fit)
    if (scatters := fit.problem.scatters).any():
        freedom = residuals_by_group(fit, fit.problem.errors.grouping).degrees_of_freedom(scatters)
    return np.where(freedom < 1, max(total_degrees_of_freedom(freedom), 1.0), freedom)


def residual_degrees_of_freedom(fit: Fit) -> Floats:
    """Return the degrees of freedom of the residuals of each state, shape (states,).

    They are nu_j = n_j - tr H_j, with n_j measurements, replicates included, and the hat matrix H_j (Seber and Wild
    1989, Nonlinear Regression, section 5.10); without a regression, tr H_j is the number of initial states and
    coefficients of the equation. Outliers count as no measurements, and unmeasured states have zero.
    """
    problem = fit.problem
    meshes = [mesh for model in problem.models for mesh in model.meshes]
    counts = np.sum([mesh.moving.sum(axis=0) for mesh in meshes], axis=0) + problem.pure_error[1]
    counts = counts - outliers(fit).sum(axis=0)
    return np.where(problem.trials.schema.is_latent, 0.0, counts - _used(fit).sum(axis=0))


def residuals_by_group(fit: Fit, kind: ErrorKind) -> NoiseByGroup:
    """Return the residuals of each group of a kind of noise, see `noise_by_group`."""
    return noise_by_group(fit.problem, fit.estimates, _used(fit), kind)


def _used(fit: Fit) -> Floats:
    """Return the trace tr H_j of each object, shape (objects, states), see `residual_degrees_of_freedom`."""
    fitted, free = fit.regressions, fit.free_coefficients
    complete = [regression for regression in fitted if regression is not None]
    if fit.shared is not None and len(complete) == len(fitted):
        return leverage(complete, free, fit.shared)
    approximately = approximately_used(fit.problem, fit.estimates)
    used = [
        count if regression is None else regression.leverage
        for count, regression in zip(approximately, fitted, strict=True)
    ]
    if fit.shared is not None:  # They count once
        sharing = np.maximum(np.sum([inside & fit.shared for inside in free], axis=0), 1)
        again = [np.where(inside & fit.shared, 1 - 1 / sharing, 0.0).sum(axis=1) for inside in free]
        used = [count - more for count, more in zip(used, again, strict=True)]
    return np.array(used)


def relative_residuals(fit: Fit) -> Floats:
    """Return the sizes of standardized residuals, shape (points, states), NaN for constant states."""
    problem = fit.problem
    return np.concatenate(
        [
            np.where(mesh.still, np.nan, np.abs(model.residuals(mesh, states)) / problem.std_of(mesh))
            for model, estimate in zip(problem.models, fit.estimates, strict=True)
            for mesh, states in zip(model.meshes, estimate.states, strict=True)
        ]
    )


def outliers(fit: Fit) -> Bools:
    """Return which measurements exceed the Huber threshold, shape (points, states), unless most of a state do."""
    sizes = relative_residuals(fit)
    far = sizes > fit.problem.models[0].observation.huber_threshold
    return np.asarray(far & (2 * far.sum(axis=0) < np.isfinite(sizes).sum(axis=0)))


def deviations_of(fit: Fit) -> list[list[Deviations]]:
    """Return the trials of each object about a fit without errors of the law, without outliers."""
    problem, trials = fit.problem, fit.problem.trials
    lengths = [len(mesh) for model in problem.models for mesh in model.meshes]
    far, free = iter(np.split(outliers(fit), np.cumsum(lengths)[:-1])), fit.free_coefficients
    return [
        deviations(model, estimate, inside, trials.of_object(name), [next(far) for _ in model.meshes])
        for name, model, estimate, inside in zip(trials.objects, problem.models, fit.estimates, free, strict=True)
    ]


def no_prior(parts: Sequence[Deviations]) -> tuple[Floats, Floats]:
    """Return the residuals and rows of no prior of the unknowns of these, see `LinearizedFit`."""
    return np.zeros(0), np.zeros((0, parts[0].jacobian.shape[2]))


def _by_levels(fit: Fit) -> list[Floats] | None:
    """Return what errors of levels that are known from few trials add to the covariance of each object's coefficients.

    None under other errors.
    """
    problem, model = fit.problem, ERRORS[fit.errors]
    if not model.is_of_trials:
        return None
    levels, known = np.concatenate([problem.noise, problem.errors.levels]), problem.trials.schema.is_latent
    added = covariance_by_levels(
        model,
        [LinearizedFit(parts, no_prior(parts)) for parts in deviations_of(fit)],
        levels,
        problem.noise_given | known,
        noise_floor(problem.trials),
        problem.scales,
    )
    counts = [int(free.sum()) for free in fit.free_coefficients]
    return [matrix[len(matrix) - p :, len(matrix) - p :] for matrix, p in zip(added, counts, strict=True)]


def total_degrees_of_freedom(freedom: Floats) -> float:
    """Return the sum of degrees of freedom, rounded, as it is an integer in least squares."""
    return round(float(np.sum(freedom)), 6)


def factors(fit: Fit) -> list[Floats]:
    """Return the triangular factor of each object's regression, [free coefficients | target]."""
    fitted, result = fit.regressions, list[Floats]()
    # Linearized about all coefficients, for objects without a regression
    rows = () if all(fitted) else fit.evidence.problems
    for o, (regression, free) in enumerate(zip(fitted, fit.free_coefficients, strict=True)):
        if regression is None:
            result.append(rows[o].restrict(np.flatnonzero(free).tolist()).factor)
        else:
            factor = regression.factor.copy()  # With residuals for target
            factor[:, -1] += factor[:, :-1] @ fit.estimates[o].coefficients[free]
            result.append(factor)
    return result


def own_coefficients(fit: Fit) -> Floats:
    """Return coefficients of each object by its own trials, to first order about the fit of all objects together.

    Only those that objects share differ from the fit; shape (objects, equations, terms).
    """
    estimates = np.array([estimate.coefficients for estimate in fit.estimates])
    return estimates if fit.shared is None else _maximum(fit, None)


def joint_coefficients(fit: Fit) -> Floats:
    """Return coefficients of all objects together, of which the shared ones are equal, see `own_coefficients`."""
    return _maximum(fit, fit.shared)


def _maximum(fit: Fit, shared: Bools | None) -> Floats:
    free = fit.free_coefficients
    triples = zip(fit.estimates, free, maximum(factors(fit), free, shared), strict=True)
    return np.array([np.where(inside, value, estimate.coefficients) for estimate, inside, value in triples])


def errors_of(problem: SearchProblem, model_error: float) -> ErrorModel:
    """Return the error model, with a model error, relative to the noise, as a random walk per unit of time."""
    if not model_error:
        return problem.errors
    step = np.median(np.concatenate([np.diff(trial.times) for trial in problem.trials]))
    return replace(problem.errors, walk=model_error * problem.unit / np.sqrt(step))


def covariances(fit: Fit, kind: CovarianceKind, seed: int) -> Floats:
    """Return each object's covariance of its coefficients, shape (objects, parameters, parameters).

    Parameters are the coefficients that are not zero for some object, in the order of `numpy.argwhere`. Those that are
    known, or zero for an object, have no variance.

    It is the inverse Fisher information, with initial states profiled out, or that of the block bootstrap of
    innovations (Stoffer and Wall 1991), linearized about the fit, which does not assume the noise model. To the first,
    errors of levels of a drift are added, see `covariance_by_levels`.
    """
    problem = fit.problem
    coefficients = np.array([estimate.coefficients for estimate in fit.estimates])
    support = np.any(coefficients != 0, axis=0)
    by_object = np.zeros((len(fit.estimates), support.sum(), support.sum()))
    triangles, by_levels = (factors(fit), _by_levels(fit)) if kind == "likelihood" else ((), None)
    listed = zip(problem.models, fit.estimates, fit.free_coefficients, strict=True)
    for o, (model, estimate, free) in enumerate(listed):
        indices, inner = np.flatnonzero(free[support]), np.flatnonzero(free)
        if kind == "bootstrap":
            trials = [rows for rows, _ in whitened(model, estimate, fit.fitted_model_error)]
            covariance = bootstrapped(trials, inner, seed)
        else:
            factor = triangles[o][:, :-1]
            covariance = _inverse(factor) if by_levels is None else _inverse(factor) + by_levels[o]
            if (held := problem.fixed_at_pooled(o) & free).any():
                whole = fully_measured(problem, fit.estimates)
                scatter = whole[0] ** 2  # Of one object, the between-object variance is not identifiable: 100 %
                if len(whole) > 1:
                    scatter = np.var(whole, axis=0, ddof=1) * (1 + 1 / len(whole))
                # With the design matrix [X_f X_h] of free and fixed coefficients, G = -X_f^+ X_h and the variances V of
                # fixed ones, it has the blocks C_hh = V, C_fh = G V, C_ff = (X_f' X_f)^-1 + G V G'
                is_fixed, variances = held[free], scatter[held]
                follow = -np.linalg.pinv(factor[:, ~is_fixed]) @ factor[:, is_fixed]
                moved = follow * variances
                covariance[np.ix_(is_fixed, is_fixed)] = np.diag(variances)
                covariance[np.ix_(~is_fixed, is_fixed)] = moved
                covariance[np.ix_(is_fixed, ~is_fixed)] = moved.T
                covariance[np.ix_(~is_fixed, ~is_fixed)] = _inverse(factor[:, ~is_fixed]) + moved @ follow.T
        by_object[o][np.ix_(indices, indices)] = covariance
    return by_object


def bootstrapped(trials: Sequence[Floats], indices: Indices, seed: int = 0) -> Floats:
    """Return the covariance of least squares on blocks of rows drawn with replacement.

    `trials` has the whitened rows ``[library | target]`` of each; `indices` are the columns of the library.
    """
    count = -(-settings.BOOTSTRAP[0] // len(trials))
    columns = [*indices, -1]
    blocks = [part for rows in trials for part in np.array_split(rows[:, columns], count) if len(part)]
    factors = np.array([LeastSquaresProblem.of(part[:, :-1], part[:, -1:]).factor for part in blocks])
    drawn = np.random.default_rng(seed).integers(len(blocks), size=(settings.BOOTSTRAP[1], len(blocks)))
    stacked = factors[drawn].reshape(settings.BOOTSTRAP[1], -1, len(columns))
    norms = column_scales(np.concatenate(factors))
    reduced, inner = np.asarray(np.linalg.qr(stacked / norms, mode="r")), slice(len(indices))
    # Minimum-norm solutions: coefficients that the drawn blocks do not identify are zero
    inverse = np.linalg.pinv(reduced[:, inner, inner], rcond=settings.COLLINEAR)
    estimates = np.matmul(inverse, reduced[:, inner, -1:])[..., 0]
    return np.atleast_2d(np.cov(estimates * (norms[-1] / norms[:-1]), rowvar=False))


def _inverse(factor: Floats) -> Floats:
    """Return the inverse of ``factor' factor``, shape (k, k), by singular values.

    Combinations that are not identifiable, as of more coefficients than measurements, have variances of 1e28 squares of
    the largest error instead of none; infinite ones where nothing is.
    """
    if not factor.any():
        return np.full((factor.shape[1],) * 2, np.inf)
    norms = column_scales(factor)
    values, directions = np.linalg.svd(factor / norms)[1:]
    values = np.append(values, np.zeros(len(directions) - len(values)))
    inverse = (directions.T / np.maximum(values, 1e-14 * values.max(initial=0.0))) / norms[:, np.newaxis]
    with np.errstate(over="ignore"):  # Of a parameter that the measurements do not determine
        return np.asarray(inverse @ inverse.T)
