"""Laws of long trials and of many objects: supports are sought in some of them, and all weigh what is found there.

A search linearises the likelihood with all candidate terms many times; some thousand samples, of some objects, show it
the same supports as all. These choose again then, beginning with what was found, and so decide what few cannot tell.
"""

from collections.abc import Callable, Sequence

from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import fit_supports, fit_with, polish, search, with_close_neighbours
from commonlaw.inference.fit.fit import NO_ERROR, Fit
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.likelihood import threads_pay
from commonlaw.parallel import in_parallel
from commonlaw.progress import ProgressCallback, Stage, part


def few_of(problem: SearchProblem, prepared: Callable[..., SearchProblem]) -> list[SearchProblem]:
    """Return the problems of some of the samples or objects, none where there are few of both.

    Parameters
    ----------
    problem
        Of all.
    prepared
        Returns the problem of `most_samples`, see `prepare`.
    """
    objects, (size, count) = len(problem.models), settings.OBJECT_GROUPS
    groups = [range(first, objects, objects // size) for first in range(count)] if objects > size * count else []
    most = settings.FEW_SAMPLES * objects // size if groups else settings.FEW_SAMPLES
    if sum(map(len, problem.trials)) > 2 * most:
        fewer = prepared(most_samples=most)
        return [fewer.of_objects(each) for each in groups] or [fewer]
    return [problem.of_objects(each) for each in groups]


def search_by_few(problem: SearchProblem, few: Sequence[SearchProblem], progress: ProgressCallback) -> list[Fit]:
    """Return what a search finds, see `search`, where `few` are some of the samples or objects.

    Where the measurements depart from all laws by more than their noise, in few or in all, the size of that decides
    with the supports: these are sought in all then.
    """
    show = part(progress, 0.0, 0.7) if len(few) == 1 else lambda _: None
    pays = threads_pay(problem.models)
    best = [fits[0] for fits in in_parallel(lambda each: search(each, show), few, pays=pays)]
    if not any(fit.has_model_error for fit in best):
        progress(Stage("weighing by all samples what some of them show", 0.7))
        distinct = {fit.supports.tobytes(): fit for fit in best}.values()
        ways = in_parallel(lambda each: _chosen_again(problem, each), distinct, pays=pays)
        weighed = [fit for way in ways for fit in way]
        if all(fit.is_usable for fit in weighed):
            weighed = with_close_neighbours(weighed)
            if not weighed[0].has_model_error:
                return weighed
    return search(problem, progress, proposals=[fit.supports for fit in best] if len(few) > 1 else [])


def _chosen_again(problem: SearchProblem, fit: Fit) -> list[Fit]:
    """Return a law that some show with a model error, and without one chosen again by all."""
    large, _ = settings.SCHEDULES[1]
    if len(fit.estimates) == len(problem.starts):
        first = fit_with(problem, fit.supports, large, problem.starts_with(fit.estimates))
    else:
        first = fit_supports(problem, fit.supports, (large,))
    return [first, polish(problem, fit.supports, first.estimates or None, NO_ERROR)]
