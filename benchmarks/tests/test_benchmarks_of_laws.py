"""What commonlaw's laws are measured by is right: bounds, intervals, and the words of a collection of problems."""

import json
import math
import re

import numpy as np
import pytest
from scipy.optimize import curve_fit

import commonlaw as cl
from benchmarks import choice, cost, coverage, cramer_rao, discovery, discrepancy, orders, small_problems, universal
from benchmarks.discovery import LEVELS, ROWS
from benchmarks.draws import Stated, plain_regression
from benchmarks.families import FAMILIES, experiment
from benchmarks.mixed_orders import MIXED
from benchmarks.published import shares, table
from benchmarks.variational import cramer_rao as bounds_of, solve
from commonlaw.differentiation import parse_differentiation
from commonlaw.library import Variables

COLLECTION = """
import argparse, importlib, json, os, sys
import numpy as np
parser = argparse.ArgumentParser()
for name in ("method", "bench", "noise", "seeds", "jobs", "only", "out"):
    parser.add_argument(f"--{name}")
given = parser.parse_args()
sys.path.insert(0, os.getcwd())
module, function = given.method.split(":")
times = np.linspace(0, 2, 60)
objects = [([times], [start * np.exp(-0.5 * times)[:, np.newaxis]]) for start in (1.0, 2.0)]
models = getattr(importlib.import_module(module), function)(objects, {"names": ["1", "x0"], "degree": 1, "trig": False})
right = all(abs(model[0]["x0"] + 0.5) < 1e-3 and len(model[0]) == 1 for model in models)
score = {"bench": given.bench, "name": "decay", "noise": float(given.noise), "trials": 2, "seed": 0}
measures = {"all_exact": int(right), "f1": 1.0, "coef_err": 0.0, "r2_ok": 1.0, "seconds": 0.1}
with open(given.out, "w") as file:
    json.dump([] if given.only == "other" else [score | measures], file)
"""

RELATIONS = """
import numpy as np
import pandas as pd

FAMILIES = {"decays": {"order": 1, "library": "poly:1"}}


def make(name, seed, noise, objects):
    generator, times = np.random.default_rng(seed), np.linspace(0, 5, 40)
    parts = []
    for o, resistance in enumerate(np.exp(generator.uniform(0, 2, objects + 1))):
        states = 5 * np.exp(-times / resistance) + noise * generator.standard_normal(40)
        parts.append(pd.DataFrame({"object": f"o{o}", "trial": 1, "t": times, "U": states, "resistance": resistance}))
    return pd.concat(parts), TRUTH
"""


def test_the_bound_of_a_decay_is_that_of_its_closed_form():
    times, rate, start, noise = np.linspace(0, 3, 40), -0.7, 2.0, 0.05
    runs = [solve(("x",), (("x",),), np.array([rate]), np.array([each]), times) for each in (start, 2 * start)]
    decay, information = np.exp(rate * times), 0.0
    for begin in (start, 2 * start):
        by_rate = begin * times * decay
        information += by_rate @ by_rate - (by_rate @ decay) ** 2 / (decay @ decay)
    np.testing.assert_allclose(bounds_of(runs, np.array([noise])), [noise / math.sqrt(information)], rtol=1e-7)


def test_the_bound_of_a_free_fall_is_that_of_a_quadratic_fit_to_its_heights():
    times, noise = np.linspace(0, 3, 30), 0.1
    run = solve(("x", "v"), (("1",),), np.array([-9.8]), np.array([48.0, 0.3]), times)
    design = np.stack([times**2 / 2, np.ones(30), times], axis=1)
    expected = noise * np.sqrt(np.linalg.inv(design.T @ design)[0, 0])
    np.testing.assert_allclose(bounds_of([run], np.array([noise])), [expected], rtol=1e-7)


