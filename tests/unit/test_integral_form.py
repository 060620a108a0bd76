"""Integrals of rates along curves, with jumps of held inputs."""

import numpy as np
import pytest

from commonlaw.inference.fit.integral_form import integrated


@pytest.mark.parametrize(("order", "expected"), [(1, lambda t: 0.3 * t + t**3), (2, lambda t: 0.15 * t**2 + t**4 / 4)])
def test_cubic_splines_integrate_smooth_rates(order, expected):
    times = np.linspace(0, 2, 21)
    np.testing.assert_allclose(integrated(times, (0.3 + 3 * times**2)[:, np.newaxis], order)[:, 0], expected(times))


def test_rates_that_jump_are_integrated_between_the_jumps():
    times = np.concatenate([np.linspace(0, 1, 6), np.linspace(1, 3, 11), [3.0]])
    rates = np.repeat([2.0, -1.0, 50.0], [6, 11, 1])[:, np.newaxis]
    speed = np.where(times <= 1, 2 * times, 2 - (times - 1))
    place = np.where(times <= 1, times**2, 1 + 2 * (times - 1) - (times - 1) ** 2 / 2)
    np.testing.assert_allclose(integrated(times, rates, 1)[:, 0], speed, atol=1e-13)
    np.testing.assert_allclose(integrated(times, rates, 2)[:, 0], place, atol=1e-13)
