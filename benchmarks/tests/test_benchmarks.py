"""The benchmarks run, and what they compare are laws: commonlaw's part of each, in its small size."""

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.accuracy import errors
from benchmarks.cases import CASES, DEGREES
from benchmarks.problem import Problem, lorenz_law

PARTS = [(case, who) for case in CASES for who in CASES[case].contestants if who.startswith("commonlaw")]


def truth(problem: Problem) -> np.ndarray:
    """The law behind samples of Lorenz's system or of the ring; terms go by degree, so the first are the same."""
    size = problem.states.shape[2]
    law = np.zeros((size, problem.terms))
    if size == 3:
        law[:, :10] = lorenz_law().law
    else:
        pairs = [(i, j) for i in range(size) for j in range(i, size)]
        for i in range(size):
            law[i, [0, 1 + i]] = 8, -1
            for other, sign in ((i + 1, 1), (i - 2, -1)):
                law[i, 1 + size + pairs.index(tuple(sorted((other % size, (i - 1) % size))))] = sign
    return law


@pytest.mark.parametrize(("name", "who"), [part for part in PARTS if part[0] != "simulate"])
def test_commonlaw_finds_the_law_in_every_case(name, who):
    problem = CASES[name].quick()
    found = CASES[name].contestants[who].prepare(problem)()
    laws = found if found.ndim == 3 else found[np.newaxis]
    for law, threshold in zip(laws, np.resize(problem.thresholds, len(laws)), strict=True):
        if threshold < 0.9:
            np.testing.assert_allclose(law, truth(problem), atol=0.05)
            assert ((law != 0) == (truth(problem) != 0)).all()


def test_the_simulated_trajectory_is_that_of_an_independent_integrator():
    from scipy.integrate import solve_ivp

    case = CASES["simulate"]
    problem = case.quick()
    states = case.contestants["commonlaw"].prepare(problem)()

    def field(_, x):
        return [10 * (x[1] - x[0]), x[0] * (28 - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]]

    exact = solve_ivp(field, (0, 1), [-8, 8, 27], "DOP853", problem.times, rtol=1e-12, atol=1e-12).y.T
    np.testing.assert_allclose(states, exact, atol=1e-5)


def test_the_streamed_law_is_the_law():
    problem = DEGREES["degree 2"].quick()
    law = DEGREES["degree 2"].contestants["commonlaw"].prepare(problem)()
    np.testing.assert_allclose(law, truth(problem), atol=0.05)


def test_errors_against_least_squares_on_all_rows_of_a_badly_scaled_library_are_small():
    generator = np.random.default_rng(0)
    columns, scales = generator.standard_normal((300, 5)), 10.0 ** np.arange(-8, 12, 4)
    assert max(errors(columns * scales, columns @ np.ones((5, 1)))) < 1e-12


@pytest.mark.slow
def test_the_benchmarks_run_and_find_the_same_law(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["", "--quick", "--case", "trials"])
    main()
    table = capsys.readouterr().out
    assert "| commonlaw |" in table
    assert "NO (" not in table
