"""Where fits and forecasts by shooting begin: near what was estimated or measured of the trials."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.estimation.problem import Problem

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