def test_derivatives_of_a_trajectory_are_those_of_differences():
    family = FAMILIES["Lorenz"]
    coefficients, start = np.array([-10, 10, 28, -1, -1, -8 / 3, 1.0]), np.array([-8.0, 8.0, 27.0])
    times = np.linspace(0, 0.5, 6)

    def states(change_of_coefficients, change_of_start):
        changed = coefficients + change_of_coefficients, start + change_of_start
        return solve(family.variables, family.equations, *changed, times).states

    run, step = solve(family.variables, family.equations, coefficients, start, times), 1e-4
    for i, change in enumerate(step * np.eye(7)):
        slope = (states(change, 0) - states(-change, 0)) / (2 * step)
        np.testing.assert_allclose(run.by_coefficients[:, :, i], slope, rtol=1e-4, atol=1e-4)
    for i, change in enumerate(step * np.eye(3)):
        slope = (states(0, change) - states(0, -change)) / (2 * step)
        np.testing.assert_allclose(run.by_start[:, :, i], slope, rtol=1e-4, atol=1e-4)


def test_errors_as_large_as_their_bounds_have_the_ratio_one():
    truth, bounds = np.array([[1.0, 2.0]]), np.array([[0.1, 0.01]])
    both = [truth + bounds, truth - bounds]
    assert cramer_rao.relative_errors(both, truth, bounds) == pytest.approx((1, 1))
    typical, largest = cramer_rao.relative_errors([truth + bounds * [3, 1]], truth, bounds)
    assert (typical, largest) == pytest.approx((math.sqrt(5), 3))


@pytest.mark.parametrize("name", FAMILIES)
def test_plain_regression_on_trials_without_noise_finds_the_coefficients(name):
    known = experiment(name, objects=1)
    found = plain_regression(known, known.measured(0.0, 0), parse_differentiation("finite:6"))
    np.testing.assert_allclose(found, known.coefficients, rtol=0.02)


def test_normal_errors_of_the_stated_size_are_covered_as_often_as_stated():
    generator, truth, errors = np.random.default_rng(0), np.zeros((2, 3)), np.array([[1.0, 0.1, 5.0]] * 2)
    draws = [Stated(errors * generator.standard_normal((2, 3)), errors) for _ in range(1000)]
    share = coverage.held([*draws, None], truth).mean()
    low, high = coverage.interval(share, 6000)
    assert low < 0.95 < high < low + 0.02


def test_the_library_has_the_names_of_the_collection():
    library = discovery.library_of({"degree": 2, "trig": True})
    names = library.bind(Variables(("x0", "x1"), (), "t")).names
    assert set(names) == {
        *("1", "x0", "x1", "x0^2", "x0 x1", "x1^2"), "sin(x0)", "cos(x0)", "sin(x1)", "cos(x1)",
    }  # fmt: skip


@pytest.mark.slow
def test_a_law_of_heights_comes_back_as_a_model_of_heights_and_rates():
    times = np.linspace(0, 3, 60)
    objects = []
    for drag in (0.2, 0.4):
        fallen = 9.8 / drag * (times - (1 - np.exp(-drag * times)) / drag)
        objects.append(([times, times], [48 - fallen[:, np.newaxis], 47 - fallen[:, np.newaxis]]))
    models = discovery.method(objects, {"degree": 2, "trig": False, "observed": [0]})
    for model, drag in zip(models, (0.2, 0.4), strict=True):
        assert model[0] == {"x1": 1.0}
        assert model[1] == pytest.approx({"1": -9.8, "x1": -drag}, rel=1e-2)


def test_a_law_of_several_states_comes_back_under_the_names_of_its_terms(monkeypatch):
    def found(trials, *, order, library, method):
        assert method.strange_objects == "keep"
        terms = library.bind(Variables(trials.schema.states, (), "t"))
        coefficients = np.zeros((2, 2, len(terms)))
        coefficients[:, 0, terms.index("x1")] = 1
        coefficients[:, 1, terms.index("x0^2*x1")] = [-2, -3]
        return cl.Law(terms, trials.schema, order, trials.objects, coefficients)

    monkeypatch.setattr(cl, "discover", found)
    objects = [([np.arange(5.0)], [np.zeros((5, 2))])] * 2
    models = discovery.method(objects, {"degree": 3, "trig": False, "observed": None})
    assert models == [[{"x1": 1.0}, {"x0^2 x1": -2.0}], [{"x1": 1.0}, {"x0^2 x1": -3.0}]]


