"""The default way from trials to a law: search supports, perhaps take others, finish.

Each step returns what the next one takes.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference.covariance import CovarianceKind, covariances
from commonlaw.inference.mesh_refinement import on_finer_mesh, until_resolved
from commonlaw.inference.provenance import alternatives, history, inclusion_probabilities, outcomes
from commonlaw.inference.search import SearchState, fit_solutions, fit_supports, nearest, neighbours, polish, search
from commonlaw.inference.search_problem import SearchProblem, prepare
from commonlaw.law import Law, Uncertainty
from commonlaw.progress import ProgressCallback
from commonlaw.selection import free_forecast_error
from commonlaw.solvers import AbstractSolver, BestSubset
from commonlaw.trials import Trials

PATH = BestSubset(largest=8, nodes=1)
"""Lists the candidates of an equation. They need not be proven the best: neighbours of the chosen are compared too."""

_SHARE = 0.65
"""Share of each trial's samples that laws are fitted to before they forecast the rest."""

_TOLERANCE = 0.1
"""Errors that are larger than the least by this share count as equal: one split of the trials knows no better."""

_Fit = Callable[[SearchProblem, Bools], tuple[SearchProblem, SearchState]]


@dataclass(frozen=True, eq=False)
class LawSearch:
    """A search for a law, as far as it has come.

    Parameters
    ----------
    frame
        Terms, schema, order and objects of the law that is sought, and the coefficients that are known.
    problem, state
        What was measured, and what was found so far.
    solver
        Whose path lists the candidates of each equation.
    found
        All that was found, the largest evidence first.
    """

    frame: Law
    problem: SearchProblem
    state: SearchState
    solver: AbstractSolver
    found: Sequence[SearchState]


def search_supports(
    trials: Trials,
    frame: Law,
    known: Floats,
    *,
    solver: AbstractSolver,
    noise: Floats | None,
    huber_threshold: float,
    progress: ProgressCallback,
) -> LawSearch:
    """Search for the supports of largest evidence.

    Parameters
    ----------
    trials
        What was measured.
    frame, solver
        See `LawSearch`.
    known
        Coefficients that are known, NaN where they are to be found, shape (objects, equations, terms).
    noise
        Standard deviation of each state's measurement noise, shape (states,), if it is known.
    huber_threshold
        Standard deviations beyond which a measurement counts as an outlier, infinite for none.
    progress
        Takes what is being done.

    Raises
    ------
    CommonlawError
        If a trial is too short, a term is not finite on it, or the likelihood cannot be computed.
    """
    progress("estimating noise, smoothing")
    problem = prepare(trials, frame.terms, frame.order, known, noise=noise, huber_threshold=huber_threshold)
    found = search(problem, solver, progress)
    while found[0].has_model_error:  # As a coarse mesh looks, too
        # The random walk is to be the same in twice as many steps
        finer = on_finer_mesh(problem, found[0], (found[0].model_error / np.sqrt(2),))
        if finer is None:
            break
        progress("searching again on a finer mesh")
        problem, _ = finer
        found = search(problem, solver, progress)
    return LawSearch(frame, problem, found[0], solver, found)


def with_best_forecast(search: LawSearch, other: Bools | None) -> LawSearch:
    """Return a search with the supports, and the way of fitting them, that forecast best.

    For measurements that follow no law of the library: there evidence is gathered by terms that explain the model
    error. All supports that were found, those next to the best, and other ones, shape (equations, terms), are fitted to
    the first part of every trial, so that trajectories are solutions of the law and noise holds what they leave, and
    with a model error; they are forecast freely over the rest. Of those near the least error the fewest terms are
    taken, and fitted to everything. Where nothing can be forecast, the other supports are taken.

    Raises
    ------
    CommonlawError
        If the likelihood cannot be computed.
    """
    others = [] if other is None else [other & search.problem.allowed]
    listed = [*(each.supports for each in search.found), *nearest(search.problem, search.state), *others]
    compared = tuple(each for each in _forecasts(search, listed) if np.isfinite(each[0]))
    bound = (1 + _TOLERANCE) * min((error for error, *_ in compared), default=0.0)
    for _, supports, fit in sorted(compared, key=lambda each: (each[0] > bound, each[1].sum(), each[0])):
        with suppress(CommonlawError):
            problem, state = fit(search.problem, supports)
            return replace(
                search, problem=problem, state=replace(state, forecasts=tuple(each[:2] for each in compared))
            )
    return replace(search, state=fit_supports(search.problem, others[0])) if others else search


