"""LASSO and group LASSO, followed by least squares on what they choose."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.formulation import LeastSquaresProblem
from commonlaw.solvers.base import AbstractSolver, Candidate, Fit
from commonlaw.solvers.settings import check_setting, check_shared
from commonlaw.solvers.sized import fit_of, refit
from commonlaw.solvers.stack import Stack

_PENALTIES = np.geomspace(1.0, 1e-4, 41)


@dataclass(frozen=True)
class Lasso(AbstractSolver):
    """Least squares with a penalty on the norm of each term's coefficients over the objects, then a refit.

    The group LASSO of Yuan and Lin (2006), J. R. Statist. Soc. B 68, 49, where a term's coefficients in all objects
    make a group; for one object, and where each object has its own terms, the LASSO of Tibshirani (1996). Columns have
    unit norm and objects count relative to their residual variance, see `Stack`. The minimum is found by accelerated
    proximal gradient steps with restarts (Beck and Teboulle 2009; O'Donoghue and Candès 2015) that start from the
    minimum of the next larger penalty; its nonzero terms are the support, for which least squares is solved.

    Parameters
    ----------
    penalty
        As a share of the smallest penalty that removes every term, so from 0 (all terms) to 1 (none); None to have it
        chosen.
    shared
        Whether all objects have the same terms, or each object its own.
    max_iterations
        At most so many steps for each penalty.
    tolerance
        Largest step, relative to the largest coefficient, at which the minimum counts as reached.
    """

    penalty: float | None = None
    shared: bool = True
    max_iterations: int = 2000
    tolerance: float = 1e-7

    def __post_init__(self) -> None:
        check_setting("penalty", self.penalty, 0, optional=True)
        check_setting("max_iterations", self.max_iterations, 1, whole=True)
        check_setting("tolerance", self.tolerance, 0, above=True)
        check_shared(self.shared)

    @property
    def is_set(self) -> bool:
        return self.penalty is not None

    def solve(self, problems: Sequence[LeastSquaresProblem], candidates: Bools) -> Fit:
        """Return the terms that the penalty leaves, and their least-squares coefficients.

        Raises
        ------
        CommonlawError
            If there is no penalty.
        """
        if self.penalty is None:
            raise CommonlawError("the solver has no penalty: give it one, or let one be chosen from its path")
        penalties = [*_PENALTIES[self.penalty < _PENALTIES], self.penalty]
        chosen, converged = [], True
        for target, allowed in enumerate(candidates):
            supports, reached = self._supports(problems, target, allowed, penalties)
            chosen.append(refit(problems, target, supports[-1], self.penalty))
            converged &= bool(reached[-1])
        return fit_of(chosen, np.ones((len(problems), len(candidates))), converged)

    def path(self, problems: Sequence[LeastSquaresProblem], target: int, allowed: Bools) -> tuple[Candidate, ...]:
        """Return the equations of a geometric row of penalties, from 0 to 1, each support once in a row."""
        penalties = [*_PENALTIES, 0.0]
        supports, _ = self._supports(problems, target, allowed, penalties)
        found: list[Candidate] = []
        for penalty, support in reversed([*zip(penalties, supports, strict=True)]):
            if not found or not np.array_equal(found[-1].support[: len(support)], support):
                found.append(refit(problems, target, support, float(penalty)))
        return tuple(found)

    def _supports(
        self, problems: Sequence[LeastSquaresProblem], target: int, allowed: Bools, penalties: Sequence[float]
    ) -> tuple[Bools, Bools]:
        """Return the supports, shape (penalties, objects or 1, terms), and whether each minimum was reached."""
        groups = [problems] if self.shared else [[problem] for problem in problems]
        supports = np.zeros((len(penalties), len(groups), len(allowed)), dtype=bool)
        reached = np.ones(len(penalties), dtype=bool)
        for index, group in enumerate(groups):
            stack = Stack.of(group, target, allowed)
            gram = np.matmul(stack.columns.transpose(0, 2, 1), stack.columns)
            right = np.einsum("oqt,oq->ot", stack.columns, stack.right)
            minimum = np.zeros_like(right)
            for step, penalty in enumerate(penalties):
                if penalty == 0:
                    supports[step, index] = allowed
                    continue
                absolute = penalty * np.linalg.norm(right, axis=0).max(initial=0.0) * (1 + 1e-12)
                minimum, done = minimize(gram, right, absolute, minimum, self.max_iterations, self.tolerance)
                supports[step, index, allowed] = minimum.any(axis=0)
                reached[step] &= done
        return supports, reached


def minimize(
    gram: Floats, right: Floats, penalty: float, start: Floats, max_iterations: int, tolerance: float
) -> tuple[Floats, bool]:
    """Return what minimises ``sum_o (b_o' G_o b_o / 2 - r_o' b_o) + penalty sum_t ||b_t||``.

    Parameters
    ----------
    gram
        G, shape (objects, terms, terms).
    right
        r, shape (objects, terms).
    penalty
        Weight of the norms.
    start
        First guess, shape (objects, terms).
    max_iterations, tolerance
        As in `Lasso`.

    Returns
    -------
    tuple[Floats, bool]
        The minimum, shape (objects, terms), and whether it was reached.
    """
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
