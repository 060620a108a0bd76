"""Which law, where few measurements may be imitated, or no law is exact: the one that forecasts best.

Evidence tells laws apart by how probable they make each measurement after those before it, if one of them is right.
Where none is, the law that imitates the measurements best may be the one that forecasts worst, beyond what was visited,
or farther ahead than the next measurement: a force that makes up for a law from sample to sample is unknown by then.
Laws are weighed then by how probable their forecasts make the later parts of trials, or trials, that they were not
fitted to (Dawid 1984). All errors of a trial go together, so that each trial counts as one observation.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.inference import settings
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.result.interval_calibration import StandardizedErrors, standardized_errors
from commonlaw.inference.score.score import Kind, Score
from commonlaw.inference.search.error_models import GROUPS, of_each_group, under_each_kind
from commonlaw.inference.search.pool import Pool
from commonlaw.law import Law
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.runtime.progress import ProgressCallback, unannounced


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
            of_group = [each for each in fits if each.errors in group]
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
