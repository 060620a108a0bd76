"""What every solver is."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from commonlaw.formulation import System

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Fit:
    """What a solver returns.

    Parameters
    ----------
    coefficients
        Shape (objects, equations, terms); exactly zero outside the support.
    support
        Which terms are in, shape (objects, equations, terms).
    largest
        The largest value that the threshold was compared with in the last sweep that had a term, for each object and
        equation, shape (objects, equations); a support that is empty had a threshold above it.
    converged
        Whether the support was stable when the solver stopped.
    """

    coefficients: Floats
    support: Bools
    largest: Floats
    converged: bool


class AbstractSolver(ABC):
    """From one system per object to sparse coefficients. Solvers see systems only: no times and no names."""

    @abstractmethod
    def solve(self, systems: Sequence[System], candidates: Bools) -> Fit:
        """Return the coefficients of the terms that matter.

        Parameters
        ----------
        systems
            One for each object, all of the same library.
        candidates
            Which terms may enter which equation, shape (equations, terms).
        """
