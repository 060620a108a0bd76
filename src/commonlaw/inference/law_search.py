"""The default way from trials to a law: search supports, perhaps take others, fit, and judge."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.inference.covariance import CovarianceKind, covariances
from commonlaw.inference.mesh_refinement import on_finer_mesh, until_resolved
from commonlaw.inference.provenance import alternatives, history, inclusion_probabilities, outcomes
from commonlaw.inference.search import SearchState, fit_supports, neighbours, polish, search
from commonlaw.inference.search_problem import SearchProblem, prepare
from commonlaw.law import Law
from commonlaw.progress import ProgressCallback
from commonlaw.solvers import AbstractSolver, BestSubset
from commonlaw.trials import Trials

PATH = BestSubset(largest=8, nodes=1)
"""Lists the candidates of an equation. They need not be proven the best: neighbours of the chosen are compared too."""


def find_law(
    trials: Trials,
    frame: Law,
    known: Floats,
    *,
    held_out_supports: Callable[[], Bools],
    universal: Bools,
    solver: AbstractSolver,
    noise: Floats | None,
    huber_threshold: float,
    covariance: CovarianceKind,
    partial_pooling: bool,
    seed: int,
    progress: ProgressCallback,
) -> Law:
    """Return the law of largest evidence: its terms, coefficients, their covariance, and every choice on the way.

    Parameters
    ----------
    trials
        What was measured.
    frame
        Terms, schema, order and objects of the law that is sought, and the coefficients that are known.
    known
        Coefficients that are known, NaN where they are to be found, shape (objects, equations, terms).
    held_out_supports
        Chooses supports, shape (equations, terms), by trials held out. Called for measurements that follow no law of
        the library: there evidence is gathered by terms that explain the model error.
    universal
        Coefficients that all objects have in common, shape (equations, terms).
    solver
        Whose path lists the candidates of each equation.
    noise
        Standard deviation of each state's measurement noise, shape (states,), if it is known.
    huber_threshold
        Standard deviations beyond which a measurement counts as an outlier, infinite for none.
    covariance
        How the coefficients' covariance is found, see `covariance.covariances`.
    partial_pooling
        Whether coefficients are drawn to their means as far as the objects are alike, see `Law.partial_pooling`.
    seed
        Of what is drawn.
    progress
        Takes what is being done.

    Raises
    ------
    CommonlawError
        If a trial is too short, a term is not finite on it, or the likelihood cannot be computed.
    """
    progress("estimating noise, smoothing")
    problem = prepare(trials, frame.terms, frame.order, known, noise=noise, huber_threshold=huber_threshold)
    problem, state = _searched(problem, solver, progress)
    if state.has_model_error:
        progress("the measurements depart from every law of this library: choosing terms by trials held out")
        state = fit_supports(problem, held_out_supports() & problem.allowed)

    def again(problem: SearchProblem, state: SearchState) -> SearchState:
        progress("choosing terms again on a finer mesh")
        return polish(problem, state.supports, state.estimates, state.model_error, solver)

    problem, state = until_resolved(problem, state, again)
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


def _searched(
    problem: SearchProblem, solver: AbstractSolver, progress: ProgressCallback
) -> tuple[SearchProblem, SearchState]:
    """Return what a search finds, on a finer mesh where a coarse one looks like a model error."""
    state = search(problem, solver, progress)
    while state.has_model_error:
        # The random walk is to be the same in twice as many steps
        finer = on_finer_mesh(problem, state, (state.model_error / np.sqrt(2),))
        if finer is None:
            break
        progress("searching again on a finer mesh")
        problem, _ = finer
        state = search(problem, solver, progress)
    return problem, state


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
