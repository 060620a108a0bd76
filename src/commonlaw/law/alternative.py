"""What else an equation might have been."""

from collections.abc import Mapping
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
    """

    equation: str
    terms: tuple[str, ...]
    measures: Mapping[str, float | None]
    proven: bool
    chosen: bool
