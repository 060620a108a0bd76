"""The search for laws that have terms with parameters inside, from a law that has none.

Sets of terms that may explain each equation are proposed along curves that are near, see `term_sets`; those of
all equations are fitted to the trajectories, one equation's after the other, and the law of largest evidence gives
curves that are nearer. The law without such terms stays unless the evidence pays for the larger choice.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from commonlaw.inference import settings
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.propose.candidate_laws import LawsOfSets, tried_together, without_processes
from commonlaw.inference.propose.integral_ranking import CandidateSupport, matching_sets
from commonlaw.inference.propose.rational import matching_ratios
from commonlaw.inference.search.error_models import with_error_models
from commonlaw.inference.search.law_search import resolved
from commonlaw.inference.search.pool import Pool
from commonlaw.library import Offer
from commonlaw.likelihood import ErrorModel, Estimate
from commonlaw.runtime.progress import ProgressCallback, Stage


def with_parametric_terms(pool: Pool, offers: Sequence[Offer], progress: ProgressCallback) -> Pool:
    """Return a pool with laws that have some of what is offered besides the law among plain terms.

    Offers after the first are tried where `may_be_simpler`, and pay for what was to choose from before, too.
    """
    best = pool.best
    base = replace(best.problem, besides=len(best.problem.terms))  # The terms of a law are not yet among them
    base = base.under_white_noise if base.errors.of_law else base
    search = LawsOfSets(best, pool.explored, base, Offer(()))
    rows = search.rows_of_plain()
    for i, offer in enumerate(offers):
        fewest = 2 if i else -1  # The first is tried in any equation, and no ratio has fewer numbers
        if not offer.count:
            continue
        if i and not may_be_simpler(best, fewest):
            break
        search, best, rows = _with_offer(search.offering(offer, fewest), best, rows, progress)
    return Pool.of(search.listed(), search.explored)


def with_parametric_terms_under_errors(
    pool: Pool, before: ErrorModel, offers: Sequence[Offer], progress: ProgressCallback
) -> Pool:
    """Return a pool with laws that have some of what is offered, sought under errors of the measurements, too.

    Besides white noise, if there are any: under noise in proportion small values say more, where such terms may bend.
    Parameters are those of `with_parametric_terms`; the law is found with its errors, and such terms were sought under
    those `before`.
    """
    plain = pool.plain
    if plain is None or not any(each.count for each in offers):
        return pool
    errors = plain.problem.errors
    if errors.of_law or errors.kind in ("white", before.kind):
        return pool
    again = with_parametric_terms(Pool((plain,), pool.explored), offers, progress)
    again = with_error_models(again, None, (errors.kind,), progress)
    return pool.joined(again.fits, again.approximations)


def may_be_series(fit: Fit) -> bool:
    """Return whether a law has what may be the beginning of a series, cut off where the library ends.

    That are three powers of one variable with the same factor, in equal steps (as of an exponential function, or of a
    sine) up to the highest degree that is offered: a function with a constant inside says as much in two numbers.
    """
    terms = fit.problem.terms
    monomials = [each.exponents for each in terms.terms]
    highest = max((sum(each.values()) for each in monomials if each is not None), default=0)
    for support in fit.supports & terms.is_factor:
        chosen = [each for k in np.flatnonzero(support) if (each := monomials[k]) is not None]
        for last in (each for each in chosen if sum(each.values()) == highest):
            for column, power in last.items():
                others = {i: each for i, each in last.items() if i != column}
                before = [others | ({column: each} if each else {}) for each in range(power)]
                steps = range(1, power // 2 + 1)
                if any(before[power - step] in chosen and before[power - 2 * step] in chosen for step in steps):
                    return True
    return False


def may_be_simpler(fit: Fit, numbers: int) -> bool:
    """Return whether a law of richer terms may say more than one that was fitted, or as much in so few numbers."""
    return fit.supports.sum(axis=1).max() > numbers or bool(fit.lack_of_fit)


def _with_offer(
    search: LawsOfSets, best: Fit, rows: "tuple[CandidateSupport, ...]", progress: ProgressCallback
) -> "tuple[LawsOfSets, Fit, tuple[CandidateSupport, ...]]":
    """Return a search with the law of largest evidence, and its terms, on a mesh that is fine enough."""
    # States that follow the measurements with the help of the law, but may leave it, and those that were smoothed
    loose = next((each for each in search.explored if each.model_error >= settings.MODEL_ERRORS[-2]), None)
    near = ([loose.estimates] if loose else []) + [search.plain.problem.starts]
    curves = tuple(without_processes(search.plain, each) for each in near)
    if not best.lack_of_fit:  # Its solutions are as near as can be
        curves = (without_processes(best, best.estimates),)
    known = _Known()
    while True:
        best, rows, known = _searched(search, rows, curves, known, progress)
        worse = not best < search.plain
        finer = search.base.points if worse else resolved(Pool((best,)), progress).best.problem.points
        if finer <= search.base.points:
            return search, best, rows
        progress("fitting laws again on a finer mesh")
        search, estimates = search.on_finer_mesh(best, finer)
        curves = (estimates,)


class _Known(NamedTuple):
    """Sets of terms that were proposed for each equation.

    And minus twice the log-evidence of a law that explains what was measured, along whose curves they were.
    """

    sets: tuple[list[list[CandidateSupport]], ...] = ()
    value: float = -np.inf


def _searched(
    search: LawsOfSets,
    rows: "tuple[CandidateSupport, ...]",
    curves: Sequence[Sequence[Estimate]],
    known: _Known,
    progress: ProgressCallback,
) -> "tuple[Fit, tuple[CandidateSupport, ...], _Known]":
    """Return the law of largest evidence on one mesh, and its terms, from the terms of a law that is known.

    And the sets of terms that were proposed, besides those that are known.
    """
    departs = search.plain.has_model_error  # Which makes up for what one equation lacks while another has it
    best, left = search.plain, list(curves)
    if departs or any(row.others for row in rows):
        begun_with = search.fit(rows, curves[0])
        best = begun_with if begun_with.is_usable else best
    for number in range(settings.MAX_SWEEPS):
        before, begun, most = best, rows, _most(best, rows)
        near, *left = left
        # A law that is as likely proposed the same along its own curves; a finer mesh may show that it is not
        if not best.score.total < known.value + settings.MAX_MESH_CHANGE:
            progress(Stage("proposing parametric terms", number / settings.MAX_SWEEPS))
            sets = (*_proposed(search, best, rows, near), *known.sets)
            known = _Known(sets, best.score.total if number > 0 and not best.lack_of_fit else -np.inf)
        steps = len(rows) + 2  # All equations together, one after the other, and together what is best in each
        done = [
            partial(_stage, progress, (number + k / steps) / settings.MAX_SWEEPS, 1 / steps / settings.MAX_SWEEPS)
            for k in range(steps)
        ]
        if len(rows) > 1:
            best, rows = search.better(best, rows, _joint(known.sets, most), settings.MAX_PROPOSED, near, done[0])
        for j, own in enumerate(zip(*known.sets, strict=True)):
            few = [each for each in _in_turn(own) if each.numbers <= _most(best, rows)[j]]
            listed = [(*rows[:j], each, *rows[j + 1 :]) for each in few[: settings.MAX_TRIED_SETS]]
            best, rows = search.better(best, rows, listed, settings.MAX_REFINED, near, done[j + 1])
        if len(rows) > 1 and best.lack_of_fit:
            best, rows = search.better(best, rows, search.together(begun), settings.MAX_PROPOSED, near, done[-1])
        if best is not before:
            left = [without_processes(best, best.estimates), *(left if best.lack_of_fit else ())]
            rows = search.with_coefficients(rows, best)
            search.near.clear()
        if not left:
            break
    return *_with_fewer(search, best, rows, progress), known


def _with_fewer(
    search: LawsOfSets, best: Fit, rows: "tuple[CandidateSupport, ...]", progress: ProgressCallback
) -> "tuple[Fit, tuple[CandidateSupport, ...]]":
    """Return the law of largest evidence when terms are left out, one after the other, that it may do without."""
    done, before = partial(_stage, progress, 1.0, 0.0), None
    while best is not before and best is not search.plain:
        before, near = best, without_processes(best, best.estimates)
        best, rows = search.better(
            best, rows, list(search.with_one_less(best, rows)), settings.MAX_PROPOSED, near, done
        )
    return best, rows


def _in_turn(proposed: Sequence[Sequence[CandidateSupport]]) -> list[CandidateSupport]:
    """Return sets of several lists, each the most promising first: the best of each size before the second best."""
    ranks, found = Counter[tuple[int, int]](), dict[CandidateSupport, tuple[int, int]]()
    for number, own in enumerate(proposed):
        for each in own:
            found.setdefault(each, (ranks[number, each.numbers], each.numbers))
            ranks[number, each.numbers] += 1
    return sorted(found, key=lambda each: found[each])


def _joint(
    known: Sequence[Sequence[Sequence[CandidateSupport]]], most: Sequence[int]
) -> list[tuple[CandidateSupport, ...]]:
    """Return sets for all equations together, of lists of each equation's, the most promising first.

    The first of each, and those with most numbers of the first of each size, up to a size that all have.
    """
    found = dict[tuple[CandidateSupport, ...], None]()
    for proposed in known:
        found |= dict.fromkeys(product(*(own[: tried_together(len(proposed))] for own in proposed)))
    in_turn = [_in_turn(own) for own in zip(*known, strict=True)]
    for numbers in range(1, max(most) + 1):
        small = [[each for each in own if each.numbers <= numbers] for own in in_turn]
        if all(small):
            found[tuple(max(own, key=lambda each: each.numbers) for own in small)] = None
    return [rows for rows in found if all(row.numbers <= own for row, own in zip(rows, most, strict=True))]


def _most(best: Fit, rows: Sequence[CandidateSupport]) -> list[int]:
    """Return how many numbers are looked at in each equation: where noise explains the law, as many or fewer.

    Of exact measurements one more, where the law leaves as much as tells others apart.
    """
    if best.lack_of_fit:
        return [settings.MAX_NUMBERS] * len(rows)
    left = sum(each.deviance for each in best.estimates) / sum(best.problem.measured)
    is_exact = best.problem.least_variance >= 1
    return [row.numbers + int(is_exact and left > best.problem.counted.least) for row in rows]


def _proposed(
    search: LawsOfSets, best: Fit, rows: Sequence[CandidateSupport], estimates: Sequence[Estimate]
) -> Iterator[list[list[CandidateSupport]]]:
    """Yield sets of terms of each equation besides the best law so far and its terms, the most promising first.

    With others, and with ratios of sums. Where noise explains the law, equations that may not be simpler keep their
    terms.
    """
    sought = [bool(best.lack_of_fit) or row.numbers > search.fewest for row in rows]
    most = {j: own for j, (own, is_sought) in enumerate(zip(_most(best, rows), sought, strict=True)) if is_sought}
    hopeless = settings.MAX_SQUARES_RATIO if best.lack_of_fit else settings.MAX_DEVIANCE[0]
    listed = [matching_sets(search.base, estimates, search.offer.terms, most, hopeless)]
    if search.offer.ratios:
        listed.append(matching_ratios(search.base, estimates, search.offer.ratios, most, hopeless))
    for found in listed:
        yield [found.get(j, [row]) for j, row in enumerate(rows)]


def _stage(progress: ProgressCallback, begun: float, share: float, done: float) -> None:
    progress(Stage("fitting laws with nonlinear parameters", begun + share * done))
