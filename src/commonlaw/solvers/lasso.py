"""LASSO and group LASSO, followed by least squares on what they choose."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.runtime.arguments import check_number, check_whole_number
from commonlaw.solvers.base import (
    AbstractSolver,
    Candidate,
    Candidates,
    Problems,
    StandardizedProblem,
    Values,
    check_shared,
    each_support_once,
    groups,
    least_squares,
)

_PENALTIES = np.geomspace(1.0, 1e-4, 41)


@dataclass(frozen=True)
class Lasso(AbstractSolver):
    """Least squares with a penalty on the norm of each term's coefficients over the objects, then a refit.

    The group LASSO of Yuan and Lin (2006), J. R. Statist. Soc. B 68, 49, with a term's coefficients in all objects as a
    group; for one object, or own terms, the LASSO of Tibshirani (1996). Columns have unit norm and objects count
    relative to their residual variance, see `StandardizedProblem`. The minimum is found by accelerated proximal
    gradient steps with restarts (Beck and Teboulle 2009; O'Donoghue and Candès 2015), warm-started along falling
    penalties.

    Raises `CommonlawError` if an argument does not fit.

    Parameters
    ----------
    penalty
        As a share of the smallest penalty that removes every term, from 0 (all terms) to 1 (none); None to have it
        chosen.
    shared
        Whether all objects have the same terms, or each object its own.
    max_iterations
        At most so many steps for each penalty.
    tolerance
        Largest step, relative to the largest coefficient, at convergence.
    """

    penalty: float | None = None
    shared: bool = True
    max_iterations: int = 2000
    tolerance: float = 1e-7

    hyperparameter_name = "penalty"

    def __post_init__(self) -> None:
        check_number("penalty", self.penalty, 0, optional=True)
        check_whole_number("max_iterations", self.max_iterations, 1)
        check_number("tolerance", self.tolerance, 0, above=True)
        check_shared(self.shared)

    def path(self, problems: Problems, target: int, allowed: Bools, values: Values = None) -> Candidates:
        wanted = [0.0, *reversed(_PENALTIES)] if values is None else values
        # Larger penalties come first: the minimum of each is where the search for the next begins
        penalties = sorted({*_PENALTIES[min(wanted) < _PENALTIES], *wanted}, reverse=True)
        by_group = [self._candidates(group, target, allowed, penalties) for group in groups(problems, self.shared)]
        by_penalty = {parts[0].hyperparameter: Candidate.join(parts) for parts in zip(*by_group, strict=True)}
        path = tuple(by_penalty[value] for value in wanted)
        return each_support_once(path) if values is None else path

    def _candidates(self, problems: Problems, target: int, allowed: Bools, penalties: Sequence[float]) -> Candidates:
        standardized = StandardizedProblem.of(problems, target, allowed)
        gram = np.matmul(standardized.columns.transpose(0, 2, 1), standardized.columns)
        right = np.einsum("oqt,oq->ot", standardized.columns, standardized.right)
        most = np.linalg.norm(right, axis=0).max(initial=0.0) * (1 + 1e-12)
        result: list[Candidate] = []
        minimum = np.zeros_like(right)
        for penalty in penalties:
            support, converged = allowed.copy(), True
            if penalty > 0:
                minimum, converged = minimize(gram, right, penalty * most, minimum, self.max_iterations, self.tolerance)
                support[allowed] = minimum.any(axis=0)
            supports = np.repeat(support[np.newaxis], len(problems), axis=0)
            same = bool(result) and np.array_equal(result[-1].support, supports)
            coefficients = result[-1].coefficients if same else least_squares(problems, target, supports)
            result.append(Candidate(supports, coefficients, float(penalty), converged=converged, largest=1.0))
        return tuple(result)


def minimize(
    gram: Floats, right: Floats, penalty: float, start: Floats, max_iterations: int, tolerance: float
) -> tuple[Floats, bool]:
    """Return the minimum of ``sum_o (b_o' G_o b_o / 2 - r_o' b_o) + penalty sum_t ||b_t||``, and if it was reached.

    G has shape (objects, terms, terms); r, the first guess and the minimum (objects, terms).
    """
    # scikit-learn's MultiTaskLasso has one matrix of columns for all targets; here each object has its own
    rate = 1 / max(np.linalg.eigvalsh(gram)[:, -1:].max(initial=0.0), 1e-300)
    now, ahead, momentum = start, start, 1.0
    for _ in range(max_iterations):
        moved = ahead - rate * (np.matmul(gram, ahead[..., np.newaxis])[..., 0] - right)
        norms = np.sqrt(np.einsum("ot,ot->t", moved, moved))
        shrink = np.maximum(1 - np.divide(rate * penalty, norms, out=np.ones_like(norms), where=norms > 0), 0.0)
        following = moved * shrink
        step = following - now
        if np.abs(following - ahead).max(initial=0.0) <= tolerance * rate * np.abs(following).max(initial=0.0):
            return following, True
        # Momentum that points uphill is dropped.
        faster = 1.0 if np.sum((ahead - following) * step) > 0 else (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        ahead = following + ((momentum - 1) / faster if faster > 1 else 0.0) * step
        now, momentum = following, faster
    return now, False
