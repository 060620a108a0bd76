"""Cross-validation, by residuals or forecasts of held-out data; and how often terms are chosen on resampled data."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.formulation import LeastSquaresProblem, merge, redrawn
from commonlaw.law import Law, select_objects
from commonlaw.runtime.cluster import done_in_parts
from commonlaw.solvers import Candidate
from commonlaw.trials import Trials

ProblemGroups = Sequence[Sequence[Sequence[LeastSquaresProblem]]]
"""The problem of each segment of the data: for each object its trials, for each trial its segments in order of time."""


@dataclass(frozen=True, eq=False)
class Fold:
    """One object's data in two: the problems of what is held out and of the rest.

    `trials` are the indices of held-out trials, none if segments of a single trial are held out; `share` is the weight
    in a mean over folds in which objects count equally.
    """

    object: int
    held: LeastSquaresProblem
    rest: LeastSquaresProblem
    trials: tuple[int, ...]
    share: float


def make_folds(groups: ProblemGroups, count: int = 10) -> tuple[Fold, ...]:
    """Return the folds of all objects.

    Objects of several trials hold out trials: one at a time if there are at most `count`, otherwise every `count`-th
    together. A single trial holds out segments in the same way, whose rows at a cut share samples of the smoothing
    window. Raises `CommonlawError` if there are fewer than two folds, or an object has a single segment.
    """
    if count < 2:
        raise CommonlawError("too-few-folds", count=count)
    folds = []
    for index, trials in enumerate(groups):
        several = len(trials) > 1
        units = [merge(segments) for segments in trials] if several else list(trials[0])
        if len(units) < 2:
            raise CommonlawError("one-segment-to-hold-out")
        used = min(count, len(units))
        held = [merge(units[k::used]) for k in range(used)]
        for k, part in enumerate(held):
            rest = merge(held[:k] + held[k + 1 :])
            out = tuple(range(k, len(units), used)) if several else ()
            folds.append(Fold(index, part, rest, out, 1 / (used * len(groups))))
    return tuple(folds)


@dataclass(frozen=True, eq=False)
class CrossValidationScore:
    """A candidate's errors on the folds, and their weights, which sum to one, both of shape (folds,)."""

    errors: Floats
    shares: Floats

    @classmethod
    def of(cls, folds: Sequence[Fold], errors: Sequence[float]) -> "CrossValidationScore":
        """Return the score of an error on each fold."""
        return cls(np.array(errors), np.array([fold.share for fold in folds]))

    @property
    def mean(self) -> float:
        """The mean over folds, in which objects count equally."""
        return float(self.shares @ self.errors)

    @property
    def standard_error(self) -> float:
        """Standard error of the mean; NaN if an error is infinite."""
        return self._error_of(self.errors)

    def excess(self, best: "CrossValidationScore") -> tuple[float, float]:
        """Return by how much the mean exceeds another candidate's, with the standard error of the paired difference."""
        with np.errstate(invalid="ignore"):
            differences = self.errors - best.errors
        differences[np.isnan(differences)] = 0.0  # Both diverged on that fold
        return float(self.shares @ differences), self._error_of(differences)

    def _error_of(self, values: Floats) -> float:
        if not np.all(np.isfinite(values)):
            return np.nan
        count, away = len(values), values - self.shares @ values
        return float(np.sqrt(count / (count - 1) * np.sum((self.shares * away) ** 2)))


@dataclass(frozen=True, eq=False)
class ResidualError:
    """Scores a support of an equation by the mean squared residuals of held-out data after a fit to the rest.

    They are relative to the mean square of each object's target, so that objects count equally.
    """

    folds: Sequence[Fold]
    target: int

    def __call__(self, support: Bools) -> CrossValidationScore:
        """Return the errors of a support, shape (objects, terms)."""
        return CrossValidationScore.of(self.folds, [self._error(fold, support[fold.object]) for fold in self.folds])

    def _error(self, fold: Fold, support: Bools) -> float:
        coefficients = fold.rest.least_squares(support, self.target)
        whole = fold.held.tss(self.target) + fold.rest.tss(self.target)
        scale = whole / (fold.held.rows + fold.rest.rows)
        return fold.held.rss(coefficients, self.target) / fold.held.rows / (scale or 1.0)


@dataclass(frozen=True, eq=False)
class ForecastError:
    """Scores a support of one equation on forecasts of held-out trials by the law that was fitted to the others.

    The error of a trial is the mean over states of the mean squared error, divided by the variance of the state over
    the object's trials; infinite where a forecast diverges. The other equations are those of `law`, refitted on each
    fold, but for terms that are not `free`, shape (equations, terms). Folds are of problems less known terms, and
    trials those of all folds, with the law's objects in its order.

    Raises `CommonlawError` if an object has a single trial.
    """

    folds: Sequence[Fold]
    target: int
    law: Law
    free: Bools
    trials: Trials

    def __post_init__(self) -> None:
        for fold in self.folds:
            if not fold.trials:
                raise CommonlawError("one-trial-to-forecast", object=self.law.objects[fold.object])

    def __call__(self, support: Bools) -> CrossValidationScore:
        """Return the errors of a support, shape (objects, terms)."""
        return CrossValidationScore.of(self.folds, [self._error(fold, support[fold.object]) for fold in self.folds])

    def _error(self, fold: Fold, support: Bools) -> float:
        name = self.law.objects[fold.object]
        coefficients = np.where(self.free, 0.0, self.law.coefficients[fold.object])
        for j in range(len(coefficients)):
            used = support if j == self.target else (self.law.coefficients[fold.object, j] != 0) & self.free[j]
            coefficients[j] += fold.rest.least_squares(used, j)
        law = replace(select_objects(self.law, [name]), coefficients=coefficients[np.newaxis])
        trials = self.trials.of_object(name)
        errors = law.predict(self.trials.with_trials([trials[i] for i in fold.trials])).errors()
        variances = np.var(np.concatenate([trial.states for trial in trials]), axis=0)
        rms = errors["rms error"].to_numpy().reshape(len(fold.trials), -1)
        return float(np.mean(rms**2 / variances))


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
    generator, counts = np.random.default_rng(seed), [len(block) for block in blocks]
    drawn = [
        [np.bincount(generator.integers(n, size=n), minlength=n).astype(np.float64) for n in counts]
        for _ in range(n_resamples)
    ]
    # Whatever the number of workers, so that the law does not depend on it; held are 128 MB of factors at most
    at_once = min(5, max(1, 2**24 // sum(block[0].factor.size for block in blocks)))
    parts = [drawn[i : i + at_once] for i in range(0, n_resamples, at_once)]
    work, size = partial(_supports, blocks, path), sum(len(block) * block[0].factor.size for block in blocks)
    listed = done_in_parts(work, parts, "resampling") if size <= 2**20 else map(work, parts)  # 8 MB go to workers
    return Stability(tuple(support for supports in listed for support in supports))


def _supports(
    blocks: Sequence[Sequence[LeastSquaresProblem]], path: Path, drawn: Sequence[Sequence[Floats]]
) -> list[tuple[Bools, ...]]:
    """Return the supports on the path of each of some resamples, which say how often objects draw their blocks."""
    problems = [[redrawn(*pair) for pair in zip(blocks, counts, strict=True)] for counts in drawn]
    return [tuple(candidate.support for candidate in path(some)) for some in problems]
