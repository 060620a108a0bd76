"""A law that is too fast for the steps of the likelihood is told from one whose solutions it follows."""

from dataclasses import replace

import numpy as np

import commonlaw as cl
from commonlaw.formulation import law_variables
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.result.history import outcomes_of_fit
from commonlaw.inference.score.score import Score
from commonlaw.library import parse_library
from commonlaw.outcomes import OutcomeKind

TIMES = np.linspace(0, 8, 200)


def stated(library, coefficients, curve, model_error=0.0, noise=0.05):
    """A law with coefficients, and states on a curve that was measured with noise."""
    measured = curve + noise * np.random.default_rng(0).standard_normal(len(curve))
    trials = cl.Trials.from_arrays(TIMES, measured[:, np.newaxis], names=["x"])
    terms = parse_library(library).bind(law_variables(trials.schema, 1))
    problem = prepare(trials, terms, np.full((1, 1, len(terms)), np.nan), noise=np.array([noise]))
    (start,) = problem.starts
    estimate = replace(start, states=(curve[:, np.newaxis],), coefficients=np.array([coefficients]))
    return Fit(problem, np.ones((1, len(terms)), dtype=bool), (estimate,), model_error, Score({}))


def test_a_law_whose_solution_is_followed_is_solved():
    assert stated("terms:x", [-0.5], 3 * np.exp(-0.5 * TIMES)).is_solved


def test_steps_from_one_resting_point_to_the_next_follow_no_solution():
    resting = np.pi * np.random.default_rng(1).integers(20, 24, len(TIMES))  # Of sin(x), 12 rates of 20 in a step
    fit = stated("terms:sin(x)", [-500.0], resting.astype(float), model_error=0.5)
    assert not fit.is_resolved
    assert not fit.is_solved


def test_a_fit_that_is_no_solution_of_its_law_did_not_converge():
    resting = np.pi * np.random.default_rng(1).integers(20, 24, len(TIMES))
    (found, *_) = outcomes_of_fit(
        stated("terms:sin(x)", [-500.0], resting.astype(float)), is_converged=True, tried_errors=True
    )
    assert found.kind is OutcomeKind.NOT_CONVERGED
    solved = stated("terms:x", [-0.5], 3 * np.exp(-0.5 * TIMES))
    assert outcomes_of_fit(solved, is_converged=True, tried_errors=True) == ()
    (found,) = outcomes_of_fit(solved, is_converged=False, tried_errors=True)
    assert found.kind is OutcomeKind.NOT_CONVERGED


def test_what_a_law_errs_by_in_each_step_is_no_error_of_the_step():
    wandering = 3 * np.exp(-0.5 * TIMES) + np.cumsum(0.05 * np.random.default_rng(2).standard_normal(len(TIMES)))
    assert stated("terms:x", [-0.5], wandering, model_error=1.0).is_resolved


def test_a_law_whose_trajectories_diverge_is_not_solved():
    fit = stated("terms:x^2", [1.0], np.full(len(TIMES), 1.0))
    assert fit.diverges
    assert not fit.is_solved
