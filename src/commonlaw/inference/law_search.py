"""The default way from trials to a law: search supports, perhaps take others, finish.

Each step returns what the next one takes.
"""

from dataclasses import dataclass, replace

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
    """

    frame: Law
    problem: SearchProblem
    state: SearchState
    solver: AbstractSolver


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
    state = search(problem, solver, progress)
    while state.has_model_error:  # As a coarse mesh looks, too
        # The random walk is to be the same in twice as many steps
        finer = on_finer_mesh(problem, state, (state.model_error / np.sqrt(2),))
        if finer is None:
            break
        progress("searching again on a finer mesh")
        problem, _ = finer
        state = search(problem, solver, progress)
    return LawSearch(frame, problem, state, solver)


def with_supports(found: LawSearch, supports: Bools) -> LawSearch:
    """Return a search with other supports, shape (equations, terms), and their model error of largest evidence.

    For measurements that follow no law of the library: there evidence is gathered by terms that explain the model
    error, and supports are better chosen otherwise.

    Raises
    ------
    CommonlawError
        If the likelihood cannot be computed.
    """
    return replace(found, state=fit_supports(found.problem, supports & found.problem.allowed))


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
        By `search_supports` or `with_supports`.
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
