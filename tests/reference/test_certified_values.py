"""Estimates and standard errors of `cl.fit` beside certified ones (NIST StRD, BoxBOD) and those of SciPy."""

import numpy as np
import pytest
from scipy.optimize import curve_fit

import commonlaw as cl

DAYS = np.array([1.0, 2.0, 3.0, 5.0, 7.0, 10.0])
DEMAND = np.array([109.0, 149.0, 149.0, 191.0, 213.0, 224.0])


@pytest.mark.parametrize("errors", ["auto", "white"])
def test_six_measurements_of_oxygen_demand_give_the_certified_estimates_and_standard_errors(errors):
    trials = cl.Trials.from_arrays([DAYS], [DEMAND], names=["y"])
    law = cl.fit("y' = k*(B - y)", trials, errors=errors, starts={"y": 0.0}, starts_at=0.0)
    (found,), (deviations,) = law.letter_values()
    estimates, standard_errors = (dict(zip(law.letters, own, strict=True)) for own in (found, deviations))
    assert [estimates["B"], estimates["k"]] == pytest.approx([213.80940889, 0.54723748542], rel=1e-4)
    assert [standard_errors["B"], standard_errors["k"]] == pytest.approx([12.354515176, 0.10455993237], rel=0.02)


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
