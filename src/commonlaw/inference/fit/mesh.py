"""Meshes fine enough for what the states do between samples."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from commonlaw.formulation import LeastSquaresProblem
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.state import FINAL, SearchState, evidence_about
from commonlaw.likelihood import Estimate, NotPositiveError, fit_each

FINEST = 8
"""Points for each sampling step; laws that need more are not resolved by their samples."""

_RESOLVED = 1.0
"""What a finer mesh may change in twice the log-likelihood; a term is worth many times that.

Of exact measurements, of which a law leaves less than the noise that it is fitted under, squares count for more."""


def on_finer_mesh(
    problem: SearchProblem, state: SearchState, model_errors: Sequence[float]
) -> tuple[SearchProblem, SearchState] | None:
    """Return the problem and the fitted state on a finer mesh; None if it changes nothing, or if there is none."""
    if problem.points >= FINEST:
        return None
    finer = problem.finer()
    estimates = fit_each(finer.models, finer.starts_with(state.estimates), state.supports, model_errors)
    evidence = evidence_about(problem, state)
    least = min(1.0, evidence.noise_variance(state.supports))
    moved = _moved(problem, evidence.problems, state, estimates)
    if _change(problem, state.estimates, finer, estimates) + moved < _RESOLVED * least:
        return None
    others = tuple(replace(each, estimates=finer.starts_with(each.estimates)) for each in state.alternatives)
    return finer, replace(state, estimates=estimates, alternatives=others)


def until_resolved(
    problem: SearchProblem, state: SearchState, refit: Callable[[SearchProblem, SearchState], SearchState]
) -> tuple[SearchProblem, SearchState]:
    """Refit on finer meshes until these do not matter, for laws that move fast between samples.

    A law with a model error needs none.
    """
    while not state.has_model_error:
        finer = on_finer_mesh(problem, state, FINAL)
        if finer is None:
            break
        try:
            problem, state = finer[0], refit(*finer)
        except NotPositiveError:
            break
    return problem, state


def _change(
    problem: SearchProblem, coarse: Sequence[Estimate], finer: SearchProblem, fine: Sequence[Estimate]
) -> float:
    """Return the sum of squared differences between measured states on two meshes, relative to the noise."""
    total, stride = 0.0, finer.points // problem.points
    for model, one, other in zip(problem.models, coarse, fine, strict=True):
        for mesh, states, finest in zip(model.meshes, one.states, other.states, strict=True):
            change = (finest[mesh.indices_on(stride)] - states)[:, : len(problem.noise)] / problem.std_of(mesh)
            total += float(np.sum(change[mesh.observed] ** 2))
    return total


def _moved(
    problem: SearchProblem, problems: Sequence[LeastSquaresProblem], state: SearchState, fine: Sequence[Estimate]
) -> float:
    """Return the sum of squared changes of coefficients on a finer mesh, relative to how surely they are known."""
    total = 0.0
    for own, known, one, other in zip(problems, problem.known, state.estimates, fine, strict=True):
        free = state.supports & np.isnan(known)
        change = own.factor[:, np.flatnonzero(free)] @ (other.coefficients - one.coefficients)[free]
        total += float(np.sum(change**2))
    return total
