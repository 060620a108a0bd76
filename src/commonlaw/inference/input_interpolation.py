"""The interpolation of inputs between samples, by the evidence of a law under each."""

from contextlib import suppress
from dataclasses import replace

from commonlaw.errors import CommonlawError
from commonlaw.inference.search import STRONG, fit_supports
from commonlaw.inference.search_problem import SearchProblem
from commonlaw.inference.search_state import ANY_ERROR, SearchState
from commonlaw.integration import BETWEEN
from commonlaw.law import Step
from commonlaw.likelihood import meshes
from commonlaw.trials import Trials


def with_interpolation(trials: Trials, input_between: str) -> Trials:
    """Return trials with an interpolation of inputs between samples."""
    return replace(trials, schema=replace(trials.schema, input_between=input_between))


def best_interpolation(problem: SearchProblem, state: SearchState) -> Step:
    """Return the interpolation of inputs of largest evidence, for the supports that were found.

    That of the problem stays unless the evidence for another is strong.
    """
    before = problem.trials.schema.input_between
    gains = {}
    for between in BETWEEN:
        if between != before:
            with suppress(CommonlawError):
                gains[between] = state.value - _fitted_with(problem, state, between).value
    best = max(gains, key=lambda each: gains[each], default=before)
    if gains and gains[best] > STRONG:
        why = f"between samples: twice the log Bayes factor (2 log B) for it against {before} is {gains[best]:.3g}"
        return Step("inputs", best, why)
    return Step("inputs", before, "between samples: the evidence for no other interpolation is strong")


def _fitted_with(problem: SearchProblem, state: SearchState, between: str) -> SearchState:
    """Return the supports of a state fitted with another interpolation of inputs."""
    groups = [problem.trials.of_object(name) for name in problem.trials.objects]
    models = tuple(
        replace(model, meshes=meshes(group, problem.points, input_between=between))
        for model, group in zip(problem.models, groups, strict=True)
    )
    changed = replace(problem, trials=with_interpolation(problem.trials, between), models=models)
    changed = changed.with_errors(problem.noise, problem.errors, problem.noise_reason)
    return fit_supports(changed, state.supports, ANY_ERROR)
