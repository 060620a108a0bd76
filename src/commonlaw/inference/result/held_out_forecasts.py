"""How far forecasts of what was left out are off, by how far ahead they forecast.

A trial is left out where the others of its object identify its coefficients, else the later half of each trial, and
then its last quarter; the law is fitted to the rest, under the same errors, and forecasts what was left out. Errors are
in units of the standard deviations of the forecast. Those of one trial are as good as one observation at a horizon.

Evidence ranks laws by how probable they make each measurement after those before it, if one of them is right.
Where none is, or few measurements may be imitated, the law that imitates them best may be the one that forecasts worst,
beyond what was visited, or farther ahead than the next measurement. Laws are ranked then by how probable their
forecasts make what they were not fitted to (Dawid 1984). All errors of a trial go together, so that each trial counts
as one observation.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np

from commonlaw.array_types import Bools, Floats, evenly_spaced
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import fit_with
from commonlaw.inference.fit.covariance import degrees_of_freedom, fitted_law
from commonlaw.inference.fit.fit import Fit, best_of
from commonlaw.inference.score.score import Kind, Score
from commonlaw.inference.search.error_models import GROUPS, of_each_group, under_each_kind
from commonlaw.inference.search.pool import Pool
from commonlaw.law import Law
from commonlaw.law.law import object_index
from commonlaw.law.parameters import standard_errors
from commonlaw.law.quantiles import two_sided
from commonlaw.law.uncertainty import Widening
from commonlaw.likelihood import ERRORS
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.runtime.progress import ProgressCallback, unannounced
from commonlaw.trials import Trial, Trials


@dataclass(frozen=True, eq=False)
class StandardizedErrors:
    """How far forecasts of one trial were off.

    Parameters
    ----------
    ahead
        How far ahead of what determined the initial state, shape (n,).
    sizes
        In units of what 95 % intervals reach, shape (n, states); NaN where nothing was measured, and for all of a
        forecast that does not say what they reach; infinite for all of one that diverges.
    reach
        What they reach, likewise.
    """

    ahead: Floats
    sizes: Floats
    reach: Floats

    @property
    def standardized(self) -> Floats:
        """Relative to the standard deviations of a normal distribution with these intervals."""
        return self.sizes * float(two_sided(settings.LEVEL))

    @property
    def std(self) -> Floats:
        """These standard deviations; NaN where nothing was measured."""
        return np.where(np.isnan(self.sizes), np.nan, self.reach / float(two_sided(settings.LEVEL)))


def widening_of(found: Sequence[StandardizedErrors]) -> Widening | None:
    """Return by how much intervals should be wider at each horizon; None if nothing was forecast.

    Where as many trials were left out as a conformal prediction takes, the quantile of their errors about a horizon, at
    the level L (1 + 1/n) that holds for one more of n observations (Lei and others 2018): n is what the errors are
    worth, from as many as there are trials to as many as errors, L (1 - L) over the variance of the share within the
    quantile L, which is by that of the trials' shares. Where fewer were, the mean square of the
    errors, next to which what the law says of itself counts as two trials. Intervals are not made narrower: later
    times, and other starts, are seldom forecast better than what was learned from; nor are they widened less where they
    are farther ahead.
    """
    longest = max((float(each.ahead.max()) for each in found if len(each.ahead)), default=0.0)
    if not longest > 0:
        return None
    horizons, factors, width = [], [], longest / settings.HORIZONS
    for middle in width * (np.arange(settings.HORIZONS) + 0.5):
        near = [each.sizes[abs(each.ahead - middle) <= width] for each in found]
        trials = [known for each in near if len(known := each[np.isfinite(each)])]
        if trials:
            horizons.append(middle)
            factors.append(_factor(trials))
    return Widening(np.array(horizons), np.maximum.accumulate(factors)) if factors else None


def _factor(trials: Sequence[Floats]) -> float:
    """Return the factor from the errors of some trials, each of which counts once, however often it was measured."""
    count = len(trials)
    if count * (1 - settings.LEVEL) >= settings.LEVEL:  # Enough for the quantile of one more (conformal prediction)
        sizes = np.concatenate(trials)
        order, weights = np.argsort(sizes), np.concatenate([np.full(len(each), 1 / len(each)) for each in trials])
        share = np.cumsum(weights[order]) / count

        def quantile(level: float) -> float:
            return float(sizes[order][min(int(np.searchsorted(share, level)), len(sizes) - 1)])

        # Independent observations worth as much as these, which are correlated within a trial (Kish 1965)
        scatter = np.var([np.mean(each <= quantile(settings.LEVEL)) for each in trials], ddof=1)
        worth = np.clip(
            count * settings.LEVEL * (1 - settings.LEVEL) / max(scatter, np.finfo(float).tiny), count, len(sizes)
        )
        return max(1.0, quantile(settings.LEVEL * (1 + 1 / worth)))
    squares = np.array([np.mean(each**2) for each in trials]) * float(two_sided(settings.LEVEL)) ** 2
    return float(
        np.sqrt(max(1.0, (settings.PRIOR_OBSERVATIONS + squares.sum()) / (settings.PRIOR_OBSERVATIONS + count)))
    )


@unannounced()
def standardized_errors(fit: Fit, pooled: Callable[[Law], Law], *, both_ways: bool = False) -> list[StandardizedErrors]:
    """Return how far forecasts by a law are off, of trials or parts of trials that were left out.

    `pooled` says how coefficients of objects learn from each other. Both ways, the earlier half of trials is forecast,
    too, by what is fitted to the later one.
    """
    whole, trials = fitted_law(fit.problem.law, fit), fit.problem.trials
    found: dict[tuple[str, str], list[StandardizedErrors]] = {}
    for kept, left_out in _folds(trials, both_ways):
        try:
            law = _fitted_to(fit, kept)
            own, law = law, pooled(law)
            for listed, start in left_out:
                if determined := _well_determined(listed, kept, own, whole):
                    for key, errors in _standardized_errors(law, trials.with_trials(determined), start):
                        found.setdefault(key, []).append(errors)
        except CommonlawError:  # Trials that are too few or too short for the law forecast nothing
            continue
    return [
        StandardizedErrors(
            *(np.concatenate([getattr(each, part.name) for each in own]) for part in fields(StandardizedErrors))
        )
        for own in found.values()
    ]


def _well_determined(left_out: Sequence[Trial], kept: Sequence[Trial], law: Law, whole: Law) -> list[Trial]:
    """Return the parts of trials that were left out, and whole ones of which others tell what all trials tell.

    Of two species whose trial together is left out, trials of each alone say nothing of how they compete: forecasts by
    these do not show how well the law forecasts.
    """
    errors, own = np.nan_to_num(standard_errors(law)), [object_index(whole, name) for name in law.objects]
    sizes = np.hypot(whole.coefficients, np.nan_to_num(standard_errors(whole)))[own]
    determined = np.all(errors <= settings.MAX_RELATIVE_ERROR * sizes, axis=(1, 2))
    objects = {name for name, known in zip(law.objects, determined, strict=True) if known}
    cut = {(trial.object, trial.name) for trial in kept}
    return [trial for trial in left_out if trial.object in objects or (trial.object, trial.name) in cut]


LeftOut = list[tuple[list[Trial], int | None]]
"""Trials that are forecast, and how many of their samples tell the start; None as it is by default."""


def _folds(trials: Trials, both_ways: bool) -> Iterator[tuple[list[Trial], LeftOut]]:
    """Yield what laws are fitted to, and what they forecast then."""
    names = [trials.objects[i] for i in evenly_spaced(len(trials.objects), settings.MAX_CHECKED_OBJECTS)]
    groups = [trials.of_object(name) for name in names]
    repeated = [group for group in groups if len(group) > 1]
    if not repeated:
        for share in settings.FITTED_SHARES:
            cut = [(trial, int(np.ceil(share * len(trial)))) for group in groups for trial in group]
            counts = sorted({count for _, count in cut})
            alike = [([trial for trial, own in cut if own == count], count) for count in counts]
            yield [trial.cut(count) for trial, count in cut], list[tuple[list[Trial], int | None]](alike)
        if both_ways:
            whole = [(trial, len(trial) // 2) for group in groups for trial in group]
            yield (
                [trial.rows(slice(half, None)) for trial, half in whole],
                [([trial.cut(half) for trial, half in whole], None)],
            )
        return
    for fold in range(min(settings.MAX_FOLDS, max(map(len, repeated)))):
        left_out = [group[fold] for group in repeated if fold < len(group)]
        rest = [trial for group in groups for trial in group if not any(trial is each for each in left_out)]
        yield rest, [(left_out, None)]


def _fitted_to(fit: Fit, kept: Sequence[Trial]) -> Law:
    """Return the law with the terms and errors of a fit, fitted to some of the trials."""
    problem = fit.problem
    objects = problem.trials.with_trials(kept).objects
    indices = [problem.trials.objects.index(name) for name in objects]
    guess = np.array([fit.estimates[i].coefficients for i in indices])
    part = problem.of_trials(kept, problem.known[indices], guess)
    starts = [
        replace(start, coefficients=fit.estimates[i].coefficients)
        for start, i in zip(part.starts, indices, strict=True)
    ]
    part = replace(part, solver=problem.solver, differentiation=problem.differentiation)
    fitted = best_of([fit_with(part, fit.supports, fit.model_error, starts)])
    law = fitted_law(part.law, fitted)
    degrees = degrees_of_freedom(fit)
    return replace(law, uncertainty=replace(law.uncertainty, degrees_of_freedom=degrees))


def _standardized_errors(
    law: Law, trials: Trials, start: int | None
) -> Iterator[tuple[tuple[str, str], StandardizedErrors]]:
    """Yield how far forecasts of trials are off, by object and name."""
    forecast = law.predict(trials, start=start, return_std=True, tolerance=1e-6)
    forecast = forecast.followed or forecast
    for trial, trajectory, (low, high), ahead in zip(
        forecast.trials,
        forecast.trajectories,
        forecast.bands(settings.LEVEL, measured=True),
        forecast.horizons,
        strict=True,
    ):
        middle, half = trajectory.states[:, : low.shape[1]], (high - low) / 2
        sizes = abs(trial.states - middle) / half
        if not np.isfinite(middle).all():
            sizes = np.where(np.isnan(trial.states), np.nan, np.inf)
        elif not np.isfinite(half).all():
            sizes = np.full_like(sizes, np.nan)
        later = ahead > 0
        yield (trial.object, trial.name), StandardizedErrors(ahead[later], sizes[later], half[later])


def best_forecaster(
    pool: Pool, kinds: Sequence[ErrorKind], pooled: Callable[[Law], Law], progress: ProgressCallback
) -> tuple[Pool, list[StandardizedErrors]]:
    """Return a pool whose best forecasts best what was left out, and how far its forecasts are off.

    It is the one of largest evidence where forecasts are as good as they say, or many measurements are explained by a
    law without errors of its own. Laws that evidence prefers to another under the same errors are the rivals of that.
    `pooled` says how coefficients of objects learn from each other.
    """
    own = standardized_errors(pool.best, pooled)
    if not _is_in_doubt(pool.best, own):
        return pool, own
    progress("comparing forecasts of held-out data")
    errors_of = partial(standardized_errors, pooled=pooled, both_ways=_tell_by_halves(pool.best))
    weighed = [(_score(errors_of(pool.best)), pool.best)]
    for fit in _others(pool, kinds, progress):
        errors = errors_of(fit)
        if len(errors) == len(own):
            weighed.append((_score(errors), fit))
    most, best = max(weighed, key=lambda each: each[0])
    if best is pool.best:
        return pool, own
    preferred = [(score, fit) for score, fit in weighed if fit.errors == best.errors and fit < best]
    others = [weighed_by_forecasts(fit, most - score) for score, fit in sorted(preferred, key=lambda each: -each[0])]
    return replace(pool, fits=(weighed_by_forecasts(best, 0.0), *others)), standardized_errors(best, pooled)


def weighed_by_forecasts(fit: Fit, less: float) -> Fit:
    """Return a law that is less probable by the logarithm of the probability of what was left out."""
    score = Score({"forecasts": 2 * less}, Kind.FORECASTS)
    return replace(fit.with_score(score), problem=replace(fit.problem, solver=None), alternatives=())


def score_of_forecasts(fit: Fit, pooled: Callable[[Law], Law]) -> float:
    """Return the logarithm of how probable forecasts make what was left out; minus infinity if any diverges."""
    errors = standardized_errors(fit, pooled, both_ways=_tell_by_halves(fit))
    return _score(errors) if errors else -np.inf


def _is_in_doubt(fit: Fit, errors: Sequence[StandardizedErrors]) -> bool:
    """Return whether forecasts of a law that errs, or that few measurements tell, are farther off than it says.

    It may imitate these. All errors of an object go together: one alone may have met with chaos; but what a law that
    errs was learned from did not diverge.
    """
    count, errs = len(fit.problem.trials.objects), fit.has_process_noise
    if errs and any(np.isinf(each.sizes).any() for each in errors):
        return True
    finite = [known for each in errors if len(known := each.standardized[np.isfinite(each.sizes)])]
    if min(count, len(finite)) < 2 or not (errs or fit.has_few_measurements):
        return False
    squares = [np.median(each**2) for each in finite]  # Outliers of the measurements are not the law's
    return float(np.mean(squares)) > 1 + settings.SIGNIFICANT * float(np.sqrt(2 / count))


def _tell_by_halves(fit: Fit) -> bool:
    """Return whether the later half of each trial tells a law, which may then forecast the earlier one."""
    return not (fit.has_few_measurements or fit.problem.trials.schema.starts)


def _score(errors: Sequence[StandardizedErrors]) -> float:
    """Return the logarithm of how probable forecasts make what was left out, with bands as wide as they should be.

    That of no law whose forecasts diverge, or do not say how far off they may be.
    """
    if not all(np.isfinite(each.sizes).any() and not np.isinf(each.sizes).any() for each in errors):
        return -np.inf
    squares = [float(np.nanmean(each.standardized**2)) for each in errors]
    widths = [float(np.nanmean(np.log(each.std))) for each in errors]
    scale = max(1.0, float(np.mean(squares)))
    return -sum(widths) - len(errors) * float(np.log(scale)) / 2 - sum(squares) / scale / 2


@unannounced()
def _others(pool: Pool, kinds: Sequence[ErrorKind], progress: ProgressCallback) -> Iterator[Fit]:
    """Yield laws of no more coefficients with other terms or errors: the likeliest of each size under each errors."""
    largest, likeliest = pool.best.size, dict[int, Fit]()
    for fit in pool.rivals:
        likeliest.setdefault(fit.size, fit)
    yield from (fit for size, fit in likeliest.items() if size <= largest)
    if pool.plain is None:
        return
    problem, supports = pool.plain.problem.under_white_noise, dict[bytes, Bools]()
    plain = replace(pool.plain, problem=problem)
    for under_errors in of_each_group(plain, kinds, progress):
        supports |= {each.tobytes(): each for each in of_each_size(under_errors, largest)}
    for own in supports.values():
        fits = under_each_kind(problem, own, kinds)
        for group in GROUPS:
            of_group = [each for each in fits if ERRORS[each.errors].group == group]
            best = min(of_group, default=None)
            if best is not None and best.model != pool.best.model:
                yield best


def of_each_size(pool: Pool, largest: int) -> Iterable[Bools]:
    """Return the likeliest supports of each size, of those that a pool proposes."""
    proposed = [each for each in pool.proposals() if 0 < each.sum() <= largest]
    best, values = dict[int, Bools](), [pool.best.evidence.value(each) for each in proposed]
    for i in np.argsort(values):
        best.setdefault(int(proposed[i].sum()), proposed[i])
    return best.values()