def _forecasts(search: LawSearch, listed: Sequence[Bools]) -> Iterator[tuple[float, Bools, _Fit]]:
    """Yield the error of free forecasts by supports that are fitted in each way to the first part of every trial."""
    problem, frame, trials = search.problem, search.frame, search.problem.trials
    first = trials.with_trials([trial.cut(int(np.ceil(_SHARE * len(trial)))) for trial in trials])
    threshold = problem.models[0].observation.huber_threshold
    try:
        part = prepare(first, frame.terms, frame.order, problem.known, noise=problem.noise, huber_threshold=threshold)
    except CommonlawError:
        return
    while part.points < problem.points:
        part = part.finer()
    ways: tuple[_Fit, ...] = fit_solutions, lambda given, supports: (given, fit_supports(given, supports))
    for supports, fit in product({each.tobytes(): each for each in listed}.values(), ways):
        try:
            own, state = fit(part, supports)
        except CommonlawError:
            continue
        coefficients = np.array([each.coefficients for each in state.estimates])
        law = replace(frame, coefficients=coefficients, uncertainty=Uncertainty(noise=own.noise))
        yield free_forecast_error(law, trials, first), supports, fit


def finish(
    found: LawSearch,
    *,
    covariance: CovarianceKind,
    universal: Bools,
    partial_pooling: bool,
    seed: int,
    progress: ProgressCallback,
) -> Law:
    """Return the law that was found: its terms, coefficients, their covariance, and every choice on the way.

    Parameters
    ----------
    found
        By `search_supports` or `with_best_forecast`.
    covariance
        How the coefficients' covariance is found, see `covariance.covariances`.
    universal
        Coefficients that all objects have in common, shape (equations, terms).
    partial_pooling
        Whether the others are drawn to their means as far as the objects are alike, see `Law.partial_pooling`.
    seed
        Of what is drawn.
    progress
        Takes what is being done.
    """

    def again(problem: SearchProblem, state: SearchState) -> SearchState:
        if state.forecasts:
            return state
        progress("choosing terms again on a finer mesh")
        return polish(problem, state.supports, state.estimates, state.model_error, found.solver)

    frame = found.frame
    problem, state = until_resolved(found.problem, found.state, again)
    progress("judging terms and coefficients")
    compared = [
        [replace(each, support=each.support | given) for each in listed]
        for given, listed in zip(frame.support, neighbours(problem, state), strict=True)
    ]
    law = fitted_law(frame, problem, state, covariance, seed)
    law = replace(
        law,
        uncertainty=replace(law.uncertainty, inclusion_probabilities=inclusion_probabilities(compared)),
        provenance=replace(
            frame.provenance,
            outcomes=outcomes(frame, problem, state),
            alternatives=alternatives(frame, compared),
            history=history(frame, problem, state, compared),
        ),
    )
    return law.partial_pooling(universal, partial_pooling)


def fitted_law(law: Law, problem: SearchProblem, state: SearchState, covariance: CovarianceKind, seed: int) -> Law:
    """Return the law with the coefficients of a state, their covariance, and the noise."""
    return replace(
        law,
        coefficients=np.array([each.coefficients for each in state.estimates]),
        uncertainty=replace(
            law.uncertainty,
            covariance=covariances(problem, state, covariance, seed),
            shared_factor=None,
            noise=problem.noise,
        ),
    )
