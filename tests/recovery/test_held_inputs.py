"""Nonlinear terms in laws with inputs that are held between samples."""

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

import commonlaw as cl


def test_a_tank_under_a_pump_that_is_switched_drains_by_torricellis_law():
    times = np.arange(0, 400, 5.0)
    pump, heights = np.where((times // 80) % 2 == 0, 2.0, 0.6), [40.0]
    for flow in pump[:-1]:
        step = solve_ivp(lambda _, h, flow=flow: 0.5 * flow - 0.12 * np.sqrt(h), (0, 5), heights[-1:], rtol=1e-9)
        heights.append(step.y[0, -1])
    noisy = np.array(heights) + 0.1 * np.random.default_rng(0).standard_normal(len(times))
    law = cl.discover(pd.DataFrame({"t": times, "pump": pump, "h": noisy}), cache=False)
    assert law.structure == ("h' = a pump + b sqrt(h)",)
    np.testing.assert_allclose(law.params["estimate"], [0.5, -0.12], rtol=0.01)
