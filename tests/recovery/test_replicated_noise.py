"""Replicates at the same times, compared with nonlinear least squares of all rows."""

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import curve_fit

import commonlaw as cl


@pytest.mark.parametrize("seed", [1, 2])
def test_noise_and_errors_are_those_of_all_rows(seed):
    times = np.repeat(np.linspace(0.5, 15, 9), 3)
    uptake = 4.3 - 3.9 * np.exp(-0.21 * times) + 0.5 * np.random.default_rng(seed).standard_normal(len(times))
    law = cl.fit("x' = a - b x", cl.Trials.from_frame(pd.DataFrame({"t": times, "x": uptake})))

    def curve(t, a, b, start):
        return a / b + (start - a / b) * np.exp(-b * (t - 0.5))

    expected, covariance = curve_fit(curve, times, uptake, p0=(0.9, 0.2, 0.3))
    noise = np.sqrt(np.sum((uptake - curve(times, *expected)) ** 2) / (len(times) - 3))
    assert law.uncertainty.noise == pytest.approx([noise], rel=1e-3)
    assert law.params["estimate"].tolist() == pytest.approx(expected[:2], rel=1e-3)
    assert law.params["standard error"].tolist() == pytest.approx(np.sqrt(np.diag(covariance))[:2], rel=1e-3)
