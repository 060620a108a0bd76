"""What holds for every solver."""

from dataclasses import replace
from inspect import signature

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from commonlaw.formulation import LeastSquaresProblem
from commonlaw.solvers import IMPORTANCES, SOLVERS, STLSQ
from tests.refusals import refused

few = settings(max_examples=10)
SETTINGS = {"threshold": 0.3, "penalty": 0.2, "terms": 2}


def setting_of(maker):
    return next(name for name in SETTINGS if name in signature(maker).parameters)


def at(solver, value):
    name = solver.hyperparameter_name
    return replace(solver, **{name: int(value) if name == "terms" else value})


NAMED = [
    *((name, {setting_of(maker): SETTINGS[setting_of(maker)]}) for name, maker in SOLVERS.items()),
    *(
        (name, {setting_of(maker): SETTINGS[setting_of(maker)], "shared": False})
        for name, maker in SOLVERS.items()
        if "shared" in signature(maker).parameters
    ),
    *(("group-stlsq", {"threshold": 0.3, "importance": name}) for name in IMPORTANCES if name != "count"),
    ("group-stlsq", {"threshold": 2, "importance": "count", "level": 0.3}),
]
every_solver = pytest.mark.parametrize(
    "solver", [SOLVERS[name](**options) for name, options in NAMED], ids=lambda solver: repr(solver)
)
thresholding_solvers = pytest.mark.parametrize("name", ["stlsq", "group-stlsq"])
TRUTH = np.array([[2.0, 0.0, -1.0, 0.0], [1.5, 0.0, -0.7, 0.0], [0.9, 0.0, -2.0, 0.0]])
CANDIDATES = np.ones((1, 4), dtype=bool)


def problems(seed=0, noise=0.0, rows=60, scale=1.0):
    generator = np.random.default_rng(seed)
    libraries = [generator.standard_normal((rows, 4)) for _ in TRUTH]
    return [
        LeastSquaresProblem.of(
            library, scale * (library @ own + noise * generator.standard_normal(rows))[:, np.newaxis]
        )
        for library, own in zip(libraries, TRUTH, strict=True)
    ]


@every_solver
def test_the_truth_is_found_without_noise(solver):
    (fit,) = solver.solve(problems(), CANDIDATES)
    np.testing.assert_allclose(fit.coefficients, TRUTH, atol=1e-12)
    assert fit.converged


@every_solver
@few
@given(seed=st.integers(0, 10_000))
def test_the_order_of_objects_does_not_matter(solver, seed):
    given_order = problems(seed, noise=0.5)
    order = np.random.default_rng(seed).permutation(3)
    (fit,) = solver.solve(given_order, CANDIDATES)
    (shuffled,) = solver.solve([given_order[i] for i in order], CANDIDATES)
    np.testing.assert_allclose(shuffled.coefficients, fit.coefficients[order], rtol=1e-12)


@every_solver
@few
@given(seed=st.integers(0, 10_000))
def test_coefficients_are_least_squares_on_the_support_and_zero_elsewhere(solver, seed):
    given = problems(seed, noise=0.5)
    (fit,) = solver.solve(given, CANDIDATES)
    for problem, coefficient, support in zip(given, fit.coefficients, fit.support, strict=True):
        np.testing.assert_array_equal(coefficient, problem.least_squares(support, 0))
        assert not coefficient[~support].any()


@every_solver
def test_terms_that_are_no_candidates_stay_out(solver):
    allowed = np.array([[True, True, False, True]])
    assert not solver.solve(problems(), allowed)[0].support[:, 2].any()
    assert not any(candidate.support[:, 2].any() for candidate in solver.path(problems(noise=0.5), 0, allowed[0]))


@every_solver
def test_an_equation_without_candidates_stays_empty(solver):
    assert not solver.solve(problems(), np.zeros((1, 4), dtype=bool))[0].coefficients.any()
    assert solver.path(problems(), 0, np.zeros(4, dtype=bool))[-1].support.sum() == 0


@every_solver
def test_data_that_arrive_in_parts_give_the_same_fit(solver):
    parts = [problems(seed, noise=0.1) for seed in range(3)]
    merged = [a + b + c for a, b, c in zip(*parts, strict=True)]
    again = [a + (c + b) for a, b, c in zip(*parts, strict=True)]
    np.testing.assert_allclose(
        solver.solve(merged, CANDIDATES)[0].coefficients, solver.solve(again, CANDIDATES)[0].coefficients, rtol=1e-10
    )


@pytest.mark.parametrize("name", SOLVERS)
def test_the_support_does_not_depend_on_units_where_columns_are_normalised(name):
    setting, scales = setting_of(SOLVERS[name]), np.array([1e-3, 1.0, 1e4, 10.0])
    options = {"threshold": 3.0, "normalize": True} if setting == "threshold" else {setting: SETTINGS[setting]}
    solver = SOLVERS[name](**options)
    generator = np.random.default_rng(3)
    library = generator.standard_normal((100, 4))
    target = (library @ TRUTH[0] + 0.1 * generator.standard_normal(100))[:, np.newaxis]
    (plain,) = solver.solve([LeastSquaresProblem.of(library, target)], CANDIDATES)
    (scaled,) = solver.solve([LeastSquaresProblem.of(library * scales, target)], CANDIDATES)
    np.testing.assert_array_equal(plain.support, scaled.support)
    np.testing.assert_allclose(scaled.coefficients * scales, plain.coefficients, rtol=1e-9)
    assert 0 < plain.support.sum() < 4


@given(seed=st.integers(0, 10_000), threshold=st.floats(0.01, 3))
def test_the_group_solver_on_one_object_equals_stlsq(seed, threshold):
    for problem in problems(seed, noise=1.0):
        (group,) = STLSQ(threshold).solve([problem], CANDIDATES)
        (single,) = SOLVERS["stlsq"](threshold).solve([problem], CANDIDATES)
        np.testing.assert_array_equal(group.coefficients, single.coefficients)


@pytest.mark.slow
@every_solver
@few
@given(seed=st.integers(0, 10_000))
def test_the_path_runs_from_the_most_terms_to_none_and_holds_what_solve_finds(solver, seed):
    problem = problems(seed, noise=0.5)
    path = solver.path(problem, 0, CANDIDATES[0])
    sizes = [candidate.support.any(axis=0).sum() for candidate in path]
    assert sizes[0] == 4
    assert sizes[-1] == 0
    for candidate in path:
        if solver.hyperparameter_name == "terms" and candidate.hyperparameter == 0:
            continue
        (again,) = at(solver, candidate.hyperparameter).solve(problem, CANDIDATES)
        np.testing.assert_array_equal(again.coefficients, candidate.coefficients)


@thresholding_solvers
@few
@given(seed=st.integers(0, 10_000))
def test_thresholds_between_two_breakpoints_of_the_path_give_the_same(name, seed):
    problem = problems(seed, noise=0.5)
    path = SOLVERS[name]().path(problem, 0, CANDIDATES[0])
    (between,) = SOLVERS[name](threshold=(path[1].hyperparameter + path[2].hyperparameter) / 2).solve(
        problem, CANDIDATES
    )
    np.testing.assert_array_equal(between.support, path[1].support)


@every_solver
def test_a_solver_without_a_value_of_its_hyperparameter_says_so(solver):
    unset = replace(solver, **{solver.hyperparameter_name: None})
    assert solver.hyperparameter is not None
    assert unset.hyperparameter is None
    with refused("solver-without-value", hyperparameter=solver.hyperparameter_name):
        unset.solve(problems(), CANDIDATES)
