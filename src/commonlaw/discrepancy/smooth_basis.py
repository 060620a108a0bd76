"""Smooth functions: their basis, the coordinates they depend on, and what is probable of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.library import Term, Variables, parse_term
from commonlaw.runtime.forking import cached_property


@dataclass(frozen=True)
class SmoothBasis:
    """Functions that span the smooth functions of a coordinate between `low` and `high`.

    The coordinate is an expression over the variables of a law, and `times` a term that the functions are multiplied
    with. So many `bumps` are in the visited range: what is narrower is no smooth function.
    """

    coordinate: str
    times: str
    low: float
    high: float
    bumps: int = 6

    @property
    def range(self) -> float:
        """How far the visited values reach."""
        return self.high - self.low

    @property
    def width(self) -> float:
        """The standard deviation of a bump."""
        return self.range / self.bumps

    @cached_property
    def knots(self) -> Floats:
        """Where the bumps are: in the visited range, and as far beyond it on both sides, shape (bumps,)."""
        return np.linspace(self.low - self.range, self.high + self.range, 3 * self.bumps + 1)

    @property
    def centre(self) -> float:
        """The middle of the range."""
        return (self.low + self.high) / 2

    def __len__(self) -> int:
        return len(self.knots) + 1

    def terms(self, variables: Variables) -> tuple[Term, ...]:
        """Return the functions as terms, times what they are multiplied with: the line, then the bumps."""
        coordinate = f"({self.coordinate})"
        bumps = (f"exp(-(({coordinate} - ({knot!r}))/{self.width!r})**2/2)" for knot in self.knots.tolist())
        texts = (f"({coordinate} - ({self.centre!r}))", *bumps)
        return tuple(parse_term(f"({self.times})*{text}", variables) for text in texts)

    def values(self, coordinate: Floats) -> Floats:
        """Return the functions, without what they are multiplied with, shape (n, functions)."""
        bumps = np.exp(-(((coordinate[:, np.newaxis] - self.knots) / self.width) ** 2) / 2)
        return np.column_stack([coordinate - self.centre, bumps])


_REPRESENTED = 0.05
"""Share of a function, or of a term, below which what the others leave of it is nothing."""

_RESOLVED = 1e-6
"""Singular values below this share of the largest tell nothing."""


def factors(basis: SmoothBasis, constraints: Floats, lengths: Sequence[float] = (0.5, 1.0, 2.0)) -> list[Floats]:
    """Return factors of the prior covariance of the weights, one for each length scale over which they are correlated.

    Lengths are in units of the visited range.

    The sum of the bumps has variance one, and so has the line at both ends of twice the visited range. Linear
    combinations of the weights, shape (constraints, functions), are zero.
    """
    result, bumps = list[Floats](), basis.values(np.array([basis.centre]))[0, 1:]
    distances = np.subtract.outer(basis.knots, basis.knots) / basis.range
    for length in lengths:
        covariance = np.zeros((len(basis), len(basis)))
        covariance[1:, 1:] = np.exp(-((distances / length) ** 2) / 2)
        covariance /= bumps @ covariance[1:, 1:] @ bumps
        covariance[0, 0] = 1 / basis.range**2
        if len(constraints):
            across = covariance @ constraints.T
            inner = np.linalg.pinv(constraints @ across, rcond=1e-10, hermitian=True)
            covariance = covariance - across @ inner @ across.T
        values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
        kept = values > 1e-9 * values[-1]
        result.append(np.asarray(vectors[:, kept] * np.sqrt(values[kept])))
    return result


class Samples(NamedTuple):
    """Of one object the coordinate, what the function is multiplied with, shape (n,), and terms, shape (n, terms)."""

    coordinate: Floats
    times: Floats
    terms: Floats


class Meaning(NamedTuple):
    """Constraints on the weights, shape (constraints, functions), the zero, and terms orthogonal to the function."""

    constraints: Floats
    zero_at: float | None
    held: tuple[int, ...]


def meaning(basis: SmoothBasis, samples: Sequence[Samples], zero_at: float | None) -> Meaning:
    """Return the constraints that leave a law's coefficients identifiable with a function of a coordinate.

    Both can represent functions of the coordinate that are combinations of the law's terms on each object. At `zero_at`
    the law alone holds, and the function is orthogonal, over the samples, to such combinations that vanish there too;
    without that point to all of them.
    """
    blocks = [basis.values(sample.coordinate) * sample.times[:, np.newaxis] for sample in samples]
    whole = np.concatenate(blocks)
    vectors, singular, right = np.linalg.svd(whole, full_matrices=False)
    resolved = singular > _RESOLVED * singular[0]
    parts = np.split(vectors[:, resolved], np.cumsum([len(block) for block in blocks])[:-1])
    rests = [part - _said(sample.terms, part) for part, sample in zip(parts, samples, strict=True)]
    _, sizes, directions = np.linalg.svd(np.concatenate(rests), full_matrices=False)
    both = directions[sizes < _REPRESENTED]
    weights = (both / singular[resolved]) @ right[resolved]
    constraints = both @ vectors[:, resolved].T @ whole
    pairs, first = list(zip(samples, blocks, strict=True)), samples[0]
    count = first.terms.shape[1]
    held = [k for k in range(count) if all(_is_said(sample.terms[:, k], part) for sample, part in pairs)]
    at = basis.values(np.array([0.0 if zero_at is None else zero_at]))
    there = (at @ weights.T)[0]
    everywhere = np.concatenate([sample.coordinate for sample in samples])
    largest = np.abs(basis.values(everywhere) @ weights.T).max(initial=0.0)
    if zero_at is None or not np.any(np.abs(there) > 0.05 * largest):
        return Meaning(constraints, None, tuple(held))
    from scipy.linalg import null_space

    kept = null_space(there[np.newaxis]).T @ constraints
    solution = np.linalg.lstsq(blocks[0], first.terms[:, held], rcond=_RESOLVED)[0]
    # More coarsely, as these functions are known from one object only
    alive = np.abs(at @ solution)[0] >= 0.3 * np.abs(basis.values(first.coordinate) @ solution).max(axis=0)
    vanishing = [k for k, living in zip(held, alive, strict=True) if not living]
    return Meaning(np.concatenate([at, kept]), zero_at, tuple(vanishing))


def _said(terms: Floats, values: Floats) -> Floats:
    """Return what terms, shape (n, terms), say of values, shape (n, columns), at best."""
    scale = np.linalg.norm(terms, axis=0)
    relative = terms / np.where(scale > 0, scale, 1.0)
    return np.asarray(relative @ np.linalg.lstsq(relative, values, rcond=_RESOLVED)[0])


def _is_said(term: Floats, functions: Floats) -> bool:
    """Return whether functions of the coordinate, shape (n, functions), can say a term, shape (n,)."""
    rest = term - functions @ np.linalg.lstsq(functions, term, rcond=_RESOLVED)[0]
    return bool(np.linalg.norm(rest) < _REPRESENTED * np.linalg.norm(term))
