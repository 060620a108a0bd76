"""How often a term is chosen again when the data are drawn again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.formulation import LeastSquaresProblem, redrawn
from commonlaw.runtime.cluster import done_in_parts
from commonlaw.selection.cross_validation import ProblemGroups
from commonlaw.solvers import Candidate

_MAX_HELD_NUMBERS = 2**24
"""Numbers in the factors of resamples that are held at a time."""

_MAX_SENT_NUMBERS = 2**20
"""Numbers in the factors of blocks that are sent to workers, with every few resamples, at most."""

_RESAMPLES_AT_ONCE = 5
"""Resamples that are made together, whatever the number of workers, so that the law does not depend on it."""

Path = Callable[[Sequence[LeastSquaresProblem]], Sequence[Candidate]]
"""From one problem for each object to candidates, from the most terms to the fewest."""


@dataclass(frozen=True, eq=False)
class Stability:
    """The supports on a solver's path for each resample, each of shape (objects, terms)."""

    supports: tuple[tuple[Bools, ...], ...]

    def frequencies(self, size: int) -> Floats:
        """Return how often each term was chosen for each object, shape (objects, terms).

        Each resample counts its largest support of at most `size` coefficients over all objects, or no term.
        """
        small = [[support for support in path if support.sum() <= size] for path in self.supports]
        nothing = np.zeros_like(self.supports[0][0])
        return np.asarray(np.mean([max(path, key=np.sum, default=nothing) for path in small], axis=0))

    def certainty(self, support: Bools) -> float:
        """Return how often the least certain term of a support, shape (objects, terms), was among as many."""
        return float(self.frequencies(int(support.sum()))[support].min(initial=1.0))


def stability(
    groups: ProblemGroups, path: Path, n_resamples: int = 100, seed: int | np.random.Generator = 0
) -> Stability:
    """Return what a solver finds on resamples of the blocks of each object's trials.

    Stability selection (Meinshausen and Bühlmann 2010, "Stability selection") with the block bootstrap in place of
    subsamples: each object draws as many of its blocks as it has, with replacement, which keeps the correlation of
    neighbouring rows. Blocks should be short, but much longer than a smoothing window. Raises `CommonlawError` if an
    object has a single block.
    """
    blocks = [[block for trial in trials for block in trial] for trials in groups]
    if min(map(len, blocks)) < 2:
        raise CommonlawError("one-segment-to-draw")
    generator = np.random.default_rng(seed)
    drawn = [[_counts(len(own), generator) for own in blocks] for _ in range(n_resamples)]
    at_once = min(_RESAMPLES_AT_ONCE, max(1, _MAX_HELD_NUMBERS // sum(own[0].factor.size for own in blocks)))
    parts = [drawn[i : i + at_once] for i in range(0, n_resamples, at_once)]
    work, size = partial(_supports, blocks, path), sum(len(own) * own[0].factor.size for own in blocks)
    found = done_in_parts(work, parts, "resampling") if size <= _MAX_SENT_NUMBERS else map(work, parts)
    return Stability(tuple(support for each in found for support in each))


def _supports(
    blocks: Sequence[Sequence[LeastSquaresProblem]], path: Path, drawn: Sequence[Sequence[Floats]]
) -> list[tuple[Bools, ...]]:
    """Return the supports on the path of each of some resamples, which say how often objects draw their blocks."""
    by_object = zip(*drawn, strict=True)
    problems = [redrawn(own, np.array(counts)) for own, counts in zip(blocks, by_object, strict=True)]
    return [tuple(each.support for each in path(some)) for some in zip(*problems, strict=True)]


def _counts(blocks: int, generator: np.random.Generator) -> Floats:
    """Return how often each of some blocks is drawn, with replacement, in as many draws as there are."""
    return np.bincount(generator.integers(blocks, size=blocks), minlength=blocks).astype(np.float64)
