"""Solvers whose hyperparameter is the number of terms."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools, Indices
from commonlaw.solvers.base import groups
from commonlaw.solvers.candidate import Candidate, Problems, least_squares
from commonlaw.solvers.standardized_problem import StandardizedProblem


@dataclass(frozen=True, eq=False)
class Subset:
    """The indices of the terms that were chosen, among those allowed.

    Parameters
    ----------
    indices
        Of the terms.
    proven
        Whether they are proved to be the best of their number.
    converged
        Whether the search for them came to its end.
    """

    indices: Indices
    proven: bool = False
    converged: bool = True


def fixed_cardinality(
    choose: Callable[[StandardizedProblem, Sequence[int]], Mapping[int, Subset]],
    shared: bool,
    problems: Problems,
    target: int,
    allowed: Bools,
    values: Sequence[float] | None = None,
) -> tuple[Candidate, ...]:
    """Return one candidate for each number of terms, or with all allowed terms where these are fewer.

    Parameters
    ----------
    choose
        From the problem of objects that have one support, and numbers of terms, to the subset for each number.
    shared
        Whether one choice is made for all objects, or each object's own, of equal number.
    problems, target, allowed, values
        As in `AbstractSolver.path`; without values, every number from all to none.
    """
    most = int(allowed.sum())
    sizes = range(most, -1, -1) if values is None else [min(int(value), most) for value in values]

    def candidates(group: Problems) -> list[Candidate]:
        chosen = choose(StandardizedProblem.of(group, target, allowed), sizes)
        return [candidate(group, size, chosen[size]) for size in sizes]

    def candidate(group: Problems, size: int, chosen: Subset) -> Candidate:
        support = np.zeros((len(group), len(allowed)), dtype=bool)
        support[:, np.flatnonzero(allowed)[chosen.indices]] = True
        found = least_squares(group, target, support)
        return Candidate(support, found, float(size), chosen.proven, chosen.converged, float(most))

    by_group = [candidates(group) for group in groups(problems, shared)]
    return tuple(Candidate.join(own) for own in zip(*by_group, strict=True))
