"""Solvers by name, thresholds and constraints, and subsets against exhaustive search."""

from dataclasses import replace
from itertools import combinations, combinations_with_replacement

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from commonlaw.formulation import LeastSquaresProblem
from commonlaw.solvers import (
    L1,
    L2,
    SR3,
    STLSQ,
    BestSubset,
    ConstrainedSolver,
    Count,
    Lasso,
    Mean,
    Median,
    Quantile,
    StepwiseSelection,
    constrained_least_squares,
    parse_solver,
)
from commonlaw.solvers.subset_selection import _Search
from tests.refusals import message, refused

MAGNITUDES = np.array([[3.0, 0.0], [4.0, 0.2], [0.0, 0.1], [1.0, 0.3]])


@pytest.mark.parametrize(
    ("importance", "expected"),
    [
        (L1(), [8.0, 0.6]),
        (L2(), [np.sqrt(26), np.sqrt(0.14)]),
        (Mean(), [2.0, 0.15]),
        (Median(), [2.0, 0.15]),
        (Quantile(0.25), [0.75, 0.075]),
        (Count(0.2), [3, 2]),
    ],
)
def test_importance_of_a_term_over_the_objects(importance, expected):
    np.testing.assert_allclose(importance.measure(MAGNITUDES), expected)


def test_stlsq_repeats_until_the_support_is_stable():
    library = np.array([[1.0, 1.0], [1.0, 1.1], [1.0, 0.9], [1.0, 1.05]])
    target = np.array([[2.0], [2.0], [2.0], [2.1]])
    (fit,) = STLSQ(0.5, shared=False).solve([LeastSquaresProblem.of(library, target)], np.ones((1, 2), dtype=bool))
    full = np.linalg.lstsq(library, target, rcond=None)[0][:, 0]
    assert abs(full[1]) < 0.5 < abs(full[0])
    np.testing.assert_allclose(fit.coefficients[0], [target.mean(), 0])
    assert fit.largest == pytest.approx(target.mean())


def test_one_sweep_is_not_enough_and_says_so():
    generator = np.random.default_rng(1)
    library = generator.standard_normal((20, 3))
    target = library @ [[1.0], [0.01], [0.0]]
    (fit,) = STLSQ(threshold=0.5, max_iterations=1, shared=False).solve(
        [LeastSquaresProblem.of(library, target)], np.ones((1, 3), dtype=bool)
    )
    assert not fit.converged
    assert fit.support[0].tolist() == [True, False, False]


@pytest.mark.parametrize(
    ("text", "solver"),
    [
        ("stlsq:0.04", STLSQ(0.04, shared=False)),
        ("stlsq:0.04:ridge=1", STLSQ(0.04, ridge=1, shared=False)),
        ("group-stlsq:1.5", STLSQ(1.5)),
        ("group-stlsq:0.2:quantile:0.25", STLSQ(0.2, importance=Quantile(0.25))),
        ("group-stlsq:3:count:0.1:normalize=True", STLSQ(3, importance=Count(0.1), normalize=True)),
        ("best-subset", BestSubset()),
        ("best-subset:3", BestSubset(3)),
        ("forward:4:shared=False", StepwiseSelection(4, shared=False)),
        ("backward:2", StepwiseSelection(2, "backward")),
        ("lasso:0.01", Lasso(0.01)),
        ("sr3:0.5:nu=2", SR3(0.5, nu=2)),
    ],
)
def test_solvers_are_named_by_text(text, solver):
    assert parse_solver(text) == solver


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("stlqs:1", message("unknown-name", kind="solver", name="stlqs")),
        ("stlsq:-1", message("finite-number-bounded", name="threshold", value=-1, bound="of at least", least=0)),
        ("stlsq:nan", message("finite-number-bounded", name="threshold")),
        ("stlsq:big", message("finite-number-bounded", name="threshold", value="big")),
        ("group-stlsq:1:l3", message("unknown-name", kind="importance", name="l3")),
        ("group-stlsq:1:l1:3", message("importance-without-level", importance="l1")),
        ("group-stlsq:1:quantile:2", message("quantile-level", level=2)),
        ("group-stlsq:1:count:0", message("vote-magnitude", magnitude=0)),
        ("stlsq:1:2:3:4:5", "spec-syntax"),
        ("best-subset:0", message("whole-number", name="terms", value=0, bounds="of at least 1")),
        ("best-subset:2.5", message("whole-number", name="terms", value=2.5)),
        ("best-subset:nodes=0", message("whole-number", name="nodes", value=0)),
        ("forward:True", message("whole-number", name="terms")),
        ("forward:3:yes", message("shared-not-a-choice", shared="yes")),
        ("lasso:-0.1", message("finite-number-bounded", name="penalty", value=-0.1, bound="of at least", least=0)),
        ("sr3:1:nu=0", message("finite-number-bounded", name="nu", value=0, bound="above", least=0)),
    ],
)
def test_solvers_that_do_not_exist_or_fit_are_refused(text, expected):
    with refused(expected):
        parse_solver(text)


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
    ("matrix", "right", "expected"),
    [
        (np.eye(2, 11), np.zeros(2), message("constraints-shape", objects=3, terms=4, constraints=2, columns=12)),
        (np.ones((2, 12)), np.zeros(2), "constraints-dependent"),
        (np.ones((2, 12)), np.arange(2), "constraints-dependent"),
        (np.eye(2, 12), np.ones(2), "constraints-not-met"),
    ],
)
def test_constraints_that_do_not_fit_are_refused(matrix, right, expected):
    support = np.array([[True, False, True, True]] * 3)
    with refused(expected):
        constrained_least_squares(compressed(rows()), support, 0, matrix, right)


