"""What symbolic regression is compared by: its formulas are read, and their numbers counted, as they are."""

import numpy as np
import pytest

import commonlaw as cl
from benchmarks import symbolic

SYSTEMS = """
from types import SimpleNamespace
import numpy as np

SYSTEMS = {"decay": (("x",), ["-k*x"])}


def make(name, seed, noise):
    times, rates = np.linspace(0, 2, 60), (0.5, 0.8)
    objects = [[(times, start * np.exp(-k * times)[:, np.newaxis]) for start in (1.0, 2.0)] for k in rates]
    truth = [lambda t, z, k=k: [-k * z[0]] for k in rates]
    fresh = [np.column_stack([times, 3 * np.exp(-times)])] * 2
    return SimpleNamespace(states=("x",), order=1, objects=objects, truth=truth, fresh=fresh, numbers=[1], noise=noise)


def score(problem, models):
    points, right = problem.fresh[0], 0
    for (rates, numbers), true in zip(models, problem.truth):
        right += bool(np.allclose(rates(points)[:, 0], true(0, points[:, 1:].T)[0], rtol=1e-3) and numbers == [1])
    return {"name": "decay", "right": right, "objects": 2, "all_right": right == 2, "error": 0.0}
"""


def test_a_formula_is_what_operon_writes():
    formula = symbolic.Formula.of("((-0.50) + (2.25e+00 * (abs((1.5 * X1)) ^ (X12 - (-0.25)))))")
    points = np.random.default_rng(0).uniform(0.5, 2, (10, 12))
    expected = -0.5 + 2.25 * np.abs(1.5 * points[:, 0]) ** (points[:, 11] + 0.25)
    np.testing.assert_allclose(formula.values(points), expected, rtol=1e-14)


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("(0.0 + (1.0 * ((-1.2 * X1) / (0.8 + (1.0 * X1)))))", 2),  # A factor of everything is no number of its own
        ("(0.3 + (2.0 * (0.5 * X1)))", 2),
        ("X1", 0),
        ("(0.000001 + (2.0 * X1))", 1),  # Nor is what hardly matters
        ("((1.5 * X1) ^ 0.7)", 2),
        ("((0.1 * cos((0.9 * X1))) + (0.2 * X1))", 3),
    ],
)
def test_numbers_count_as_far_as_points_tell_them_apart(text, count):
    points = np.random.default_rng(0).uniform(0.5, 3, (200, 1))
    assert symbolic.Formula.of(text).count(points) == count


def test_numbers_of_a_law_are_coefficients_and_constants_inside_of_terms():
    law = cl.Law.from_text("x' = a - V*x/(K + x); y' = b y", {"a": 1.0, "V": 2.0, "K": 0.5, "b": -1.0})
    assert symbolic.counts(law, law.objects[0]) == [3, 1]


def test_derivatives_are_those_of_each_trial_alone():
    times = np.linspace(0, 3, 100)
    trials = [(times, np.sin(times + phase)[:, np.newaxis]) for phase in (0.0, 1.0)]
    variables, targets = symbolic.smoothed(trials, 2, True)
    assert variables.shape == (188, 3)
    np.testing.assert_allclose(targets[:, 0], -variables[:, 0], atol=2e-2)
    np.testing.assert_array_equal(variables[:94, 2], times[3:-3])


def test_laws_of_a_collection_are_scored(tmp_path, capsys):
    folder = tmp_path / "any_law"
    folder.mkdir()
    (folder / "systems.py").write_text(SYSTEMS)
    chosen = ["--problems", str(tmp_path), "--noise", "0", "--library", "poly:1", "--without", "operon"]
    symbolic.main(chosen)
    assert "| commonlaw | 0 % | 2 of 2 | 1 of 1 |" in capsys.readouterr().out


def test_a_collection_that_is_not_there_is_said(tmp_path, capsys):
    with pytest.raises(SystemExit):
        symbolic.main(["--problems", str(tmp_path)])
    assert "name its folder by --problems or COMMONLAW_BENCHMARKS" in capsys.readouterr().err
