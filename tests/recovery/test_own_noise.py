"""Laws are compared under noise of the size that they leave, not as if all that they leave were outliers."""

import numpy as np
from scipy.integrate import solve_ivp

import commonlaw as cl


def _rates(_: float, z: np.ndarray) -> list[float]:
    return [-1.1 * z[0] + 0.031 * z[0] * z[1], 0.0109 * z[1] ** 2 - 0.00054 * z[0] * z[1] ** 2]


def test_few_samples_of_large_swings_are_not_all_taken_for_outliers():
    generator, times = np.random.default_rng(22), np.arange(0.0, 13.0)
    states = solve_ivp(_rates, (0, 12), [4.0, 30.0], t_eval=times, rtol=1e-9).y.T
    noise = generator.uniform(2, 5)
    states = np.abs(states + noise * generator.standard_normal(states.shape)).round(1) + 0.1
    law = cl.discover(cl.Trials.from_arrays([times], [states], names=["x", "y"]), library="poly:3", order=1)
    assert law.structure == ("x' = a x + b x y", "y' = c y^2 + d x y^2")
