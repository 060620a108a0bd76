"""Supports and noise of laws of plain terms where measurements are few for the candidate terms.

The search among plain terms begins from the likelihood linearized with all of them. With few measurements for each,
their coefficients are nearly undetermined, and so is the support selected from there. Sums of squares of a few terms
in integral form need no fit with all of them. Differences of few samples hardly estimate how the noise grows with a
state either, but residuals of a law do.
"""

from collections.abc import Sequence
from itertools import islice, product

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import fit_solutions, fit_supports, rescale_noise, with_neighbours
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.propose.integral_ranking import rank_supports
from commonlaw.inference.search.error_models import estimate_error_model
from commonlaw.inference.search.pool import Pool
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.runtime.progress import ProgressCallback


def with_ranked_supports(pool: Pool, progress: ProgressCallback) -> Pool:
    """Return the pool of a search among plain terms with the best supports by integrals, and their neighbours.

    With `MIN_SAMPLES_PER_TERM` measurements for each candidate term the pool stays as it is. Terms are integrated along
    the smoothed measurements, and along the states of the best fit with a large model error. The best supports of all
    equations are combined, and those of each equation with the supports of the best law.
    """
    problem, best = pool.explored[0].problem, pool.best
    if not _has_few_measurements(problem):
        return pool
    progress("ranking terms by their integrals")
    loose = [fit.estimates for fit in pool.explored if fit.model_error >= settings.MODEL_ERRORS[-2]]
    most = dict.fromkeys(range(len(best.supports)), problem.most_terms)
    proposed = dict[bytes, Bools]()
    for estimates in (*loose[:1], problem.starts):
        ranked = rank_supports(problem, estimates, (), most)
        rows = [
            [np.isin(np.arange(len(present)), candidate.plain) for candidate in ranked[j][: settings.MAX_KEPT]]
            or [present]
            for j, present in enumerate(best.supports)
        ]
        joint = [np.array(combined) for combined in islice(product(*rows), settings.MAX_PROPOSED)]
        for j, listed in enumerate(rows):
            for row in listed:
                joint.append(best.supports.copy())
                joint[-1][j] = row
        proposed |= {supports.tobytes(): supports for supports in joint}
    known = {fit.supports.tobytes() for fit in pool.explored if not fit.has_model_error}
    new = [supports for key, supports in proposed.items() if key not in known]
    fits = with_neighbours([*pool.explored, *(fit_supports(problem, row, settings.SCHEDULES[-1]) for row in new)])
    return Pool((rescale_noise(fits[0]),), fits)


def under_proportional_noise(pool: Pool, kinds: Sequence[ErrorKind]) -> Pool:
    """Return the pool with its best law under proportional noise, if it has a lack of fit under white noise alone.

    The noise must be unknown, measurements few, and the evidence for proportional noise very strong.
    """
    best, problem = pool.best, pool.best.problem
    if not (best.lack_of_fit and _has_few_measurements(problem) and "proportional" in kinds):
        return pool
    if problem.errors or problem.noise_is_fixed:
        return pool
    fit = estimate_error_model(fit_solutions(problem, best.supports), "proportional")
    if not fit.is_usable or fit.lack_of_fit or not fit.score.total < best.score.total - settings.VERY_STRONG:
        return pool
    return Pool((fit,), (fit, *pool.explored))


def _has_few_measurements(problem: SearchProblem) -> bool:
    return sum(problem.measured) < settings.MIN_SAMPLES_PER_TERM * int(problem.allowed.sum())
