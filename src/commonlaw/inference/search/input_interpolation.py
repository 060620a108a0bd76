"""The interpolation of inputs between samples: by what these leave out, then by the evidence of a law under each."""

from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import fit_supports
from commonlaw.inference.fit.fit import ANY_ERROR, Fit
from commonlaw.integration import BETWEEN
from commonlaw.law import Step
from commonlaw.likelihood import meshes
from commonlaw.trials import Trial, Trials


def with_interpolation(trials: Trials, input_between: str) -> Trials:
    """Return trials with an interpolation of inputs between samples."""
    return replace(trials, schema=replace(trials.schema, input_between=input_between))


def supported_interpolation(trials: Trials) -> str:
    """Return the interpolation that the samples of the inputs support: linear, or cubic if all that vary are smooth.

    Each sample is left out and interpolated by its two neighbours, u_i ~ sum_j u_j prod_k (t_i - t_k)/(t_j - t_k), or
    by four. A fit alone does not show that chords are shallower than the input: the gain makes up for it.
    """
    squares = np.sum([_left_out(trial) for trial in trials], axis=0)
    bent = squares[0] > np.finfo(float).eps * np.sum([np.sum(each.inputs**2, axis=0) for each in trials], axis=0)
    return "cubic" if bent.any() and (squares[0] > settings.MIN_SMOOTHNESS * squares[1])[bent].all() else "linear"


def _left_out(trial: Trial) -> Floats:
    """Return the sums of squared leave-one-out errors of straight lines and cubics, shape (2, inputs)."""
    middle = np.arange(2, len(trial) - 2)
    found = []
    for steps in ((-1, 1), (-2, -1, 1, 2)):
        ahead = [trial.times[middle + step] - trial.times[middle] for step in steps]
        weights = [np.prod([b / (b - a) for b in ahead if b is not a], axis=0) for a in ahead]
        by_others = sum(w[:, np.newaxis] * trial.inputs[middle + step] for w, step in zip(weights, steps, strict=True))
        found.append(np.sum((trial.inputs[middle] - by_others) ** 2, axis=0))
    return np.array(found)


def best_interpolation(fit: Fit, is_chosen: bool) -> Step:
    """Return the interpolation of inputs of largest evidence, for the supports that were found.

    That of the fit stays unless the evidence for another is strong; where laws of plain terms chose it, without a lack
    of fit of the law with the other.
    """
    before, gains = fit.problem.trials.schema.input_between, dict[str, float]()
    for other in (_fitted_with(fit, each) for each in BETWEEN if each != before):
        gain = fit.score - other.score
        if gain > settings.STRONG and not (is_chosen and other.lack_of_fit):
            gains[other.problem.trials.schema.input_between] = gain
    if gains:
        best = max(gains, key=lambda each: gains[each])
        why = f"between samples: twice the log Bayes factor (2 log B) for it against {before} is {gains[best]:.3g}"
        return Step("inputs", best, why)
    why = "the evidence for no other interpolation is strong, or the law has a lack of fit with it"
    return Step("inputs", before, f"between samples: {why}")


def _fitted_with(fit: Fit, between: str) -> Fit:
    """Return the supports of a fit fitted with another interpolation of inputs."""
    problem = fit.problem
    groups = [problem.trials.of_object(name) for name in problem.trials.objects]
    models = tuple(
        replace(model, meshes=meshes(group, problem.points, input_between=between))
        for model, group in zip(problem.models, groups, strict=True)
    )
    changed = replace(problem, trials=with_interpolation(problem.trials, between), models=models)
    changed = changed.with_errors(problem.noise, problem.errors, problem.noise_reason)
    return fit_supports(changed, fit.supports, ANY_ERROR)
