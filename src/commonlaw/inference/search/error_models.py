"""Error models, each with its supports and maximum-marginal-likelihood levels, and the choice among them."""

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import annealed, fit_solutions, fit_supports, fit_with, polish
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.search.error_levels import with_errors_of_kind
from commonlaw.inference.search.pool import Pool
from commonlaw.inference.search.setup import error_kinds
from commonlaw.likelihood import ERRORS
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.runtime.progress import ProgressCallback, Stage, part, unannounced

GROUPS = ("white", "measurement", "law")
"""White noise, other errors of measurements, and those of laws: the best of each is sought with its own law."""


def choose_errors(
    pool: Pool,
    *,
    errors: ErrorKind | Literal["auto"],
    propose: Callable[[Fit], Bools | None],
    progress: ProgressCallback,
) -> Pool:
    """Return a pool with the errors that are chosen.

    With ``"auto"`` they are those of largest evidence, where white noise does not explain the measurements. Compared
    are the supports of the pool, which is by `begin_search`, and those that are proposed by the best fit among plain
    terms, shape (equations, terms).
    """
    reason = pool.best.reason_for_errors if errors == "auto" else "as asked for"
    if not reason:
        return pool
    progress(Stage(f"{reason}: estimating errors jointly with the law", 0.2))
    kinds = error_kinds(errors, pool.best.problem.trials.schema)
    if errors == "auto" and not pool.best.lack_of_fit:
        known = pool.best.problem.errors.kind if pool.best.problem.errors else "proportional"
        kinds = tuple(each for each in kinds if each in ("white", known))
    proposed = None if pool.plain is None else propose(pool.plain)
    return with_error_models(pool, proposed, kinds, part(progress, 0.2, 0.9))


def with_error_models(
    pool: Pool, proposed: Bools | None, kinds: Sequence[ErrorKind], progress: ProgressCallback
) -> Pool:
    """Return a pool with the law of largest evidence, and errors of these kinds; its terms stay if they are given."""
    near = [*pool.fits[: 1 + settings.MAX_RIVALS]]
    if pool.plain is not None and pool.plain not in near and not any(fit.problem.solver for fit in near):
        near.append(pool.plain)
    fits, approximations = list[Fit](), list[Fit]()
    for fit in near:
        chosen, white = _with_error_model(fit, pool.explored, proposed, kinds, progress)
        fits.append(chosen)
        approximations += white
    return Pool.of(fits, pool.explored, approximations)


def _with_error_model(
    fit: Fit, explored: Sequence[Fit], proposed: Bools | None, kinds: Sequence[ErrorKind], progress: ProgressCallback
) -> tuple[Fit, list[Fit]]:
    """Return a fit with the errors of largest evidence, and if the law has process noise, that under white noise."""
    problem = fit.problem
    if problem.solver is None:
        compared = under_each_kind(problem, fit.supports, kinds)
    else:
        pools = of_each_group(fit, kinds, part(progress, 0.0, 0.5))
        others = [each.supports for each in explored] + ([] if proposed is None else [proposed & problem.allowed])
        progress(Stage("comparing laws under each error model", 0.5))
        compared = _under_all(pools, others)
        if compared:
            progress("comparing error models of the chosen law")
            compared += under_each_kind(problem, most_probable(compared).supports, kinds)
    if not compared:
        return fit, []
    # Given terms are fitted by least squares
    best = most_probable(compared, settings.VERY_STRONG if problem.solver is None else 0.0)
    kind, white = best.errors, [each for each in compared if each.errors == "white"]
    # Levels about the law itself, to the last digits: units and origins do not show
    exact = best if kind == "white" else with_errors_of_kind(best, kind)
    chosen = exact if exact.is_usable else best
    chosen = chosen.with_alternatives([each for each in compared if each.errors == kind])
    return chosen, [most_probable(white).with_alternatives(white)] if white and best.has_process_noise else []


