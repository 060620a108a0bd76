"""Screening of hundreds of candidate terms before the search for supports, and a score test of all others after it.

Terms are selected for each equation by orthogonal matching pursuit on smoothed rates of all objects (Tropp and Gilbert
2007), with the runners-up of each step. Smoothed rates are less accurate than trajectories, so the screening is not
final: once a law is found, each excluded term is tested on the likelihood linearised about it (a score test), and is
readmitted if it would increase the evidence.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.formulation import LeastSquaresProblem
from commonlaw.inference import settings
from commonlaw.inference.data.noise import estimated_noise
from commonlaw.inference.data.smoothing import smooth_curves, terms_and_rates
from commonlaw.inference.data.subsampling import subsample
from commonlaw.inference.fit.fit import Fit
from commonlaw.library import Terms
from commonlaw.runtime.progress import check_memory
from commonlaw.text import counted
from commonlaw.trials import Trials


def screen_terms(trials: Trials, terms: Terms, known: Floats, needed: Bools) -> Bools:
    """Return which terms enter the search, shape (terms,): about forty, or all if there are at most seventy.

    Known coefficients have the shape (objects, equations, terms), NaN where they are estimated; `needed` terms, shape
    (terms,), are always kept.

    Raises `CommonlawError` if a trial is too short, a term is not finite on it, or the terms take more memory than
    there is.
    """
    if len(terms) <= settings.MAX_SEARCHED_TERMS:
        return np.ones(len(terms), dtype=np.bool_)
    objects = trials.objects
    size = 8 * (
        2 * (1 + known.shape[1]) * len(objects) * len(terms) ** 2 + 3 * settings.MAX_SCREENED_SAMPLES * len(terms)
    )
    check_memory(f"screening of {counted(len(terms), 'term')}", size, "take a smaller library")
    some = subsample(trials, estimated_noise(trials)[0], settings.MAX_SCREENED_SAMPLES)[0]
    order, factors = terms.variables.order_of(known.shape[1]), list[Floats]()
    for name, given in zip(objects, known, strict=True):
        pairs = [(trial, smooth_curves(trial, order)) for trial in some.of_object(name)]
        complete = [pair for pair in pairs if np.isfinite(pair[1][0]).all()]
        if complete:
            library, rates = terms_and_rates(terms, complete)
            factors.append(LeastSquaresProblem.of(library, rates - library @ np.nan_to_num(given).T).factor)
    allowed = np.isnan(known[0])
    kept = needed.copy()
    pursuits = [_matching_pursuit(np.array(factors), j, len(terms), free) for j, free in enumerate(allowed)]
    for _ in range(settings.MAX_TERMS):
        if kept.sum() >= settings.MAX_SCREENED_TERMS:
            break
        for pursuit in pursuits:
            kept[next(pursuit, [])] = True
    return kept


def terms_by_score_test(fit: Fit, terms: Terms) -> Bools:
    """Return which of the screened-out terms, shape (terms,), would increase the evidence of a law."""
    problem, kept = fit.problem, np.isin(terms.names, fit.problem.terms.names)
    if kept.all():
        return np.zeros_like(kept)
    inside = np.flatnonzero(kept)[fit.supports.any(axis=0)]
    is_selected, missed = np.isin(np.flatnonzero(kept), inside), np.zeros_like(kept)
    left_out = np.flatnonzero(~kept)
    for tried in np.array_split(left_out, -(-len(left_out) // settings.MAX_SCREENED_TERMS)):
        several = terms.take([*inside, *tried])

        def wider(values: Floats, new: float, count: int = len(tried)) -> Floats:
            selected = values[..., is_selected]
            return np.concatenate([selected, np.full((*selected.shape[:-1], count), new)], axis=-1)

        models = tuple(replace(model, terms=several) for model in problem.models)
        wide = replace(
            fit,
            problem=replace(problem, models=models, known=wider(problem.known, np.nan)),
            supports=wider(fit.supports.astype(np.float64), 0.0) > 0,
            estimates=tuple(
                replace(estimate, coefficients=wider(estimate.coefficients, 0.0)) for estimate in fit.estimates
            ),
            alternatives=(),
        )
        for listed in wide.neighbours():
            for more, support in listed:
                if more >= 0:
                    break
                missed[tried[support[len(inside) :]]] = True
    return missed


def _matching_pursuit(factors: Floats, equation: int, terms: int, allowed: Bools) -> Iterator[Indices]:
    """Yield in each step the terms that reduce the residual sum of squares most; the first is selected."""
    columns = factors[:, :, [*range(terms), terms + equation]]
    norms = np.sum(columns**2, axis=1)
    rest, free = columns, allowed.copy()
    while True:
        outside = np.sum(rest**2, axis=1)
        inner = np.einsum("opt,op->ot", rest, rest[..., -1])
        clear = outside > settings.COLLINEAR * norms
        gains = np.sum(np.divide(inner**2, outside, out=np.zeros_like(inner), where=clear), axis=0)[:-1]
        gains[~free] = 0.0
        best = np.argsort(-gains)[: settings.MAX_KEPT]
        if not gains[best[0]] > 0:
            return
        yield best[gains[best] > 0]
        free[best[0]] = False
        column = rest[:, :, best[0]]
        sizes = np.linalg.norm(column, axis=1, keepdims=True)
        is_clear = sizes**2 > settings.COLLINEAR * norms[:, best[:1]]
        basis = np.divide(column, sizes, out=np.zeros_like(column), where=is_clear)
        rest = rest - np.einsum("op,ot->opt", basis, np.einsum("op,opt->ot", basis, rest))
