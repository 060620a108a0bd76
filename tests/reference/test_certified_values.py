"""Estimates and standard errors of `cl.fit` beside certified ones (NIST StRD, Rat42) and those of SciPy."""

import numpy as np
import pytest
from scipy.optimize import curve_fit

import commonlaw as cl

AGE = np.array([9.0, 14.0, 21.0, 28.0, 42.0, 57.0, 63.0, 70.0, 79.0])
YIELD = np.array([8.93, 10.8, 18.59, 22.33, 39.35, 56.11, 61.73, 64.62, 67.08])


@pytest.mark.parametrize("errors", ["auto", "white"])
def test_nine_measurements_of_a_pasture_give_the_certified_estimates_and_standard_errors(errors):
    law = cl.fit("y' = r*y*(1 - y/K)", cl.Trials.from_arrays([AGE], [YIELD], names=["y"]), errors=errors)
    (found,), (deviations,) = law.letter_values()
    order = [law.letters.index(name) for name in ("K", "r")]
    assert found[order] == pytest.approx([72.462237576, 0.067359200066], rel=1e-4)
    assert deviations[order] == pytest.approx([1.7340283401, 0.0034465663377], rel=0.02)


def logistic(t, r, capacity, start):
    return capacity / (1 + (capacity / start - 1) * np.exp(-r * t))


@pytest.mark.parametrize("samples", [5, 8, 15])
def test_a_growth_curve_gives_the_estimates_and_standard_errors_of_least_squares(samples):
    times = np.linspace(0, 12, samples)
    states = logistic(times, 0.8, 2.0, 0.1) + 0.03 * np.random.default_rng(samples).standard_normal(samples)
    expected, covariance = curve_fit(logistic, times, states, [0.8, 2.0, 0.1])
    law = cl.fit("y' = r*y*(1 - y/K)", cl.Trials.from_arrays([times], [states], names=["y"]))
    (found,), (deviations,) = law.letter_values()
    order = [law.letters.index(name) for name in ("r", "K")]
    assert found[order] == pytest.approx(expected[:2], rel=1e-4)
    assert deviations[order] == pytest.approx(np.sqrt(np.diag(covariance))[:2], rel=0.02)
