"""The supports of all equations together, from systems whose columns are the terms of one equation after the other."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from commonlaw.formulation import System
from commonlaw.selection.pooled import log_choices, log_evidence
from commonlaw.solvers import AbstractSolver

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Places = NDArray[np.intp]

MOST_TERMS = 20
"""Equations of more terms are not laws that anybody can read."""

SAMPLES_FOR_A_TERM = 10
"""An object needs so many samples for each term of an equation; with fewer, terms follow the noise."""

_SWEEPS = 4
"""How often each equation is chosen again, given the others."""


@dataclass(frozen=True, eq=False)
class Joint:
    """The likelihood of all equations of all objects.

    Parameters
    ----------
    systems
        One for each object, of unit variance: columns are all terms of the first equation, then of the second, ...
    allowed
        Which terms may enter which equation, shape (equations, terms).
    measured
        How many numbers were measured.
    solver
        Whose path lists the candidates of one equation.
    most
        No equation has more terms.
    """

    systems: Sequence[System]
    allowed: Bools
    measured: int
    solver: AbstractSolver
    most: int = MOST_TERMS

    def choose(self, start: Bools) -> Bools:
        """Return the supports with the largest evidence that are found by choosing one equation after the other.

        Parameters
        ----------
        start
            Supports to begin with, shape (equations, terms): each equation is chosen with those of the others free.
        """
        supports = start.copy()
        for _ in range(_SWEEPS):
            before = supports.copy()
            for j in range(len(supports)):
                supports[j] = self._equation(supports, j)
            if np.array_equal(before, supports):
                break
        return supports

    def value(self, supports: Bools) -> float:
        """Return minus twice the log-evidence of supports of all equations, with what choosing them costs."""
        evidence = log_evidence(self.systems, np.flatnonzero(supports), self.measured)
        sizes = zip(self.allowed.sum(axis=1), supports.sum(axis=1), strict=True)
        return evidence + sum(2 * log_choices(int(library), int(size)) for library, size in sizes)

    def rivals(self, supports: Bools) -> list[list[tuple[Bools, float]]]:
        """Return for each equation the chosen support and those that differ by one term or an exchange of two.

        Each with minus twice its log-evidence above that of the chosen one, the best first; the other equations keep
        their supports.
        """
        found = []
        for j, chosen in enumerate(supports):
            scores = _Scores(self._alone(supports, j), self.measured)
            listed = [chosen, *_neighbours(chosen, self.allowed[j])]
            pairs = [(each, scores.of(each) - scores.of(chosen)) for each in listed]
            found.append(sorted(pairs, key=lambda pair: pair[1]))
        return found

    def coefficients(self, supports: Bools) -> Floats:
        """Return each object's least-squares coefficients, shape (objects, equations, terms)."""
        found = [system.least_squares(supports.ravel(), 0) for system in self.systems]
        return np.array(found).reshape(len(self.systems), *supports.shape)

    def _equation(self, supports: Bools, equation: int) -> Bools:
        """Return the support of one equation, the others' being given."""
        scores = _Scores(self._alone(supports, equation), self.measured)
        allowed = self.allowed[equation]
        path = self.solver.path(scores.systems, 0, allowed)
        listed: list[Bools] = [np.zeros_like(allowed), *(np.asarray(each.support.any(axis=0)) for each in path)]
        if not np.array_equal(supports[equation], allowed):
            listed.append(supports[equation])
        best = scores.best([each for each in listed if each.sum() <= self.most])
        while True:
            better = scores.best([best, *(each for each in _neighbours(best, allowed) if each.sum() <= self.most)])
            if better is best:
                return best
            best = better

    def _alone(self, supports: Bools, equation: int) -> list[System]:
        """Return the systems of one equation, with what the terms of the others explain taken out."""
        terms = supports.shape[1]
        mine = np.arange(equation * terms, (equation + 1) * terms)
        others = np.setdiff1d(np.flatnonzero(supports), mine)
        columns = [*others, *mine, supports.size]
        found = []
        for system in self.systems:
            factor = np.asarray(np.linalg.qr(system.factor[:, columns], mode="r"))
            found.append(System(np.asfortranarray(factor[len(others) :, len(others) :]), terms, system.rows))
        return found


@dataclass(frozen=True, eq=False)
class _Scores:
    """What supports of one equation are worth; each is computed once."""

    systems: Sequence[System]
    measured: int
    known: dict[bytes, float] = field(default_factory=dict)

    def best(self, supports: Sequence[Bools]) -> Bools:
        """Return the best of some supports."""
        return supports[int(np.argmin([self.of(each) for each in supports]))]

    def of(self, support: Bools) -> float:
        """Return minus twice the log-evidence of a support, with what choosing it costs."""
        key = support.tobytes()
        if key not in self.known:
            choices = log_choices(len(support), int(support.sum()))
            self.known[key] = log_evidence(self.systems, np.flatnonzero(support), self.measured) + 2 * choices
        return self.known[key]


def _neighbours(support: Bools, allowed: Bools) -> list[Bools]:
    """Return the supports with one term more, less, or exchanged."""
    inside, outside = np.flatnonzero(support), np.flatnonzero(allowed & ~support)
    moves: list[tuple[list[int], list[int]]] = [([int(i)], []) for i in inside]
    moves += [([], [int(o)]) for o in outside]
    moves += [([int(i)], [int(o)]) for i in inside for o in outside]
    found = []
    for leaving, entering in moves:
        changed = support.copy()
        changed[leaving], changed[entering] = False, True
        found.append(changed)
    return found
