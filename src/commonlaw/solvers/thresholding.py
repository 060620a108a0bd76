"""Sequential thresholding of least-squares coefficients, and its exact path over thresholds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.formulation import LeastSquaresProblem
from commonlaw.solvers.base import Candidate, Fit


@dataclass(frozen=True, eq=False)
class Swept:
    """What thresholding one equation at one threshold comes to.

    Parameters
    ----------
    support, coefficients
        Shape (objects, terms).
    largest
        The largest value compared with the threshold in the last sweep that had a term, shape (objects,).
    next
        The smallest value that stayed in any sweep: every threshold up to it gives the same.
    converged
        Whether the support was stable at the end.
    """

    support: Bools
    coefficients: Floats
    largest: Floats
    next: float
    converged: bool


@dataclass(frozen=True)
class Thresholding:
    """Least squares and thresholding in turns.

    Parameters
    ----------
    measure
        From coefficient magnitudes, shape (objects, terms), to what is compared with the threshold, of the same shape.
    ridge, max_iterations, normalize
        As in the solvers.
    """

    measure: Callable[[Floats], Floats]
    ridge: float
    max_iterations: int
    normalize: bool

    def solve(self, problems: Sequence[LeastSquaresProblem], candidates: Bools, threshold: float | None) -> Fit:
        """Return the fit of all equations at one threshold.

        Raises
        ------
        CommonlawError
            If there is no threshold.
        """
        if threshold is None:
            raise CommonlawError("the solver has no threshold: give it one, or let one be chosen from its path")
        swept = [self._sweep(problems, target, allowed, threshold, {}) for target, allowed in enumerate(candidates)]
        return Fit(
            np.stack([each.coefficients for each in swept], axis=1),
            np.stack([each.support for each in swept], axis=1),
            np.stack([each.largest for each in swept], axis=1),
            all(each.converged for each in swept),
        )

    def path(self, problems: Sequence[LeastSquaresProblem], target: int, allowed: Bools) -> tuple[Candidate, ...]:
        """Return one candidate for every stretch of thresholds that gives the same equation, by exact breakpoints.

        A sweep decides by comparing values with the threshold. All decisions of all sweeps stay the same until the
        threshold passes the smallest value that stayed, so that value is where the next candidate begins.
        """
        found, threshold = [], 0.0
        known: dict[bytes, Floats] = {}
        while True:
            swept = self._sweep(problems, target, allowed, threshold, known)
            found.append(Candidate(swept.support, swept.coefficients, threshold))
            if not swept.support.any():
                return tuple(found)
            threshold = float(np.nextafter(swept.next, np.inf))

    def _sweep(
        self,
        problems: Sequence[LeastSquaresProblem],
        target: int,
        allowed: Bools,
        threshold: float,
        known: dict[bytes, Floats],
    ) -> Swept:
        """Return what one threshold comes to; `known` keeps the coefficients of supports met before."""
        support = np.repeat(allowed[np.newaxis], len(problems), axis=0)
        norms = np.array([problem.norms for problem in problems]) if self.normalize else 1.0
        largest, following, converged = np.zeros(len(problems)), np.inf, False
        for _ in range(self.max_iterations):
            coefficients = self._least_squares(problems, target, support, known)
            values = np.where(support, self.measure(np.abs(coefficients) * norms), 0.0)
            largest = np.where(support.any(axis=1), values.max(axis=1, initial=0.0), largest)
            kept = support & (values >= threshold)
            following = min(following, values[kept].min(initial=np.inf))
            converged = bool(np.array_equal(kept, support))
            if converged:
                break
            support = kept
        else:
            coefficients = self._least_squares(problems, target, support, known)
        return Swept(support, coefficients, largest, float(following), converged)

    def _least_squares(
        self, problems: Sequence[LeastSquaresProblem], target: int, support: Bools, known: dict[bytes, Floats]
    ) -> Floats:
        key = support.tobytes()
        if key not in known:
            rows = zip(problems, support, strict=True)
            known[key] = np.array([problem.least_squares(terms, target, self.ridge) for problem, terms in rows])
        return known[key]
