"""The estimate that is reported: converged, without discretization error, under the noise that its residuals show.

A search needs no more than which law is more probable. Of the law that it chose, or that was given, the coefficients
are those of least squares on solutions to a hundredth of their standard errors, and the noise is what these leave.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.inference.fit.annealing import LEFT_BY_LAW
from commonlaw.inference.fit.covariance import factors, free_coefficients, residual_freedom, total_freedom
from commonlaw.inference.fit.latent_scale import held_like_others
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.state import FINAL, SearchState
from commonlaw.inference.fit.validity import follows_solutions
from commonlaw.inference.settings import VERY_STRONG
from commonlaw.likelihood import Estimate, NotPositiveError, fit_each

MAX_MOVE = 0.01
"""Standard errors by which a mesh of half the steps may still move the estimate, whose own error is then a fifteenth
of that: the discretization error goes with the fourth power of the step."""

MAX_POINTS = 64
"""Points for each sampling step; solutions that need more are not resolved by their samples."""

_CONVERGED = 1e-3
"""Standard errors by which a converged estimate moves in one more fit."""

_ROUNDS = 20
"""Fits, and estimates of the noise, at most."""


def converged(
    problem: SearchProblem, state: SearchState, least_squares: bool = False
) -> tuple[SearchProblem, SearchState, bool]:
    """Return the problem under the noise of the residuals, on a resolved mesh, the state there, and if it converged.

    A law with a random walk in each step needs no finer mesh, and its levels were found with it. Objects of which
    coefficients are held like those of others stay. The residuals of solutions that no mesh resolves are no noise: of
    exact measurements the estimate of the search is returned, under its smallest noise, and so is one that did not
    converge.

    Parameters
    ----------
    problem, state
        As the search left them.
    least_squares
        Whether no measurement counts as an outlier. By default outliers do so on very strong evidence.
    """
    shared = any(held_like_others(problem, index).any() for index in range(len(problem.models)))
    if state.has_model_error or shared:
        return problem, state, True
    before, moved = (problem, state), np.inf
    try:
        problem, state = _by_least_squares(*_under_residual_noise(problem, state), least_squares)
    except NotPositiveError:
        return *before, False
    while problem.points < MAX_POINTS:
        finer = problem.finer()
        estimates = tuple(
            replace(each, states=tuple(map(type(model.meshes[0]).halfway, model.meshes, each.states)))
            for model, each in zip(problem.models, state.estimates, strict=True)
        )
        try:
            finer, fine = _under_residual_noise(finer, replace(state, estimates=estimates, linearized=None))
        except NotPositiveError:
            break
        moved = _moved(finer, fine, state.estimates)
        problem, state = finer, fine
        if moved < MAX_MOVE:
            break
    return (problem, state, True) if moved < MAX_MOVE else (*before, follows_solutions(*before))


def _by_least_squares(problem: SearchProblem, state: SearchState, always: bool) -> tuple[SearchProblem, SearchState]:
    """Return the problem and the state by least squares; not always where outliers are strong evidence against that."""
    sizes, huber = _relative_residuals(problem, state), problem.models[0].observation.huber_threshold
    if not np.any(sizes > huber):
        return problem, state
    squares, plain = _under_residual_noise(problem.with_huber_threshold(np.inf), state)
    worse = _minus_twice_log_likelihood(squares, plain) - _minus_twice_log_likelihood(problem, state)
    return (squares, plain) if always or worse < VERY_STRONG else (problem, state)


def _minus_twice_log_likelihood(problem: SearchProblem, state: SearchState) -> float:
    """Return minus twice the log-likelihood, with outliers as probable as a measurement at the threshold."""
    sizes, (squares, repeated) = _relative_residuals(problem, state), problem.measurements.pure_error
    deviance = np.nansum(np.minimum(sizes, problem.models[0].observation.huber_threshold) ** 2, axis=0)
    deviance += squares / problem.noise**2
    return float(np.sum(deviance + 2 * (np.isfinite(sizes).sum(axis=0) + repeated) * np.log(problem.noise)))


def _relative_residuals(problem: SearchProblem, state: SearchState) -> Floats:
    """Return the sizes of residuals over their standard deviations, shape (points, states), NaN for what is still."""
    return np.concatenate(
        [
            np.where(mesh.still, np.nan, np.abs(model.residuals(mesh, states)) / problem.std_of(mesh))
            for model, estimate in zip(problem.models, state.estimates, strict=True)
            for mesh, states in zip(model.meshes, estimate.states, strict=True)
        ]
    )


def _moved(problem: SearchProblem, state: SearchState, before: Sequence[Estimate]) -> float:
    """Return by how many standard errors coefficients differ from others, the most of any object (Mahalanobis)."""
    triangles, free = factors(problem, state), free_coefficients(problem, state)
    return max(
        float(np.linalg.norm(factor[:, :-1] @ (other.coefficients - one.coefficients)[own]))
        for factor, own, one, other in zip(triangles, free, before, state.estimates, strict=True)
    )


def _fitted(problem: SearchProblem, state: SearchState) -> SearchState:
    """Return the state fitted until it does not move.

    Raises
    ------
    NotPositiveError
        If the likelihood cannot be computed.
    """
    for _ in range(_ROUNDS):
        estimates = fit_each(problem.models, state.estimates, state.supports, FINAL[-1:])
        if not all(np.isfinite(each.objective) for each in estimates):
            raise NotPositiveError
        state, before = replace(state, estimates=estimates, linearized=None), state.estimates
        if _moved(problem, state, before) < _CONVERGED:
            break
    return state


def _under_residual_noise(problem: SearchProblem, state: SearchState) -> tuple[SearchProblem, SearchState]:
    """Return the problem under the noise that residuals show, and the state fitted under it.

    Noise that was given, or that more samples tell, stays, and levels of other errors were found at their size.
    """
    state = _fitted(problem, state)
    if problem.noise_given or problem.samples or problem.errors:
        return problem, state
    for _ in range(_ROUNDS):
        scale = residual_scale(problem, state)
        if np.abs(np.log(scale)).max() < _CONVERGED:
            break
        problem = problem.noisier(scale, LEFT_BY_LAW)
        state = _fitted(problem, replace(state, linearized=None))
    return problem, state


def residual_scale(problem: SearchProblem, state: SearchState) -> Floats:
    """Return the standard deviation of each state's noise by its residuals, over that in the problem, shape (states,).

    The variance is the sum of squared residuals over their degrees of freedom,

        s_j^2 = sum r_ij^2 / nu_j,    nu_j = n_j - p_j,

    where p_j, of the initial states and coefficients of all objects, is what the measurements of this state determine,
    see `residual_freedom` (restricted maximum likelihood, Patterson and Thompson 1971). Outliers count as neither. A
    state with less than one degree of freedom has the scale of all.
    """
    sizes, huber = _relative_residuals(problem, state), problem.models[0].observation.huber_threshold
    far, measured = sizes > huber, ~problem.trials.schema.unmeasured
    squares = np.nansum(np.where(far, 0.0, sizes) ** 2, axis=0) + problem.measurements.pure_error[0] / problem.noise**2
    freedom = residual_freedom(problem, state) - far.sum(axis=0)
    total = total_freedom(freedom[measured])
    if total < 1:
        return np.ones(len(measured))
    common = np.sum(squares[measured]) / total
    own = np.where(freedom < 1, common, squares / np.maximum(freedom, 1))
    rounding = np.finfo(float).eps * np.nanmax(np.abs(problem.measurements.measured), axis=0) / problem.noise
    return np.where(measured, np.maximum(np.sqrt(own), rounding), 1.0)
