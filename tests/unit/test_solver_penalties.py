"""LASSO against scikit-learn and its optimality conditions; SR3 against its own definition."""

import numpy as np
import pytest
from sklearn.linear_model import MultiTaskLasso

from commonlaw.formulation import LeastSquaresProblem
from commonlaw.solvers import SR3, Lasso
from commonlaw.solvers.lasso import minimize

EVERY = np.ones((1, 8), dtype=bool)


def rows(seed, objects=1, noise=0.5):
    """One design for all objects, with correlated columns of different scales."""
    generator = np.random.default_rng(seed)
    library = generator.standard_normal((80, 8)) @ (np.eye(8) + 0.3 * generator.standard_normal((8, 8)))
    truth = generator.standard_normal((8, objects)) * (np.arange(8) < 3)[:, np.newaxis]
    targets = library @ truth + noise * generator.standard_normal((80, objects))
    return library * 10.0 ** np.arange(-2, 6), targets


def in_standard_units(library, targets):
    """Columns of unit norm, and targets over the residual standard deviation with all terms."""
    coefficients = np.linalg.lstsq(library, targets, rcond=None)[0]
    variance = np.sum((library @ coefficients - targets) ** 2, axis=0) / (len(library) - library.shape[1])
    return library / np.linalg.norm(library, axis=0), targets / np.sqrt(variance)


@pytest.mark.parametrize("penalty", [0.5, 0.1, 0.03, 0.004])
@pytest.mark.parametrize("objects", [1, 3])
@pytest.mark.parametrize("seed", range(2))
def test_lasso_chooses_what_scikit_learn_chooses(seed, objects, penalty):
    library, targets = rows(seed, objects)
    unit, scaled = in_standard_units(library, targets)
    largest = np.linalg.norm(unit.T @ scaled, axis=1).max()
    peer = MultiTaskLasso(alpha=penalty * largest / 80, fit_intercept=False, tol=1e-12, max_iter=100_000)
    expected = peer.fit(unit, scaled).coef_.any(axis=0)
    problems = [LeastSquaresProblem.of(library, target[:, np.newaxis]) for target in targets.T]
    (fit,) = Lasso(penalty).solve(problems, EVERY)
    np.testing.assert_array_equal(fit.support, np.repeat(expected[np.newaxis], objects, axis=0))
    assert fit.converged


def test_the_minimum_of_the_group_lasso_meets_its_optimality_conditions():
    generator = np.random.default_rng(0)
    columns = generator.standard_normal((3, 40, 8)) @ (np.eye(8) + 0.2)
    gram = np.matmul(columns.transpose(0, 2, 1), columns)
    right = np.einsum("onp,on->op", columns, generator.standard_normal((3, 40)))
    minimum, reached = minimize(gram, right, 5.0, np.zeros((3, 8)), 100_000, 1e-13)
    gradient = right - np.einsum("opq,oq->op", gram, minimum)
    inside = minimum.any(axis=0)
    assert reached
    assert 0 < inside.sum() < 8
    norms = np.linalg.norm(minimum[:, inside], axis=0)
    np.testing.assert_allclose(gradient[:, inside], 5.0 * minimum[:, inside] / norms, atol=1e-8)
    assert np.linalg.norm(gradient[:, ~inside], axis=0).max() < 5.0


def test_a_penalty_whose_minimum_is_not_reached_says_so():
    library, target = rows(0)
    assert not Lasso(0.01, max_iterations=2).solve([LeastSquaresProblem.of(library, target)], EVERY)[0].converged


def sr3_by_its_definition(library, target, threshold, nu, turns=5000):
    """Alternate the two minimisations on the rows, columns of unit norm, one object."""
    norms = np.linalg.norm(library, axis=0)
    unit = library / norms
    sparse = np.linalg.lstsq(unit, target, rcond=None)[0]
    for _ in range(turns):
        stacked = np.concatenate([unit, np.eye(len(norms)) / np.sqrt(nu)])
        dense = np.linalg.lstsq(stacked, np.concatenate([target, sparse / np.sqrt(nu)]), rcond=None)[0]
        sparse = np.where(np.abs(dense / norms) >= threshold, dense, 0.0)
    return sparse != 0


@pytest.mark.parametrize("nu", [0.1, 1.0, 10.0])
def test_sr3_comes_to_rest_where_its_definition_does(nu):
    library, target = rows(2, noise=1.0)
    library = library / 10.0 ** np.arange(-2, 6)
    (fit,) = SR3(0.3, nu=nu).solve([LeastSquaresProblem.of(library, target)], EVERY)
    np.testing.assert_array_equal(fit.support[0], sr3_by_its_definition(library, target[:, 0], 0.3, nu, 300))
    assert fit.converged


def test_sr3_finds_a_known_truth_that_is_weak_in_one_object():
    generator = np.random.default_rng(1)
    truth = np.array([[2.0, 0.0, -1.0, 0, 0, 0, 0, 0], [1.5, 0.0, -0.1, 0, 0, 0, 0, 0]])
    libraries = [generator.standard_normal((200, 8)) for _ in truth]
    problems = [
        LeastSquaresProblem.of(library, (library @ own + 0.3 * generator.standard_normal(200))[:, np.newaxis])
        for library, own in zip(libraries, truth, strict=True)
    ]
    np.testing.assert_array_equal(SR3(0.3).solve(problems, EVERY)[0].support, np.repeat(truth[:1] != 0, 2, axis=0))
    assert SR3(0.3, shared=False).solve(problems, EVERY)[0].support.sum(axis=1).tolist() == [2, 1]