def of_each_group(fit: Fit, kinds: Sequence[ErrorKind], progress: ProgressCallback) -> list[Pool]:
    """Return white noise, the best other errors of measurements, and the best of the law, each with its own law.

    The best are those of largest evidence with the supports that were found. The largest evidence comes first.
    """
    progress("comparing error models")
    starts, pools = under_each_kind(fit.problem, fit.supports, kinds), list[Pool]()
    for number, group in enumerate(GROUPS, start=1):
        show = part(progress, number / (len(GROUPS) + 1), (number + 1) / (len(GROUPS) + 1))
        of_group = [each for each in starts if ERRORS[each.errors].group == group]
        if of_group:
            start = min(of_group)
            show(f"searching for a law with {ERRORS[start.errors].label}")
            pools.append(_in_turn(start, show))
    return sorted((pool for pool in pools if pool.best.is_usable), key=lambda pool: pool.best.score)


@unannounced()
def under_each_kind(problem: SearchProblem, supports: Bools, kinds: Sequence[ErrorKind]) -> list[Fit]:
    """Return supports, shape (equations, terms), under each kind of errors that can be fitted, with its own levels."""
    fits, white = list[Fit](), problem.under_white_noise
    for begin in (white, problem) if problem.errors else (white,):
        solved = fit_solutions(begin, supports)
        own = [each for each in kinds if each != "walk" and (begin is white or each == problem.errors.kind)]
        fits += [with_errors_of_kind(solved, kind) for kind in own]
    if "walk" in kinds:
        fits.append(with_errors_of_kind(fit_supports(white, supports), "walk"))
    return [fit for fit in fits if fit.is_usable]


def _in_turn(fit: Fit, progress: ProgressCallback) -> Pool:
    """Return errors of a kind with the supports and the levels that are found in turn, and what was explored."""
    kind, explored = fit.errors, list[Fit]()
    for _ in range(settings.ALTERNATIONS):
        if fit.has_model_error:
            explored = [polish(fit.problem, fit.supports, fit.estimates, fit.model_error)]
        else:
            fits = sorted(annealed(fit.problem, progress, settings.SCHEDULES[:1]))
            explored = [each for each in fits if not each.has_model_error]
        others = [each for each in explored if not np.array_equal(each.supports, fit.supports)]
        changed = with_errors_of_kind(others[0], kind) if others else fit
        if not changed < fit:
            break
        fit = changed
    return Pool((fit,), explored)


@unannounced()
def _under_all(pools: Sequence[Pool], others: Sequence[Bools]) -> list[Fit]:
    """Return the supports that were found under any kind of errors under each: those of largest evidence there."""
    listed = [*(supports for pool in pools for supports in pool.proposals()), *others]
    most = max((pool.best.problem.most_terms for pool in pools[:1]), default=0)
    distinct = list({each.tobytes(): each for each in listed if each.sum(axis=1).max() <= most}.values())
    fits = list[Fit]()
    for pool in pools:
        values = [pool.best.evidence.value(each) for each in distinct]
        fits += [fitted_alike(pool.best, distinct[i]) for i in np.argsort(values)[: settings.MAX_PROPOSED]]
    return [fit for fit in fits if fit.is_usable]


def fitted_alike(fit: Fit, supports: Bools) -> Fit:
    """Return supports, shape (equations, terms), under errors of the kind of a fit, with levels of their own."""
    if fit.errors == "white":
        return fit_solutions(fit.problem, supports)
    return with_errors_of_kind(fit_with(fit.problem, supports, fit.model_error), fit.errors)


def most_probable(fits: Sequence[Fit], needed: float = 0.0) -> Fit:
    """Return the fit of largest evidence whose solutions exist along the trials that it was learned from.

    Errors other than white noise, under which coefficients are those of least squares, need so much evidence (2 log B).
    """
    ranked = sorted(fits, key=lambda fit: fit.score.total + (0.0 if fit.errors == "white" else needed))
    return next((fit for fit in ranked if fit.is_solved), ranked[0])
