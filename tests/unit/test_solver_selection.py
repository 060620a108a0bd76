"""Solvers by number of terms, against exhaustive search and plain refits on all rows."""

from dataclasses import replace
from itertools import combinations, combinations_with_replacement

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from commonlaw.formulation import LeastSquaresProblem
from commonlaw.solvers import BestSubset, StepwiseSelection


def problem(seed, terms=None, objects=None):
    """Rows of several objects with correlated, badly scaled columns and own noise levels."""
    generator = np.random.default_rng(seed)
    terms = terms or int(generator.integers(3, 11))
    truth = generator.random(terms) < 0.4
    mixing = np.eye(terms) + 0.7 * generator.standard_normal((terms, terms)) * generator.random()
    scales = 10.0 ** generator.integers(-3, 4, terms)
    rows = []
    for _ in range(objects or int(generator.integers(1, 4))):
        count = int(generator.integers(terms + 5, 80))
        library = generator.standard_normal((count, terms)) @ mixing
        noise = 10 ** generator.uniform(-1, 1) * generator.standard_normal(count)
        rows.append((library * scales, library @ (truth * generator.standard_normal(terms)) + noise))
    return rows, [LeastSquaresProblem.of(library, target[:, np.newaxis]) for library, target in rows]


def residual(library, target, indices):
    if not len(indices):
        return target @ target
    coefficients = np.linalg.lstsq(library[:, indices], target, rcond=None)[0]
    return np.sum((library[:, indices] @ coefficients - target) ** 2)


def scaled_residuals(rows, supports):
    """The sum over objects of squared residuals over the residual variance with all terms, by `lstsq` on the rows."""
    total = np.zeros(len(supports))
    for library, target in rows:
        unit = library / np.linalg.norm(library, axis=0)
        everything = residual(unit, target, [*range(unit.shape[1])])
        variance = everything / (len(target) - unit.shape[1])
        total += [residual(unit, target, [*indices]) / variance for indices in supports]
    return total


def scaled_residuals_by_gram(rows, supports):
    """The same by normal equations of orthogonalised columns: fast enough for all supports of 14 terms."""
    total = np.zeros(len(supports))
    for library, target in rows:
        triangle = np.linalg.qr(np.column_stack([library / np.linalg.norm(library, axis=0), target]), mode="r")
        columns, right = triangle[:, :-1], triangle[:, -1]
        chosen = columns[:, np.array(supports)].transpose(1, 0, 2)
        basis, _ = np.linalg.qr(chosen)
        explained = np.sum(np.einsum("nqk,q->nk", basis, right) ** 2, axis=1)
        variance = right[-1] ** 2 / (len(target) - columns.shape[1])
        total += (right @ right - explained) / variance
    return total


def places_of(candidate):
    return tuple(np.flatnonzero(candidate.support[0]).tolist())


@pytest.mark.parametrize("seed", range(10))
def test_best_subset_of_14_terms_equals_exhaustive_search(seed):
    rows, problems = problem(seed, terms=14)
    for candidate in BestSubset(largest=14, nodes=100_000).path(problems, 0, np.ones(14, dtype=bool))[:-1]:
        supports = [*combinations(range(14), int(candidate.hyperparameter))]
        assert candidate.proven
        assert places_of(candidate) == supports[np.argmin(scaled_residuals_by_gram(rows, supports))]


def test_fast_exhaustive_search_equals_least_squares_on_the_rows():
    rows, _ = problem(3, terms=7)
    supports = [*combinations(range(7), 3)]
    np.testing.assert_allclose(scaled_residuals_by_gram(rows, supports), scaled_residuals(rows, supports), rtol=1e-9)


@pytest.mark.parametrize("solver", [BestSubset(largest=20), StepwiseSelection(), StepwiseSelection(None, "backward")])
def test_objects_with_their_own_terms_are_solved_one_by_one(solver):
    _, problems = problem(8, terms=6, objects=3)
    allowed = np.ones(6, dtype=bool)
    path = replace(solver, shared=False).path(problems, 0, allowed)
    alone = [solver.path([problem], 0, allowed) for problem in problems]
    for index, candidate in enumerate(path):
        for own, row in zip(alone, candidate.support, strict=True):
            np.testing.assert_array_equal(row, own[index].support[0])


