"""Which law, where few measurements may be imitated, or no law is exact: the one that forecasts best.

Evidence tells laws apart by how probable they make each measurement after those before it, if one of them is right.
Where none is, the law that imitates the measurements best may be the one that forecasts worst, beyond what was visited,
or farther ahead than the next measurement: a force that makes up for a law from sample to sample is unknown by then.
Laws are weighed then by how probable their forecasts make the later parts of trials, or trials, that they were not
fitted to (Dawid 1984). All errors of a trial go together, so that each trial counts as one observation.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.effort import unannounced
from commonlaw.errors import CommonlawError
from commonlaw.inference.fit.state import evidence_of
from commonlaw.inference.result.interval_calibration import StandardizedErrors, standardized_errors
from commonlaw.inference.score.score import Kind, Score
from commonlaw.inference.search.error_levels import ErrorKind, kind_of
from commonlaw.inference.search.error_models import GROUPS, OF_LAWS, Hypothesis, hypotheses, under_each_kind
from commonlaw.inference.search.law_search import LawSearch
from commonlaw.law import Law
from commonlaw.progress import ProgressCallback
from commonlaw.solvers import AbstractSolver

_SURE = 2.0
"""Standard errors from which on forecasts are farther off than they say."""


def best_forecaster(
    found: LawSearch, kinds: Sequence[ErrorKind], pool: Callable[[Law], Law], progress: ProgressCallback
) -> tuple[LawSearch, list[StandardizedErrors]]:
    """Return the law that forecasts best what was left out, and how far its forecasts are off.

    It is the one that was found where forecasts are as good as they say, or many measurements are explained by a law
    without errors of its own. Laws that evidence prefers to another under the same errors are the rivals of that.

    Parameters
    ----------
    found
        What was found, the largest evidence first.
    kinds
        Of errors that laws may have.
    pool
        How coefficients of objects learn from each other.
    progress
        Takes what is being done.
    """
    own = standardized_errors(found, pool)
    if not _is_in_doubt(found, own):
        return found, own
    progress("comparing forecasts of what was left out")
    errors_of = partial(standardized_errors, pool=pool, both_ways=_tell_by_halves(found))
    weighed = [(_score(errors_of(found)), found)]
    for each in _others(found, kinds, progress):
        with suppress(CommonlawError):
            errors = errors_of(each)
            if len(errors) == len(own):
                weighed.append((_score(errors), each))
    most, best = max(weighed, key=lambda each: each[0])
    if best is found:
        return found, own
    others = sorted((each for each in weighed if _may_be_right(each[1], best)), key=lambda each: -each[0])
    rivals = tuple(weighed_by_forecasts(each, most - score) for score, each in others)
    return replace(weighed_by_forecasts(best, 0.0), rivals=rivals), standardized_errors(best, pool)


def _may_be_right(other: LawSearch, best: LawSearch) -> bool:
    """Return whether evidence prefers a law to the one that forecasts best, under errors of the same kind."""
    return _errors_of(other) == _errors_of(best) and other.state.score < best.state.score


def weighed_by_forecasts(found: LawSearch, less: float) -> LawSearch:
    """Return a law that is less probable by the logarithm of the probability of what was left out."""
    return replace(
        found,
        state=replace(found.state, score=Score({"forecasts": 2 * less}, Kind.FORECASTS), alternatives=()),
        solver=None,
        rivals=(),
    )


def score_of_forecasts(found: LawSearch, pool: Callable[[Law], Law]) -> float:
    """Return the logarithm of how probable forecasts make what was left out; minus infinity if any diverges."""
    with suppress(CommonlawError):
        if errors := standardized_errors(found, pool, both_ways=_tell_by_halves(found)):
            return _score(errors)
    return -np.inf


def _is_in_doubt(found: LawSearch, errors: Sequence[StandardizedErrors]) -> bool:
    """Return whether forecasts of a law that errs, or that few measurements tell, are farther off than it says.

    It may imitate these. All errors of an object go together: one alone may have met with chaos; but what a law that
    errs was learned from did not diverge.
    """
    count, errs = len(found.problem.trials.objects), _errors_of(found) in OF_LAWS
    if errs and any(np.isinf(each.sizes).any() for each in errors):
        return True
    finite = [known for each in errors if len(known := each.standardized[np.isfinite(each.sizes)])]
    if min(count, len(finite)) < 2 or not (errs or found.has_few_measurements):
        return False
    squares = [np.median(each**2) for each in finite]  # Outliers of the measurements are not the law's
    return float(np.mean(squares)) > 1 + _SURE * float(np.sqrt(2 / count))


def _tell_by_halves(found: LawSearch) -> bool:
    """Return whether the later half of each trial tells a law, which may then forecast the earlier one."""
    return not (found.has_few_measurements or found.problem.trials.schema.starts)


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
def _others(found: LawSearch, kinds: Sequence[ErrorKind], progress: ProgressCallback) -> Iterator[LawSearch]:
    """Yield laws of no more coefficients with other terms or errors: the likeliest of each size under each errors."""
    largest, fitted = found.size, dict[int, LawSearch]()
    for each in found.rivals:
        fitted.setdefault(each.size, each)
    yield from (each for size, each in fitted.items() if size <= largest)
    plain = next((each for each in (found, *found.rivals) if each.solver is not None), None)
    if plain is None or plain.solver is None:
        return
    problem = plain.problem.under_white_noise
    listed = dict[bytes, Bools]()
    known = (_errors_of(found), found.state.supports.tobytes()) if found.solver is not None else None
    for hypothesis in hypotheses(problem, plain.state, kinds, plain.solver, progress):
        listed |= {each.tobytes(): each for each in of_each_size(hypothesis, plain.solver, largest)}
    for supports in listed.values():
        under = under_each_kind(problem, supports, kinds)
        for group in GROUPS:
            likeliest = sorted((each for each in under if each.kind in group), key=lambda each: each.state.score)[:1]
            yield from (
                replace(plain, problem=each.problem, state=each.state, rivals=())
                for each in likeliest
                if (each.kind, supports.tobytes()) != known
            )


def _errors_of(found: LawSearch) -> ErrorKind:
    return "walk" if found.state.has_model_error else kind_of(found.problem.errors)


def of_each_size(hypothesis: Hypothesis, solver: AbstractSolver, largest: int) -> Iterable[Bools]:
    """Return the likeliest supports of each size."""
    pool = [each for each in hypothesis.pool(solver) if 0 < each.sum() <= largest]
    best = dict[int, Bools]()
    for i in np.argsort(evidence_of(hypothesis.problem, hypothesis.state, pool)):
        best.setdefault(int(pool[i].sum()), pool[i])
    return best.values()