def test_a_wrapper_that_does_not_fit_is_refused():
    with refused("importance-own-terms"):
        STLSQ(shared=False, importance=Quantile(0.5))
    with refused("constraints-incomplete"):
        ConstrainedSolver(BestSubset(1), matrix=np.eye(1, 12))
    with refused("constraints-index", last=3):
        ConstrainedSolver(BestSubset(1), equal=(4,)).solve(compressed(rows()), EVERY)
    with refused("solver-without-value"):
        ConstrainedSolver(BestSubset()).solve(compressed(rows()), EVERY)


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


def scaled_residuals(rows, supports):
    """The sum over objects of squared residuals over the residual variance with all terms, of supports of one size."""
    total = np.zeros(len(supports))
    for library, target in rows:
        triangle = np.linalg.qr(np.column_stack([library / np.linalg.norm(library, axis=0), target]), mode="r")
        columns, right = triangle[:, :-1], triangle[:, -1]
        basis, _ = np.linalg.qr(columns[:, np.array(supports, dtype=int)].transpose(1, 0, 2))
        explained = np.sum(np.einsum("nqk,q->nk", basis, right) ** 2, axis=1)
        total += (right @ right - explained) / right[-1] ** 2 * (len(target) - columns.shape[1])
    return total


def places_of(candidate):
    return tuple(np.flatnonzero(candidate.support[0]).tolist())


@pytest.mark.parametrize("seed", range(4))
def test_best_subset_of_14_terms_equals_exhaustive_search(seed):
    rows, problems = problem(seed, terms=14)
    for candidate in BestSubset(largest=14, nodes=100_000).path(problems, 0, np.ones(14, dtype=bool))[:-1]:
        supports = [*combinations(range(14), int(candidate.hyperparameter))]
        assert candidate.proven
        assert places_of(candidate) == supports[np.argmin(scaled_residuals(rows, supports))]


@pytest.mark.parametrize("solver", [BestSubset(largest=20), StepwiseSelection(), StepwiseSelection(None, "backward")])
def test_objects_with_their_own_terms_are_solved_one_by_one(solver):
    _, problems = problem(8, terms=6, objects=3)
    allowed = np.ones(6, dtype=bool)
    path = replace(solver, shared=False).path(problems, 0, allowed)
    alone = [solver.path([problem], 0, allowed) for problem in problems]
    for index, candidate in enumerate(path):
        for own, row in zip(alone, candidate.support, strict=True):
            np.testing.assert_array_equal(row, own[index].support[0])


@pytest.mark.parametrize("seed", range(8))
def test_forward_selection_takes_the_term_that_lowers_the_residuals_most(seed):
    rows, problems = problem(seed)
    terms, inside = problems[0].terms, []
    path = StepwiseSelection().path(problems, 0, np.ones(terms, dtype=bool))
    for candidate in reversed(path):
        assert places_of(candidate) == tuple(sorted(inside))
        trials = [[*inside, index] for index in range(terms) if index not in inside]
        inside = trials[np.argmin(scaled_residuals(rows, trials))] if trials else inside


@pytest.mark.parametrize("seed", range(8))
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


def test_numbers_of_terms_whose_search_would_not_end_take_no_longer_than_two(monkeypatch):
    branched = []
    branch = _Search._branch

    def counted(search, node):
        branched.append(search.size)
        return branch(search, node)

    monkeypatch.setattr(_Search, "_branch", counted)
    generator = np.random.default_rng(0)
    (problem,) = compressed([(generator.standard_normal((12, 24)), generator.standard_normal(12))])
    path = BestSubset(nodes=200).path([problem], 0, np.ones(24, dtype=bool))
    least = min(int(candidate.hyperparameter) for candidate in path if not candidate.proven)
    assert 1 < least < 6
    assert sum(size >= least for size in branched) < 2 * 200 + 12


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