@pytest.mark.parametrize("seed", range(20))
def test_forward_selection_takes_the_term_that_lowers_the_residuals_most(seed):
    rows, problems = problem(seed)
    terms, inside = problems[0].terms, []
    path = StepwiseSelection().path(problems, 0, np.ones(terms, dtype=bool))
    for candidate in reversed(path):
        assert places_of(candidate) == tuple(sorted(inside))
        trials = [[*inside, index] for index in range(terms) if index not in inside]
        inside = trials[np.argmin(scaled_residuals(rows, trials))] if trials else inside


@pytest.mark.parametrize("seed", range(20))
def test_backward_elimination_drops_the_term_that_raises_the_residuals_least(seed):
    rows, problems = problem(seed)
    inside = [*range(problems[0].terms)]
    for candidate in StepwiseSelection(direction="backward").path(problems, 0, np.ones(len(inside), dtype=bool)):
        assert places_of(candidate) == tuple(inside)
        trials = [[*inside[:index], *inside[index + 1 :]] for index in range(len(inside))]
        inside = trials[np.argmin(scaled_residuals(rows, trials))] if trials else inside


def lorenz(noise, objects=10, samples=400):
    """Lorenz systems with different coefficients in a polynomial library of degree 5: 56 terms, condition near 1e6."""
    generator = np.random.default_rng(0)
    exponents = [each for degree in range(6) for each in combinations_with_replacement(range(3), degree)]
    problems = []
    for _ in range(objects):
        sigma, rho, beta = np.array([10, 28, 8 / 3]) * (1 + 0.05 * generator.standard_normal(3))

        def rates(_, state, sigma=sigma, rho=rho, beta=beta):
            x, y, z = state
            return np.array([sigma * (y - x), x * (rho - z) - y, x * y - beta * z])

        states = solve_ivp(rates, (0, 8), [1, 1, 20], t_eval=np.linspace(0, 8, samples), rtol=1e-6).y
        library = np.stack([np.prod(states[[*exponent]], axis=0) for exponent in exponents], axis=1)
        targets = rates(0, states) + noise * generator.standard_normal((3, samples))
        problems.append(LeastSquaresProblem.of(library, targets.T))
    return problems


def test_best_subset_proves_the_truth_among_56_terms_where_greedy_selection_errs():
    problems, truth = lorenz(noise=1.0), [(1, 2), (1, 2, 6), (3, 5)]
    allowed = np.ones((3, 56), dtype=bool)
    for target, indices in enumerate(truth):
        fit = BestSubset(len(indices)).solve([*problems], allowed)[target]
        assert tuple(np.flatnonzero(fit.support[0])) == indices
        assert fit.converged
        greedy = StepwiseSelection(len(indices)).solve(problems, allowed)[target]
        assert tuple(np.flatnonzero(greedy.support[0])) != indices


def test_a_search_that_runs_out_of_nodes_says_so():
    _, problems = problem(5, terms=14)
    allowed = np.ones((1, 14), dtype=bool)
    (fit,) = BestSubset(7, nodes=1).solve(problems, allowed)
    assert fit.support.sum(axis=1).tolist() == [7] * len(problems)
    assert not fit.converged
    path = BestSubset(largest=3).path(problems, 0, allowed[0])
    assert [candidate.proven for candidate in path] == [True] + [False] * 10 + [True] * 4


def test_objects_count_by_their_noise_and_not_by_their_size():
    generator = np.random.default_rng(0)
    library = generator.standard_normal((200, 3))
    small = library @ [1.0, 0.1, 0.0] + 0.01 * generator.standard_normal(200)
    large = 1e6 * (library @ [1.0, 0.0, 0.0] + generator.standard_normal(200))
    problems = [LeastSquaresProblem.of(library, target[:, np.newaxis]) for target in (small, large)]
    (fit,) = BestSubset(2).solve(problems, np.ones((1, 3), dtype=bool))
    assert fit.support[0].tolist() == [True, True, False]


def test_more_than_60_terms_are_searched_by_exchange_and_not_proven():
    generator = np.random.default_rng(0)
    library = generator.standard_normal((300, 150)) @ (np.eye(150) + 0.05 * generator.standard_normal((150, 150)))
    target = library[:, :5].sum(axis=1) + generator.standard_normal(300)
    (fit,) = BestSubset(8, nodes=50).solve(
        [LeastSquaresProblem.of(library, target[:, np.newaxis])], np.ones((1, 150), dtype=bool)
    )
    assert fit.support[0, :5].all()
    assert not fit.converged