@pytest.mark.slow
def test_a_collection_is_run_and_its_scores_stand_beside_baselines_and_goals(tmp_path, capsys):
    (tmp_path / "run.py").write_text(COLLECTION)
    out = tmp_path / "scores.json"
    common = ["--problems", str(tmp_path), "--bench", "grouped", "--jobs", "1"]
    discovery.main([*common, "--noise", "0", "0.01", "--out", str(out)])
    printed = capsys.readouterr().out
    assert "| grouped, every support right | commonlaw | 1.00 | 1.00 |" in printed
    assert "|  | best baseline | 1.00 | 0.81 |" in printed
    assert "Not right at 1 %: none." in printed
    assert [score["noise"] for score in json.loads(out.read_text())] == [0, 0.01]
    with pytest.raises(SystemExit):
        discovery.main([*common, "--noise", "0", "--only", "other"])
    assert "no problem named other" in capsys.readouterr().err


@pytest.mark.parametrize("benchmark", [discovery, universal])
def test_a_missing_collection_is_refused(benchmark, tmp_path, capsys):
    with pytest.raises(SystemExit):
        benchmark.main(["--problems", str(tmp_path)])
    assert "name its folder by --problems or COMMONLAW_BENCHMARKS" in capsys.readouterr().err


@pytest.mark.slow
def test_relations_of_a_collection_stand_beside_the_truth(tmp_path, capsys):
    for power, right in ((-1, "1 of 1"), (-2, "0 of 1")):
        folder = tmp_path / str(power) / "universal"  # Two files of one name and size may count as compiled already
        folder.mkdir(parents=True)
        truth = {"U'": {"U": ("power", -1.0, {"resistance": power})}}
        (folder / "families.py").write_text(f"{RELATIONS}\nTRUTH = {truth!r}\n")
        universal.main(["--problems", str(folder.parent), "--seeds", "1", "--noise", "0.01"])
        printed = capsys.readouterr().out
        assert f"| 10 objects | 1 | {right} |" in printed
        assert ("- 10 objects, 1 %, decays 0: U in U' is power law 1/resistance" in printed) == (power == -2)


@pytest.mark.slow
def test_bounds_intervals_and_cost_of_a_small_experiment_are_printed(capsys):
    cramer_rao.main(["--families", "heights of balls", "--draws", "1", "--noise", "0.001"])
    assert "| heights of balls | 0.1 | 1 of 1 |" in capsys.readouterr().out
    coverage.main(["--families", "heights of balls", "--draws", "1", "--noise", "0.001"])
    assert "| heights of balls | 0.1 | 1 of 1 | 10 | " in capsys.readouterr().out
    cost.main(["--objects", "1", "--repeats", "1", "--noise", "0.01", "--kernel", "5 drops", "--threads", "5 drops"])
    printed = capsys.readouterr().out
    assert re.search(r"\| yes \|\n", printed)
    beside_numpy, two_threads = (line for line in printed.splitlines() if line.startswith("| 5 drops"))
    assert re.search(r"\| yes \(\d", beside_numpy)
    assert re.search(r"\| yes \| \d", two_threads)


@pytest.mark.slow
def test_falls_and_drops_are_compared_with_their_truth():
    held, *_, claimed = discrepancy.fallen(0, 1.5)[:7]
    assert (held, claimed) == (True, True)
    assert discrepancy.claimed(0)[0] == 0


