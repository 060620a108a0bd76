"""Errors of forecasts of held-out data, by their horizon, and the choice among laws by predictive scores.

Whole trials are held out if the others of their object identify its coefficients; else the later half of each trial,
and then its last quarter. The law is fitted to the rest under the same error model. Errors are standardized by the
forecast's standard deviations; all errors of one trial at a horizon count as one observation.

Evidence ranks laws by their one-step predictions, which is right if one of them is true. If none is, or measurements
are few, the law that fits them best may forecast worst beyond the visited states or over several steps. Laws are then
ranked by the log predictive density of held-out data (Dawid 1984), in which each trial counts as one observation.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import chain

import numpy as np

from commonlaw.array_types import Bools, Floats, evenly_spaced
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import fit_with
from commonlaw.inference.fit.covariance import degrees_of_freedom, fitted_law
from commonlaw.inference.fit.fit import Fit, best_fit
from commonlaw.inference.score.score import Kind, Score
from commonlaw.inference.search.error_models import GROUPS, fit_each_kind, search_each_group
from commonlaw.inference.search.pool import Pool
from commonlaw.law import Law
from commonlaw.law.law import object_index
from commonlaw.law.parameters import standard_errors
from commonlaw.law.quantiles import two_sided
from commonlaw.law.uncertainty import IntervalInflation
from commonlaw.likelihood import ERRORS
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.runtime.progress import ProgressCallback, unannounced
from commonlaw.trials import Trial, Trials


@dataclass(frozen=True, eq=False)
class StandardizedErrors:
    """Standardized errors of the forecasts of one trial.

    Horizons `ahead` are times since the last sample used for the initial state, shape (n,). Sizes are absolute errors
    in standard deviations of the normal distribution with the 95 % intervals, `std`, both of shape (n, states): NaN for
    missing values, and for all of a forecast without intervals; sizes are infinite for all of one that diverges. Those
    of `persistence` are of the last value before.
    """

    ahead: Floats
    sizes: Floats
    std: Floats
    persistence: Floats


def interval_inflation(found: Sequence[StandardizedErrors], horizons: int = 6) -> IntervalInflation | None:
    """Return the factors by which intervals are inflated at evenly spaced horizons; None if nothing was forecast.

    With enough held-out trials, the factor is the conformal quantile of the errors near a horizon at the level
    L (1 + 1/n), which covers one more of n exchangeable observations (Lei et al. 2018). Here n is the effective sample
    size, between the number of trials and that of errors: L (1 - L) over the variance of the coverage of the quantile
    L, estimated from its scatter between trials. With fewer trials it is the root mean square of the standardized
    errors, with a prior of mean one that counts as two trials. Factors are at least one, because other conditions are
    seldom forecast better than the training data, and do not decrease with the horizon.
    """
    longest = max((float(errors.ahead.max()) for errors in found if len(errors.ahead)), default=0.0)
    if not longest > 0:
        return None
    middles, factors, width = [], [], longest / horizons
    for middle in width * (np.arange(horizons) + 0.5):
        near = [errors.sizes[abs(errors.ahead - middle) <= width] for errors in found]
        trials = [known for errors in near if len(known := errors[np.isfinite(errors)])]
        if trials:
            middles.append(middle)
            factors.append(_factor(trials))
    return IntervalInflation(np.array(middles), np.maximum.accumulate(factors)) if factors else None


def _factor(trials: Sequence[Floats]) -> float:
    """Return the inflation factor from the errors of some trials, which have equal weights."""
    count = len(trials)
    if count * (1 - settings.LEVEL) >= settings.LEVEL:  # Enough for a conformal quantile
        sizes = np.concatenate(trials)
        order, weights = np.argsort(sizes), np.concatenate([np.full(len(trial), 1 / len(trial)) for trial in trials])
        share = np.cumsum(weights[order]) / count

        def quantile(level: float) -> float:
            return float(sizes[order][min(int(np.searchsorted(share, level)), len(sizes) - 1)])

        # Effective sample size of observations that are correlated within a trial (Kish 1965)
        scatter = np.var([np.mean(trial <= quantile(settings.LEVEL)) for trial in trials], ddof=1)
        worth = np.clip(
            count * settings.LEVEL * (1 - settings.LEVEL) / max(scatter, np.finfo(float).tiny), count, len(sizes)
        )
        return max(1.0, quantile(settings.LEVEL * (1 + 1 / worth)) / float(two_sided(settings.LEVEL)))
    squares = np.array([np.mean(trial**2) for trial in trials])
    return float(
        np.sqrt(max(1.0, (settings.PRIOR_OBSERVATIONS + squares.sum()) / (settings.PRIOR_OBSERVATIONS + count)))
    )


@unannounced()
def standardized_errors(fit: Fit, pooled: Callable[[Law], Law], *, both_ways: bool = False) -> list[StandardizedErrors]:
    """Return the errors of forecasts of held-out trials or parts of trials.

    `pooled` pools the coefficients of the objects. With `both_ways` the earlier half of each trial is predicted by a
    fit to the later half, too.
    """
    whole, trials = fitted_law(fit.problem.law, fit), fit.problem.trials
    sizes = np.hypot(whole.coefficients, np.nan_to_num(standard_errors(whole)))
    of_trials: dict[tuple[str, str], list[StandardizedErrors]] = {}
    for kept, left_out in _folds(trials, both_ways):
        try:
            law = _fitted_to(fit, kept)
            # Parts of trials, and whole trials whose coefficients the remaining ones identify: trials of two species
            # alone do not identify their competition, and if that of both is held out, its forecast shows nothing
            errors, indices = np.nan_to_num(standard_errors(law)), [object_index(whole, name) for name in law.objects]
            determined = np.all(errors <= settings.MAX_RELATIVE_ERROR * sizes[indices], axis=(1, 2))
            objects = {name for name, known in zip(law.objects, determined, strict=True) if known}
            cut = {(trial.object, trial.name) for trial in kept}
            law = pooled(law)
            for listed, start in left_out:
                usable = [trial for trial in listed if trial.object in objects or (trial.object, trial.name) in cut]
                for key, standardized in _standardized_errors(law, trials.with_trials(usable), start) if usable else ():
                    of_trials.setdefault(key, []).append(standardized)
        except CommonlawError:  # Too few or too short trials for this law
            continue
    names = [part.name for part in fields(StandardizedErrors)]
    return [
        StandardizedErrors(*(np.concatenate([getattr(errors, name) for errors in listed]) for name in names))
        for listed in of_trials.values()
    ]


LeftOut = list[tuple[list[Trial], int | None]]
"""Trials that are forecast, and how many of their samples determine the initial state; None for the default."""


def _folds(trials: Trials, both_ways: bool) -> Iterator[tuple[list[Trial], LeftOut]]:
    """Yield training data and held-out data of each fold."""
    names = [trials.objects[i] for i in evenly_spaced(len(trials.objects), settings.MAX_CHECKED_OBJECTS)]
    groups = [trials.of_object(name) for name in names]
    repeated = [group for group in groups if len(group) > 1]
    if not repeated:
        for share in settings.FITTED_SHARES:
            cut = [(trial, int(np.ceil(share * len(trial)))) for group in groups for trial in group]
            counts = sorted({count for _, count in cut})
            alike = [([trial for trial, number in cut if number == count], count) for count in counts]
            yield [trial.cut(count) for trial, count in cut], list[tuple[list[Trial], int | None]](alike)
        if both_ways:
            whole = [(trial, len(trial) // 2) for group in groups for trial in group]
            yield (
                [trial.rows(slice(half, None)) for trial, half in whole],
                [([trial.cut(half) for trial, half in whole], None)],
            )
        return
    for fold in range(min(settings.MAX_WINDOWS, max(map(len, repeated)))):
        left_out = [group[fold] for group in repeated if fold < len(group)]
        rest = [trial for group in groups for trial in group if not any(trial is held_out for held_out in left_out)]
        yield rest, [(left_out, None)]


def _fitted_to(fit: Fit, kept: Sequence[Trial]) -> Law:
    """Return the law with the terms and error model of a fit, fitted to some of the trials."""
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
    fitted = best_fit([fit_with(part, fit.supports, fit.model_error, starts)])
    law = fitted_law(part.law, fitted)
    degrees = degrees_of_freedom(fit)
    return replace(law, uncertainty=replace(law.uncertainty, degrees_of_freedom=degrees))


def _standardized_errors(
    law: Law, trials: Trials, start: int | None
) -> Iterator[tuple[tuple[str, str], StandardizedErrors]]:
    forecast = law.predict(trials, start=start, return_std=True, tolerance=1e-6)
    forecast = forecast.followed or forecast
    for trial, trajectory, (low, high), ahead in zip(
        forecast.trials,
        forecast.trajectories,
        forecast.bands(settings.LEVEL, measured=True),
        forecast.horizons,
        strict=True,
    ):
        middle, std = trajectory.states[:, : low.shape[1]], (high - low) / (2 * float(two_sided(settings.LEVEL)))
        sizes = abs(trial.states - middle) / std
        if not np.isfinite(middle).all():
            sizes = np.where(np.isnan(trial.states), np.nan, np.inf)
        elif not np.isfinite(std).all():
            sizes = np.full_like(sizes, np.nan)
        std[np.isnan(sizes)] = np.nan
        later = ahead > 0
        before = [column[np.isfinite(column)] for column in trial.states[~later].T]
        last = np.array([column[-1] if len(column) else np.nan for column in before])
        parts = (errors[later] for errors in (ahead, sizes, std, abs(trial.states - last) / std))
        yield (trial.object, trial.name), StandardizedErrors(*parts)


def best_forecaster(
    pool: Pool,
    errors_of_best: list[StandardizedErrors],
    kinds: Sequence[ErrorKind],
    pooled: Callable[[Law], Law],
    progress: ProgressCallback,
) -> tuple[Pool, list[StandardizedErrors]]:
    """Return a pool whose best has the best forecasts of held-out data, and the errors of its forecasts.

    It remains that of largest evidence if its standardized errors are as expected, but process noise lets a law fit any
    measurements: one with it gives way to a deterministic law, too, if the evidence of forecasts for this is strong, or
    if its own are no better than the last value, and then also to another one with process noise for strong evidence.
    If another one is chosen, laws of larger evidence under the same errors become its rivals. `errors_of_best` are
    those of the best, and `pooled` pools the coefficients of the objects, see `standardized_errors`.
    """
    is_off = _are_forecasts_off(pool.best, errors_of_best)
    # Without terms it is the last value that is forecast
    is_idle = pool.best.has_process_noise and (not pool.best.size or _no_better_than_last(errors_of_best))
    if not (is_off or is_idle or (pool.best.has_process_noise and _deterministic(pool))):
        return pool, errors_of_best
    progress("comparing forecasts of held-out data")
    # Idle process noise may have taken what more terms explain
    largest = max(pool.best.size, settings.MAX_TERMS_WITHOUT_LATENT_STATE * is_idle * pool.best.supports.shape[0])
    errors_of = partial(standardized_errors, pooled=pooled, both_ways=_is_forecast_testable(pool.best))
    scored = [(_score(errors_of(pool.best)), pool.best)]
    for fit in chain(_deterministic(pool), _others(pool, kinds, largest, progress) if is_off or is_idle else ()):
        errors = errors_of(fit)
        if len(errors) == len(errors_of_best):
            scored.append((_score(errors), fit))

    def less_what_is_needed(pair: tuple[float, Fit]) -> float:
        score, fit = pair
        is_enough = fit is pool.best or is_off or (is_idle and not fit.has_process_noise)
        return score - (0.0 if is_enough else settings.STRONG / 2)

    most, best = max(scored, key=less_what_is_needed)
    if best is pool.best:
        return pool, errors_of_best
    preferred = [(score, fit) for score, fit in scored if fit.errors == best.errors and fit < best]
    others = [scored_by_forecasts(fit, most - score) for score, fit in sorted(preferred, key=lambda pair: -pair[0])]
    is_approximation = pool.best.has_process_noise and not best.has_process_noise
    chosen = replace(pool, fits=(scored_by_forecasts(best, 0.0), *others), is_approximation=is_approximation)
    return chosen, standardized_errors(best, pooled)


def scored_by_forecasts(fit: Fit, less: float) -> Fit:
    """Return a fit whose score is twice its difference in log predictive density to the best."""
    score = Score({"forecasts": 2 * less}, Kind.FORECASTS)
    return replace(fit.with_score(score), problem=replace(fit.problem, solver=None), alternatives=())


def _are_forecasts_off(fit: Fit, errors: Sequence[StandardizedErrors]) -> bool:
    """Return whether standardized errors are too large for a law with process noise, or with few measurements.

    Such a law may overfit. The test uses the mean over trials of the median squared error, which exceeds one by more
    than `SIGNIFICANT` standard errors sqrt(2/n). Forecasts that diverge are enough: one of a law with process noise, or
    most of another one.
    """
    if not (fit.has_process_noise or fit.has_few_measurements):
        return False
    diverged = [bool(np.isinf(error.sizes).any()) for error in errors]
    if any(diverged) if fit.has_process_noise else 2 * sum(diverged) > len(diverged):
        return True
    count = len(fit.problem.trials.objects)
    finite = [known for error in errors if len(known := error.sizes[np.isfinite(error.sizes)])]
    if min(count, len(finite)) < 2:
        return False
    squares = [np.median(errors_of_trial**2) for errors_of_trial in finite]  # Robust to outliers of the measurements
    return float(np.mean(squares)) > 1 + settings.SIGNIFICANT * float(np.sqrt(2 / count))


def _no_better_than_last(errors: Sequence[StandardizedErrors]) -> bool:
    """Return whether forecasts have squared errors as large as those of the last value before, or larger."""
    of_law, of_last = (
        sum(float(np.nansum(size**2)) for size in sizes)
        for sizes in ([error.sizes for error in errors], [error.persistence for error in errors])
    )
    return of_law >= of_last > 0


def _is_forecast_testable(fit: Fit) -> bool:
    """Return whether the later half of each trial identifies a law, which may then predict the earlier half."""
    return not (fit.has_few_measurements or fit.problem.trials.schema.initial_values)


def _score(errors: Sequence[StandardizedErrors]) -> float:
    """Return the log predictive density of held-out data, with bands inflated to their errors.

    With mean squares q of standardized errors, mean logarithms w of standard deviations in each trial, and the
    inflation s = max(1, mean of q), it is -sum of (w + log(s)/2 + q/(2 s)). It is minus infinity if a forecast diverges
    or has no intervals, or if there is none.
    """
    if not (errors and all(np.isfinite(error.sizes).any() and not np.isinf(error.sizes).any() for error in errors)):
        return -np.inf
    squares = [float(np.nanmean(error.sizes**2)) for error in errors]
    widths = [float(np.nanmean(np.log(error.std))) for error in errors]
    scale = max(1.0, float(np.mean(squares)))
    return -sum(widths) - len(errors) * float(np.log(scale)) / 2 - sum(squares) / scale / 2


def _deterministic(pool: Pool) -> list[Fit]:
    return [*pool.deterministic, *(fit for fit in pool.rivals if not fit.has_process_noise)]


@unannounced()
def _others(pool: Pool, kinds: Sequence[ErrorKind], largest: int, progress: ProgressCallback) -> Iterator[Fit]:
    """Yield the most probable laws of each size up to the largest, under each group of error models."""
    best_of_size = dict[int, Fit]()
    for fit in pool.rivals:
        best_of_size.setdefault(fit.size, fit)
    yield from (fit for size, fit in best_of_size.items() if size <= largest)
    if pool.plain is None:
        return
    problem, supports = pool.plain.problem.under_white_noise, dict[bytes, Bools]()
    plain = replace(pool.plain, problem=problem)
    for under_errors in search_each_group(plain, kinds, progress):
        supports |= {proposed.tobytes(): proposed for proposed in best_of_each_size(under_errors, largest)}
    for support in supports.values():
        fits = fit_each_kind(problem, support, kinds)
        for group in GROUPS:
            of_group = [fit for fit in fits if ERRORS[fit.errors].group == group]
            best = min(of_group, default=None)
            if best is not None and best.model != pool.best.model:
                yield best


def best_of_each_size(pool: Pool, largest: int) -> Iterable[Bools]:
    """Return the most probable support of each size among those that a pool proposes."""
    proposed = [support for support in pool.proposals() if 0 < support.sum() <= largest]
    best, values = dict[int, Bools](), [pool.best.evidence.value(support) for support in proposed]
    for i in np.argsort(values):
        best.setdefault(int(proposed[i].sum()), proposed[i])
    return best.values()
