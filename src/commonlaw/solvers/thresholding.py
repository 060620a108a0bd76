"""The sweep that sequentially thresholded least squares repeats."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from commonlaw.formulation import System
from commonlaw.solvers.base import Fit

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def threshold_sequentially(
    systems: Sequence[System],
    candidates: Bools,
    keep: Callable[[Floats], tuple[Bools, Floats]],
    *,
    ridge: float,
    max_iterations: int,
    normalize: bool,
) -> Fit:
    """Alternate least squares and thresholding until the support is stable.

    Parameters
    ----------
    systems
        One for each object.
    candidates
        Which terms may enter which equation, shape (equations, terms).
    keep
        From coefficient magnitudes, shape (objects, equations, terms), to which terms stay, and to the largest
        value that was compared with the threshold, shape (objects, equations).
    ridge, max_iterations, normalize
        As in the solvers.
    """
    support = np.repeat(candidates[np.newaxis], len(systems), axis=0)
    norms = np.array([system.norms for system in systems])[:, np.newaxis] if normalize else 1.0
    largest = np.zeros(support.shape[:2])
    for _ in range(max_iterations):
        coefficients = _least_squares(systems, support, ridge)
        stays, values = keep(np.abs(coefficients) * norms)
        largest = np.where(support.any(axis=2), values, largest)
        kept = support & stays
        if np.array_equal(kept, support):
            return Fit(coefficients, support, largest, converged=True)
        support = kept
    return Fit(_least_squares(systems, support, ridge), support, largest, converged=False)


def _least_squares(systems: Sequence[System], support: Bools, ridge: float) -> Floats:
    """Return coefficients, shape (objects, equations, terms), of every object's own least squares."""
    return np.array(
        [
            [system.least_squares(terms, target, ridge) for target, terms in enumerate(of_object)]
            for system, of_object in zip(systems, support, strict=True)
        ]
    )
