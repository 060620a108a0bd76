"""Least squares under equality constraints, against the optimality conditions as one linear system."""

import numpy as np
import pytest

from commonlaw.diagnostics import Diagnostic
from commonlaw.formulation import LeastSquaresProblem
from commonlaw.solvers import BestSubset, ConstrainedSolver, constrained_least_squares
from tests.refusals import refused

TERMS = 4
EVERY = np.ones((1, TERMS), dtype=bool)


def rows(seed=0, objects=3, noise=0.3):
    generator = np.random.default_rng(seed)
    truth = np.array([[-9.8, 0.0, -0.4, 0.0], [-9.8, 0.0, -0.2, 0.0], [-9.8, 0.0, -0.9, 0.0]])[:objects]
    libraries = [generator.standard_normal((50, TERMS)) * [1.0, 10.0, 0.1, 1e3] for _ in truth]
    return [
        (library, library @ own + noise * generator.standard_normal(50))
        for library, own in zip(libraries, truth, strict=True)
    ]


def compressed(problem):
    return [LeastSquaresProblem.of(library, target[:, np.newaxis]) for library, target in problem]


def by_optimality_conditions(problem, support, matrix, right, weights=None):
    """Solve [[2 X'WX, C'], [C, 0]] [c, multipliers] = [2 X'Wy, d] over the terms of the support."""
    indices, size = np.flatnonzero(support), support.size
    gram, moment = np.zeros((size, size)), np.zeros(size)
    for index, (library, target) in enumerate(problem):
        weight = 1.0 if weights is None else weights[index]
        own = slice(index * TERMS, (index + 1) * TERMS)
        gram[own, own], moment[own] = 2 * weight * library.T @ library, 2 * weight * library.T @ target
    kept = matrix[:, indices]
    zero = np.zeros((len(kept), len(kept)))
    whole = np.block([[gram[np.ix_(indices, indices)], kept.T], [kept, zero]])
    solution = np.zeros(size)
    solution[indices] = np.linalg.solve(whole, np.concatenate([moment[indices], right]))[: len(indices)]
    return solution.reshape(support.shape)


@pytest.mark.parametrize("seed", range(5))
def test_constrained_least_squares_meets_its_optimality_conditions(seed):
    problem, generator = rows(seed), np.random.default_rng(seed + 100)
    support = np.array([[True, True, True, True], [True, False, True, True], [True, True, True, False]])
    matrix, right = generator.standard_normal((3, 3 * TERMS)), generator.standard_normal(3)
    found = constrained_least_squares(compressed(problem), support, 0, matrix, right)
    np.testing.assert_allclose(found, by_optimality_conditions(problem, support, matrix, right), rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(matrix @ found.ravel(), right, rtol=1e-12)
    assert not found[~support].any()


def test_without_constraints_it_is_least_squares():
    problem = compressed(rows())
    support = np.ones((3, TERMS), dtype=bool)
    found = constrained_least_squares(problem, support, 0, np.zeros((0, 3 * TERMS)), np.zeros(0))
    np.testing.assert_allclose(found, [problem.least_squares(support[0], 0) for problem in problem], rtol=1e-12)


def test_the_path_is_refitted_and_ends_where_constraints_need_terms():
    problem, matrix = compressed(rows()), np.zeros((1, 12))
    matrix[0, 0] = 1.0
    path = ConstrainedSolver(BestSubset(), matrix=matrix, right=np.array([-9.0])).path(problem, 0, EVERY[0])
    assert [candidate.hyperparameter for candidate in path] == [4, 3, 2, 1]
    for candidate in path:
        assert candidate.coefficients[0, 0] == pytest.approx(-9.0)
        assert not candidate.proven


def test_other_equations_are_left_as_they_are():
    library, target = rows()[0]
    problem = LeastSquaresProblem.of(library, np.column_stack([target, -target]))
    free = BestSubset(2).solve([problem, problem], np.ones((2, TERMS), dtype=bool))
    constrained = ConstrainedSolver(BestSubset(2), matrix=np.eye(1, 8), right=np.array([-5.0]), equation=1)
    fit = constrained.solve([problem, problem], np.ones((2, TERMS), dtype=bool))
    np.testing.assert_array_equal(fit[0].coefficients, free[0].coefficients)
    assert fit[1].coefficients[0, 0] == pytest.approx(-5.0)
    path = constrained.path([problem, problem], 0, EVERY[0])
    assert path[0].proven


def test_equal_terms_are_equal_among_the_objects_that_have_them():
    problem = rows()
    library, target = problem[2]
    problem[2] = (library, target + 9.8 * library[:, 0])
    (fit,) = ConstrainedSolver(BestSubset(1, shared=False), equal=(0,)).solve(compressed(problem), EVERY)
    assert fit.support[:, 0].tolist() == [True, True, False]
    assert fit.coefficients[0, 0] == pytest.approx(fit.coefficients[1, 0])
    assert fit.coefficients[0, 0] == pytest.approx(-9.8, abs=0.2)


@pytest.mark.parametrize(
    ("matrix", "right", "message"),
    [
        (
            np.eye(2, 11),
            np.zeros(2),
            Diagnostic("constraints-shape", {"objects": 3, "terms": 4, "constraints": 2, "columns": 12}),
        ),
        (np.ones((2, 12)), np.zeros(2), "constraints-dependent"),
        (np.ones((2, 12)), np.arange(2), "constraints-dependent"),
        (np.eye(2, 12), np.ones(2), "constraints-not-met"),
    ],
)
def test_constraints_that_do_not_fit_are_refused(matrix, right, message):
    support = np.array([[True, False, True, True]] * 3)
    with refused(message):
        constrained_least_squares(compressed(rows()), support, 0, matrix, right)


def test_a_wrapper_that_does_not_fit_is_refused():
    with refused("constraints-incomplete"):
        ConstrainedSolver(BestSubset(1), matrix=np.eye(1, 12))
    with refused("constraints-index", last=3):
        ConstrainedSolver(BestSubset(1), equal=(4,)).solve(compressed(rows()), EVERY)
    with refused("solver-without-value"):
        ConstrainedSolver(BestSubset()).solve(compressed(rows()), EVERY)
