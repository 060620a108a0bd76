"""What else an equation might have been."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Alternative:
    """One of the candidates that an equation was chosen from.

    Parameters
    ----------
    equation
        The left-hand side.
    terms
        The terms that some object has.
    measures
        What speaks for it by name (criteria, held-out error and its standard error, stability); None where a measure
        is not to be had.
    proven
        Whether no other support of its size fits better.
    chosen
        Whether it is the law.
    hyperparameters
        The values of the solver's hyperparameter (threshold, penalty, number of terms) at which its segments of the
        path begin; none if candidates of several solvers were compared.
    """

    equation: str
    terms: tuple[str, ...]
    measures: Mapping[str, float | None]
    proven: bool
    chosen: bool
    hyperparameters: tuple[float, ...] = ()


def path_segments(alternatives: Sequence[Alternative]) -> Iterator[tuple[float, float, Alternative]]:
    """Yield the segments of a solver's path and what each gives, from the smallest value of its hyperparameter.

    Parameters
    ----------
    alternatives
        Those of one equation.

    Yields
    ------
    tuple
        Where the segment begins, where it ends (the last has no end), and the candidate.
    """
    begins = sorted((value, i) for i, each in enumerate(alternatives) for value in each.hyperparameters)
    turns = [pair for k, pair in enumerate(begins) if k == 0 or begins[k - 1][1] != pair[1]]
    ends = [*(begin for begin, _ in turns[1:]), math.inf]
    for (begin, i), end in zip(turns, ends, strict=False):
        yield begin, end, alternatives[i]
