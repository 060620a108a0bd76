"""The search for laws with parametric terms, starting from the best law among plain terms.

Candidate supports of each equation are proposed along estimated states, see `integral_ranking`. Laws with these
supports are fitted to the trajectories, one equation after the other, and the law of largest evidence gives better
states. The score contains the multiplicity of the larger library, so the law among plain terms is kept unless the
evidence against it pays for that.
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
from commonlaw.inference.propose.candidate_laws import ParametricSearch, max_joint_supports, without_processes
from commonlaw.inference.propose.integral_ranking import CandidateSupport, rank_supports
from commonlaw.inference.propose.rational import rank_ratios
from commonlaw.inference.search.error_models import with_error_models
from commonlaw.inference.search.law_search import resolved
from commonlaw.inference.search.pool import Pool
from commonlaw.library import Offer
from commonlaw.likelihood import ErrorModel, Estimate
from commonlaw.runtime.progress import ProgressCallback, Stage


def with_parametric_terms(pool: Pool, offers: Sequence[Offer], progress: ProgressCallback) -> Pool:
    """Return a pool with laws that contain offered terms, and the best law among plain terms.

    Offers are tried until one improves a law that is not `may_be_simpler`; their multiplicity includes that of the
    earlier ones.
    """
    best = pool.best
    base = replace(best.problem, excluded_terms=len(best.problem.terms))  # The terms of a law are not yet among them
    base = base.under_white_noise if base.errors.of_law else base
    search = ParametricSearch(best, pool.explored, base, Offer(()))
    rows = search.rows_of_plain()
    for i, offer in enumerate(offers):
        if not offer.count:
            continue
        if best is not pool.best and not may_be_simpler(best, 2):
            break
        # The first is tried in any equation; others where one of their terms alone, or a ratio, has fewer numbers
        numbers = [each.size + len(each.shared_parameters) for each in offer.terms]
        fewest = min(numbers, default=2) if i else -1
        # Its terms add to the number of candidate terms
        base = replace(search.base, excluded_terms=search.base.excluded_terms + offer.count)
        search = replace(search, base=base, offer=offer, fewest=fewest)
        search, best, rows = _with_offer(search, best, rows, progress)
    fits = [search.plain, *(fit for fit in search.fitted.values() if fit.is_usable)]
    return Pool.of(fits, search.explored)


def with_parametric_terms_under_errors(
    pool: Pool, before: ErrorModel, offers: Sequence[Offer], progress: ProgressCallback
) -> Pool:
    """Return a pool with laws that contain offered terms, searched for under other measurement errors than `before`.

    Under heteroscedastic noise small values have larger weights, and these may show a nonlinearity that white noise
    hides. Other parameters are those of `with_parametric_terms`.
    """
    plain = pool.plain
    if plain is None or not any(offer.count for offer in offers):
        return pool
    errors = plain.problem.errors
    if errors.of_law or errors.kind in ("white", before.kind):
        return pool
    again = with_parametric_terms(Pool((plain,), pool.explored), offers, progress)
    again = with_error_models(again, None, (errors.kind,), progress)
    return pool.joined(again.fits, again.approximations)


def is_truncated_series(fit: Fit) -> bool:
    """Return whether a law contains what may be a truncated power series.

    These are three powers of one variable with a common factor, in equal steps, as of an exponential function, a sine
    or a reciprocal: a term with the same values has one or two parameters. x and x^3 are the first of a sine.
    """
    terms = fit.problem.terms
    for support in fit.supports & terms.is_factor:
        chosen = [monomial for k in np.flatnonzero(support) if (monomial := terms.terms[k].exponents) is not None]
        for last in chosen:
            for column, power in last.items():
                others = {i: each for i, each in last.items() if i != column}
                before = [others | ({column: each} if each else {}) for each in range(power)]
                steps = range(1, power // 2 + 1)
                if any(before[power - step] in chosen and before[power - 2 * step] in chosen for step in steps):
                    return True
                if power == 3 and not others and before[1] in chosen:
                    return True
    return False


def may_be_simpler(fit: Fit, numbers: int) -> bool:
    """Return whether a fit has a lack of fit, or an equation with more than so many coefficients."""
    return fit.supports.sum(axis=1).max() > numbers or bool(fit.lack_of_fit)


def _with_offer(
    search: ParametricSearch, best: Fit, rows: "tuple[CandidateSupport, ...]", progress: ProgressCallback
) -> "tuple[ParametricSearch, Fit, tuple[CandidateSupport, ...]]":
    """Return a search with the law of largest evidence, and its terms, on a refined mesh."""
    # States of the law with a large model error, and smoothed measurements
    loose = next((each for each in search.explored if each.model_error >= settings.MODEL_ERRORS[-2]), None)
    near = ([loose.estimates] if loose else []) + [search.plain.problem.starts]
    curves = tuple(without_processes(search.plain, each) for each in near)
    if not best.lack_of_fit:  # Its solutions are the best states
        curves = (without_processes(best, best.estimates),)
    known = _Proposals()
    while True:
        best, rows, known = _run_search(search, rows, curves, known, progress)
        worse = not best < search.plain
        finer = search.base.points if worse else resolved(Pool((best,)), progress).best.problem.points
        if finer <= search.base.points:
            return search, best, rows
        progress("fitting laws again on a finer mesh")
        search, estimates = search.on_finer_mesh(best, finer)
        curves = (estimates,)


class _Proposals(NamedTuple):
    """Supports proposed for each equation, and -2 log evidence of the law along whose solutions they were proposed.

    It is minus infinity unless that law has no lack of fit.
    """

    sets: tuple[list[list[CandidateSupport]], ...] = ()
    value: float = -np.inf


def _run_search(
    search: ParametricSearch,
    rows: "tuple[CandidateSupport, ...]",
    curves: Sequence[Sequence[Estimate]],
    known: _Proposals,
    progress: ProgressCallback,
) -> "tuple[Fit, tuple[CandidateSupport, ...], _Proposals]":
    """Return the law of largest evidence on one mesh, its terms, and the proposed supports."""
    departs = search.plain.has_model_error  # Which compensates for terms that one equation lacks
    best, left = search.plain, list(curves)
    if departs or any(row.others for row in rows):
        begun_with = search.fit(rows, curves[0])
        best = begun_with if begun_with.is_usable else best
    for number in range(settings.MAX_SWEEPS):
        before, begun, most = best, rows, _max_parameters(best, rows)
        near, *left = left
        # Proposals along the solutions of an equally probable law would be the same
        if not best.score.total < known.value + settings.MAX_MESH_CHANGE:
            progress(Stage("proposing parametric terms", number / settings.MAX_SWEEPS))
            sets = (*_proposed(search, best, rows, near), *known.sets)
            known = _Proposals(sets, best.score.total if number > 0 and not best.lack_of_fit else -np.inf)
        steps = len(rows) + 2  # All equations jointly, each in turn, and combinations of the best of each
        done = [
            partial(_stage, progress, (number + k / steps) / settings.MAX_SWEEPS, 1 / steps / settings.MAX_SWEEPS)
            for k in range(steps)
        ]
        if len(rows) > 1:
            best, rows = search.improve(best, rows, _joint(known.sets, most), settings.MAX_PROPOSED, near, done[0])
        for j, own in enumerate(zip(*known.sets, strict=True)):
            few = [each for each in _interleaved(own) if each.numbers <= _max_parameters(best, rows)[j]]
            listed = [(*rows[:j], each, *rows[j + 1 :]) for each in few[: settings.MAX_TRIED_SETS]]
            best, rows = search.improve(best, rows, listed, settings.MAX_REFINED, near, done[j + 1])
        if len(rows) > 1 and best.lack_of_fit:
            best, rows = search.improve(
                best, rows, search.combine_equations(begun), settings.MAX_PROPOSED, near, done[-1]
            )
        if best is not before:
            left = [without_processes(best, best.estimates), *(left if best.lack_of_fit else ())]
            rows = search.with_coefficients(rows, best)
            search.near.clear()
        if not left:
            break
    return *_eliminate_terms(search, best, rows, progress), known


def _eliminate_terms(
    search: ParametricSearch, best: Fit, rows: "tuple[CandidateSupport, ...]", progress: ProgressCallback
) -> "tuple[Fit, tuple[CandidateSupport, ...]]":
    done, before = partial(_stage, progress, 1.0, 0.0), None
    while best is not before and best is not search.plain:
        before, near = best, without_processes(best, best.estimates)
        best, rows = search.improve(
            best, rows, list(search.drop_one_term(best, rows)), settings.MAX_PROPOSED, near, done
        )
    return best, rows


def _interleaved(proposed: Sequence[Sequence[CandidateSupport]]) -> list[CandidateSupport]:
    """Return the supports of several ranked lists, the best of each size before the second best."""
    ranks, result = Counter[tuple[int, int]](), dict[CandidateSupport, tuple[int, int]]()
    for number, own in enumerate(proposed):
        for each in own:
            result.setdefault(each, (ranks[number, each.numbers], each.numbers))
            ranks[number, each.numbers] += 1
    return sorted(result, key=lambda each: result[each])


def _joint(
    known: Sequence[Sequence[Sequence[CandidateSupport]]], most: Sequence[int]
) -> list[tuple[CandidateSupport, ...]]:
    """Return laws that combine the first of the ranked supports of all equations.

    For each number of parameters up to `most`, the largest support of that size or smaller of each equation is
    combined, too.
    """
    found = dict[tuple[CandidateSupport, ...], None]()
    for proposed in known:
        found |= dict.fromkeys(product(*(own[: max_joint_supports(len(proposed))] for own in proposed)))
    in_turn = [_interleaved(own) for own in zip(*known, strict=True)]
    for numbers in range(1, max(most) + 1):
        small = [[each for each in own if each.numbers <= numbers] for own in in_turn]
        if all(small):
            found[tuple(max(own, key=lambda each: each.numbers) for own in small)] = None
    return [rows for rows in found if all(row.numbers <= own for row, own in zip(rows, most, strict=True))]


def _max_parameters(best: Fit, rows: Sequence[CandidateSupport]) -> list[int]:
    """Return the largest number of parameters to try in each equation: that of a law without lack of fit.

    It is one more for exact measurements whose residuals are large enough to discriminate.
    """
    if best.lack_of_fit:
        return [settings.MAX_NUMBERS] * len(rows)
    left = sum(estimate.deviance for estimate in best.estimates) / sum(best.problem.measured)
    is_exact = best.problem.least_variance >= 1
    return [row.numbers + int(is_exact and left > best.problem.noise_scale.least) for row in rows]


def _proposed(
    search: ParametricSearch, best: Fit, rows: Sequence[CandidateSupport], estimates: Sequence[Estimate]
) -> Iterator[list[list[CandidateSupport]]]:
    """Yield ranked supports of each equation: with parametric terms, then with ratios of sums.

    If the best law has no lack of fit, equations with few parameters keep their terms.
    """
    sought = [bool(best.lack_of_fit) or row.numbers > search.fewest for row in rows]
    most = {
        j: own for j, (own, is_sought) in enumerate(zip(_max_parameters(best, rows), sought, strict=True)) if is_sought
    }
    listed = [rank_supports(search.base, estimates, search.offer.terms, most)]
    if search.offer.ratios:
        listed.append(rank_ratios(search.base, estimates, search.offer.ratios, most))
    for found in listed:
        yield [found.get(j, [row]) for j, row in enumerate(rows)]


def _stage(progress: ProgressCallback, begun: float, share: float, done: float) -> None:
    progress(Stage("fitting laws with nonlinear parameters", begun + share * done))
