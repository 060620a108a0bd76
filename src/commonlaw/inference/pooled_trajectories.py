"""Whether coefficients that are drawn to their means over objects still describe the trajectories.

The evidence takes laws to be linear about each object's fit. Where constants inside of terms are known to a quarter of
themselves, say, coefficients that would be alike by that may be far from any that describe the measurements.
"""

from dataclasses import replace

import numpy as np

from commonlaw.hierarchy import shrink
from commonlaw.inference.search import fit_with
from commonlaw.inference.search_problem import SearchProblem
from commonlaw.inference.search_state import NO_ERROR, SearchState, evidence_about
from commonlaw.likelihood import Prior

_FIXED = 1e8
"""Information on coefficients that are held, relative to that of the trials."""


def missed_by_pooling(problem: SearchProblem, state: SearchState) -> float:
    """Return by how much twice the log-likelihood of pooled coefficients is less than if the law were linear in them.

    It is zero where that is more, and for a single object. The problem is without errors of the law.

    Raises
    ------
    NotPositiveError
        If there are no trajectories with these coefficients, or trials do not tell coefficients apart.
    """
    if len(state.estimates) == 1 or not problem.models[0].terms.constants:
        return 0.0
    chosen = np.flatnonzero(state.supports)
    factors = np.array([each.factor for each in evidence_about(problem, state).problems])
    columns, targets = factors[:, :, chosen], factors[:, :, -1:]
    reduced = np.asarray(np.linalg.qr(factors[:, :, np.append(chosen, -1)], mode="r"))
    inverse = np.linalg.inv(reduced[:, : len(chosen), : len(chosen)])
    own = np.matmul(inverse, reduced[:, : len(chosen), -1:])[..., 0]
    pooled = shrink(own, np.matmul(inverse, inverse.transpose(0, 2, 1)), np.full(len(chosen), np.nan)).estimates
    typical = np.zeros((len(pooled), *state.supports.shape))
    precision = np.zeros_like(typical)
    typical[:, state.supports] = pooled
    precision[:, state.supports] = _FIXED * np.sum(columns**2, axis=1)
    held = zip(problem.models, map(Prior, typical, precision), strict=True)
    drawn = replace(problem, models=tuple(replace(model, prior=prior) for model, prior in held))
    begun = [replace(each, coefficients=values) for each, values in zip(state.estimates, typical, strict=True)]
    there = fit_with(drawn, state.supports, NO_ERROR, begun).estimates
    found = np.array([each.coefficients[state.supports] for each in state.estimates])
    left = [np.matmul(columns, each[..., np.newaxis]) - targets for each in (pooled, found)]
    linear = np.sum(left[0] ** 2, axis=(1, 2)) - np.sum(left[1] ** 2, axis=(1, 2))
    exact = [far.deviance - near.deviance for far, near in zip(there, state.estimates, strict=True)]
    return float(np.sum(np.maximum(exact - linear, 0.0)))
