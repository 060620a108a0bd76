"""The score of a law that is reported: the same number for a law of a search, of given equations, or of shooting."""

from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.inference import settings
from commonlaw.inference.data.smoothing import start_variances
from commonlaw.inference.fit.convergence import converged
from commonlaw.inference.fit.covariance import deviations_of, outliers
from commonlaw.inference.fit.fit import Fit, fitted
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.score.score import Part, Score
from commonlaw.inference.score.trajectories import Rows, canonical_order, score_of_rows
from commonlaw.library import with_rates
from commonlaw.likelihood import prior_variances
from commonlaw.trials import Trial
from commonlaw.trials.trial import with_typical

OF_SEARCH: tuple[Part, ...] = ("multiplicity", "scatter of starts")
"""Parts of the score of a search, besides that of the structure, which given equations do not have."""


def final(fit: Fit) -> tuple[Fit, bool]:
    """Return the fit of a search as it is reported, with the score of `score_of_fit`, and whether it converged.

    Its mesh is resolved, and its noise is that of its residuals, whatever they were in the search. The prior of its
    structure and the parts `OF_SEARCH` are added. Latent states, which have a prior, and noise that residuals do not
    identify stay as they are.
    """
    problem, done, is_converged = fit.problem, fit, True
    is_noise_identified = problem.noise_is_identifiable or problem.is_determined(fit.size * len(problem.models))
    if is_noise_identified and not problem.trials.schema.is_latent.any():
        done, is_converged = converged(fit)
    score = score_of_fit(done)
    score = score.plus("structure", sum(problem.structure_prior.of(support) for support in fit.supports))
    for name in OF_SEARCH:
        score = score.plus(name, fit.score.parts.get(name, 0.0))
    return done.with_score(score), is_converged


def score_of_fit(fit: Fit) -> Score:
    """Return the score of a converged fit without a prior of its terms.

    Of solutions of the law it is exact in their slopes, as that of fits by shooting; with errors of the law, or where
    solutions diverge, it is that of the linearization.
    """
    problem, free = fit.problem, fit.free_coefficients
    if fit.has_process_noise or any(not np.array_equal(inside, free[0]) for inside in free):
        return _of_linearization(fit)
    order = canonical_order(problem.terms)
    taken = (np.cumsum(free[0]).reshape(free[0].shape) - 1)[:, order][free[0][:, order]]
    rows = list[Rows]()
    for deviations, estimate in zip(deviations_of(fit), fit.estimates, strict=True):
        slopes, residuals, logs = list[Floats](), list[Floats](), 0.0
        for deviation in deviations:
            whitened, seen = deviation.whitened(problem.noise, problem.errors), deviation.seen
            std = _std_of_constant(deviation.trial, problem)
            still = np.isfinite(std)
            of_still = deviation.jacobian[still] / std[still][:, np.newaxis]
            assert whitened.slopes is not None
            slopes += [whitened.slopes[seen], of_still]
            residuals += [whitened.z[seen], (deviation.values - deviation.trial.states)[still] / std[still]]
            measured = np.isfinite(deviation.trial.states)
            logs += float(np.log(np.where(still, std, whitened.std)[measured]).sum())
        stacked, coefficients = np.concatenate(slopes), estimate.coefficients[free[0]]
        if not np.isfinite(stacked).all():  # Solutions diverge
            return _of_linearization(fit)
        starts, columns = np.split(stacked, [stacked.shape[1] - len(coefficients)], axis=1)
        others, z = np.empty((len(stacked), 0)), np.concatenate(residuals)
        rows.append(Rows(starts, others, columns[:, taken], z, coefficients[taken], 2 * logs))
    outlying = int(outliers(fit).sum())
    noise_scale = replace(problem.noise_scale, freedom=problem.noise_scale.freedom - outlying)
    more: dict[Part, float] = {
        "error levels": problem.level_penalty,
        "outliers": problem.models[0].observation.huber_threshold ** 2 * outlying if outlying else 0.0,
        "initial conditions": initial_conditions(fit, integrated=False),
    }
    logarithmic = np.broadcast_to(np.array(problem.terms.have_parameters, dtype=bool), free[0].shape)[free[0]]
    return score_of_rows(rows, logarithmic[taken], noise_scale, more)


def _of_linearization(fit: Fit) -> Score:
    """Return the score of a linearization, that of a random walk on the finest mesh of searches."""
    while fit.has_model_error and fit.problem.points < settings.MAX_MESH_POINTS[1]:
        starts = fit.problem.on_half_steps(fit.estimates)
        # Twice as many steps of the same variance in time
        finer = fitted(fit.problem.finer(), starts, fit.supports, fit.model_error / np.sqrt(2))
        if not finer.is_usable:
            break
        fit = finer
    score = score_of_order(replace(fit, score=fit.evidence.score(fit.supports)))
    return score.plus("structure", -score.parts["structure"])


def _std_of_constant(trial: Trial, problem: SearchProblem) -> Floats:
    """Return the standard deviations of measurements of states that are constant in a segment, NaN for others, (n, d).

    They are those before any law, see `SearchProblem.white_std_at`.
    """
    constant = np.fmin.reduce(trial.states) == np.fmax.reduce(trial.states)
    noise = problem.noise_estimate * np.where(trial.absent, settings.MIN_NOISE, 1.0)
    std = with_typical(trial.noise, noise) * trial.averaging
    return np.where(np.isfinite(trial.states) & constant, std, np.nan)


def score_of_order(fit: Fit) -> Score:
    """Return the score of a law in a form that is comparable between orders, and with a law of other starts.

    Initial values of measured states have a flat prior, and those of others, and of rates v0, one that is vague and
    depends on the mesh. Here they are normal, of variances s^2 that are the same for all laws, see `start_variances`:
    vague for measured states, and N(0, s^2) for rates. This adds

        sum over trials and states of log(s^2) + v0^2/s^2 - log(s_mesh^2).

    The predicted decrease of the deviance is added, too: a fit of an unsuitable order may end in a stiff law far from
    the optimum of its linearization.
    """
    score = fit.score if "Laplace correction" in fit.score.parts else fit.score_at_estimates
    return score.plus("initial conditions", initial_conditions(fit, integrated=True))


def initial_conditions(fit: Fit, integrated: bool) -> float:
    """Return minus twice the log prior of initial states and rates, with variances s^2.

    If they are `integrated` under the priors of the mesh, it is relative to these.
    """
    problem, states, penalty = fit.problem, len(fit.problem.noise), 0.0
    variances = start_variances(problem.trials, [curve for of_object in problem.smoothed for curve in of_object])
    latent = problem.trials.schema.is_latent
    is_free = ~np.append(latent, latent[with_rates(problem.order, states)])
    variances = np.where(is_free, variances, 1.0)
    for model, estimate in zip(problem.models, fit.estimates, strict=True):
        for mesh, states_of_mesh, _ in model.parts(estimate):
            starts = states_of_mesh[mesh.first, : model.width]
            vague = np.append(~mesh.observed[mesh.first], np.ones_like(starts[:, states:], dtype=bool), axis=1)
            of_mesh = np.log(np.where(vague & integrated, prior_variances(model, mesh), 1.0))
            logs = np.log(variances) - of_mesh
            logs[:, states:] += starts[:, states:] ** 2 / variances[states:]
            penalty += float(np.sum(logs[:, is_free]))
    return penalty
