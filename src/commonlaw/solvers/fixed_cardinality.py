"""Solvers whose hyperparameter is the number of terms."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools, Indices
from commonlaw.solvers.base import groups
from commonlaw.solvers.candidate import Candidate, Candidates, Problems, Values, least_squares
from commonlaw.solvers.standardized_problem import StandardizedProblem


@dataclass(frozen=True, eq=False)
class Subset:
    """The indices of the terms that were chosen, among those allowed; see `Candidate` for the rest."""

    indices: Indices
    proven: bool = False
    converged: bool = True


def fixed_cardinality(
    choose: Callable[[StandardizedProblem, Sequence[int]], Mapping[int, Subset]],
    shared: bool,
    problems: Problems,
    target: int,
    allowed: Bools,
    values: Values,
) -> Candidates:
    """Return one candidate for each number of terms, or with all allowed terms where these are fewer.

    From the problem of objects that have one support, `choose` makes the subset for each of some numbers of terms.
    Without values these are all numbers from all to none. Objects with own supports have as many terms each.
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
