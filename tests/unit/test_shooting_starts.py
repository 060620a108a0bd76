"""Where fits and forecasts by shooting begin: near what was estimated or measured of the trials."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.estimation.beginning import begin
from commonlaw.estimation.model import ModelText
from commonlaw.estimation.problem import Problem
from commonlaw.estimation.search import UNSEEN, expected_unseen, rough_noise

TIMES = np.linspace(0, 4, 40)


def decays(seed, rate=0.7, noise=0.02):
    source = np.random.default_rng(seed)
    x = 3 * np.exp(-rate * TIMES) + noise * source.standard_normal((2, len(TIMES)))
    return cl.Trials.from_arrays([TIMES, TIMES], list(x), names=["x"])


@pytest.fixture
def solutions(monkeypatch):
    """Count solutions of trials."""
    counted, solve = [0], Problem.predicted

    def predicted(*arguments):
        counted[0] += 1
        return solve(*arguments)

    monkeypatch.setattr(Problem, "predicted", predicted)
    return counted


@pytest.mark.parametrize("seed", [1, 2])
def test_forecasts_and_refits_begin_at_what_was_estimated_or_measured(seed, solutions):
    law = cl.fit("x' = -k x", decays(1), scheme="shooting")
    trials = decays(seed)
    solutions[0] = 0
    forecast = law.predict(trials, start="all")
    assert forecast.metric("r2") > 0.99
    assert solutions[0] < 2 * 40
    for changed in (cl.refine(law, trials), law.update(trials)):
        assert changed.params["estimate"][0] == pytest.approx(0.7, abs=0.02)
    assert solutions[0] < 2 * 150


@pytest.mark.parametrize("noise", [0.02, 0.05])
def test_known_noise_is_compared_with_the_residuals(noise):
    trials = decays(1)
    fitted = cl.fit("x' = -k x", trials, scheme="shooting", noise={"x": noise})
    assert "residuals-exceed-noise" not in {note.code for note in fitted.diagnostics}
    wrong = cl.fit("x' = -k", trials, scheme="shooting", noise={"x": noise})
    assert "residuals-exceed-noise" in {note.code for note in wrong.diagnostics}


def test_trials_without_unknowns_in_common_are_searched_apart():
    trials = cl.datasets.linear_drag(noise=0.05)
    text = ModelText.of("x'' = -g - c v")
    for shared, count in (({}, len(trials.objects)), ({"g": "all"}, 1)):
        begun = begin(text, trials, {}, shared=shared, priors={"c": (0.2, 0.1)})
        problem, noise = begun.problem, rough_noise(begun.problem)
        parts = problem.apart()
        assert len(parts) == count
        assert sorted(np.concatenate([indices for indices, _ in parts])) == [*range(problem.unknowns)]
        squares = [np.sum(part.residuals(begun.first[indices], noise)[0] ** 2) for indices, part in parts]
        assert sum(squares) == pytest.approx(np.sum(problem.residuals(begun.first, noise)[0] ** 2))


def test_as_many_starts_are_improved_as_maxima_may_be_missed():
    assert expected_unseen([2.0]) == 1
    assert expected_unseen([2.0] * 4) > UNSEEN >= expected_unseen([2.0] * 5)
    assert expected_unseen([2.0, 2.0, 2.0, 3.0, 2.0, 2.0]) > UNSEEN


def test_an_oscillation_of_each_object_has_its_own_frequency():
    times = np.linspace(0, 12, 60)
    rates = np.array([0.8, 3.0, 1.7, 4.4])
    x = np.cos(rates[:, np.newaxis] * times) + 0.02 * np.random.default_rng(0).standard_normal((4, 60))
    names = ["A", "B", "C", "D"]
    trials = cl.Trials.from_arrays([times] * 4, list(x), names=["x"], object=names)
    law = cl.fit("x'' = -k x", trials, scheme="shooting")
    assert law.params["estimate"].to_numpy() == pytest.approx(rates**2, rel=0.01)


@pytest.mark.parametrize("text", ["x' = r x (1 - x/K); x(0) = s", "x' = r x (1 - x/K); x(0) = s; s > 0"])
def test_a_first_measurement_below_zero_does_not_decide_the_sign_of_the_start(text):
    """SciPy's least squares has r = 3.04919, K = 9.81582; from a negative start growth runs away."""
    sizes = [-0.096, 0.642, 4.054, 8.227, 9.186, 9.954, 9.807, 10.044, 9.517, 10.073]
    trials = cl.Trials.from_arrays([np.linspace(0, 6, 10)], [np.array(sizes)], names=["x"])
    estimates = cl.fit(text, trials).params.set_index("parameter")["estimate"]
    assert estimates[["r", "K"]].tolist() == pytest.approx([3.0492, 9.8158], rel=1e-3)
    assert estimates["s"] > 0