@pytest.mark.slow
def test_a_small_problem_is_the_same_for_a_seed_and_its_terms_are_as_sure_as_its_kind_says():
    strong, weak = (next(each for each in small_problems.KINDS if each.weak is wanted) for wanted in (False, True))
    problem = small_problems.draw(strong, 4)
    again = small_problems.draw(strong, 4)
    np.testing.assert_array_equal(problem.trials[0].states, again.trials[0].states)
    assert problem.support == (("x",),)  # So that the errors of a decay in closed form can tell
    truth = float(problem.coefficients[0, 0])
    times, states = problem.trials[0].times, problem.trials[0].states[:, 0]
    found, covariance = curve_fit(lambda t, start, rate: start * np.exp(rate * t), times, states, [states[0], truth])
    assert abs(found[1] - truth) < 4 * math.sqrt(covariance[1, 1])
    assert abs(truth) > small_problems.STRONG / 2 * math.sqrt(covariance[1, 1])
    assert small_problems.draw(weak, 0).kind is weak


@pytest.mark.slow
def test_the_choice_of_a_law_is_scored_by_what_is_true_and_constants_are_put_back():
    found = choice.score_of("one object", 4)
    assert found.right
    assert found.listed
    assert not found.empty
    assert (found.intervals, found.terms) == (1, (("x",),))
    assert found.stated == pytest.approx(1.0, abs=0.5)
    path = next(each for each in choice.parameters() if each.endswith(":STRONG"))
    before = choice.parameters()[path]
    assert choice.score_of("one object", 4, {path: 2 * before}).terms == found.terms
    assert choice.parameters()[path] == before


def test_stated_probabilities_stand_beside_the_share_that_is_right():
    def score(stated, right, hold):
        return choice.Score("one object", 0, stated, right, True, False, 2, hold, hold // 2, ((),), 1.0)

    scores = [score(0.9, True, 2), score(0.9, False, 1), score(None, False, 0), score(0.2, False, 1)]
    assert [line.split("|")[1:5] for line in choice.by_probability(scores)[2:]] == [
        [" 0.0 to 0.5 ", " 1 ", " 0.20 ", " 0.00 "],
        [" 0.85 to 0.95 ", " 2 ", " 0.90 ", " 0.50 "],
    ]
    cells = [each.strip() for each in choice.by_kind(scores)[2].split("|")]
    assert cells[1:4] == ["one object", "4", "0.25"]
    assert cells[7:12] == ["0", "1", "0.667 of 6", "0.167 of 6", "0.500 of 2"]


def test_orders_are_counted_where_they_are_the_true_ones(capsys):
    orders.main(["--only", "relaxation", "--noise", "0.01", "--seeds", "1"])
    reason = r"a law of this order fits within the noise"
    assert re.search(rf"\| relaxation \| 1 \| 1 % \| 1 of 1 \| {reason}", capsys.readouterr().out)


@pytest.mark.parametrize("name", MIXED)
def test_systems_of_mixed_orders_measure_the_states_that_they_say_the_orders_of(name):
    trials = MIXED[name].measured(0.01, seed=1)
    assert trials.schema.states == tuple(MIXED[name].orders)
    assert trials.schema.inputs == (("u",) if MIXED[name].driven else ())
    assert len(trials.objects) == 3
    assert not np.array_equal(trials[0].states, MIXED[name].measured(0.01, seed=2)[0].states)


def test_published_shares_are_means_over_problems_and_need_a_whole_run():
    scores = [
        {"bench": row.bench, "trials": row.trials, "noise": level, "all_exact": i < 3, "r2_ok": i < 1}
        for row in ROWS
        for level in LEVELS
        for i in range(4)
    ]
    found = shares(scores)
    assert found["chaotic, 1 trial, every support right"] == [0.75] * 5
    assert found["grouped, R2 > 0.9 from a fresh start"] == [0.25] * 5
    assert "| half | commonlaw | 0.75 |" in table({"chaotic, 1 trial, every support right": "half"}, found)
    with pytest.raises(ValueError, match="no scores at some level"):
        shares([score for score in scores if score["noise"] > 0])
