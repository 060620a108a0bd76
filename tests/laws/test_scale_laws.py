"""The scales of states, inputs and times never change a law."""

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.law.parameters import named_parameters

TINY, HUGE = 2.0**-27, 2.0**27
"""Eight orders of magnitude down and up; powers of two scale without rounding."""


def reacting(scales=(1.0, 1.0, 1.0), seed=0):
    """C decays into D, of three objects: C' = -k C, D' = 0.6 C, with the scales of t, C and D."""
    source, times, rows = np.random.default_rng(seed), np.linspace(0, 8, 33), []
    for name, k in (("a", 0.5), ("b", 0.4), ("c", 0.6)):
        for trial, start in ((1, 1.0), (2, 2.0)):
            c = start * np.exp(-k * times)
            d = 0.6 * (start - c) / k
            c, d = (own + 0.005 * source.standard_normal(len(times)) for own in (c, d))
            own = {"object": name, "trial": trial, "t": scales[0] * times, "C": scales[1] * c, "D": scales[2] * d}
            rows.append(pd.DataFrame(own))
    return cl.Trials.from_frame(pd.concat(rows), time="t", states=["C", "D"])


def discovered(scales):
    law = cl.discover(reacting(scales), order=1, library="poly:2")
    return law, law.comparison["score"].to_numpy()


@pytest.mark.parametrize("scales", [(1, TINY, HUGE), (1, HUGE, TINY), (TINY, 1, 1), (HUGE, HUGE, HUGE)])
def test_discovery_is_the_same_over_sixteen_orders_of_magnitude(scales):
    (law, evidence), (other, other_evidence) = discovered((1, 1, 1)), discovered(scales)
    assert law.structure == other.structure == ("C' = a C", "D' = b C")
    np.testing.assert_allclose(other_evidence, evidence, rtol=1e-6, atol=1e-6)
    time, first, second = scales
    factors = np.array([1, second / first]) / time
    expected = law.coefficients[:, law.support].reshape(3, 2) * factors
    np.testing.assert_allclose(other.coefficients[:, other.support].reshape(3, 2), expected, rtol=1e-9)


@pytest.mark.parametrize("scale", [TINY, HUGE])
def test_a_fit_with_a_constant_inside_is_the_same_whatever_the_scale(scale):
    times, found = np.linspace(0, 10, 40), []
    s = [2.0]
    for _ in range(4000):  # s' = -s/(0.5 + s)
        s.append(s[-1] - 10 / 4000 * s[-1] / (0.5 + s[-1]))
    measured = np.interp(times, np.linspace(0, 10, 4001), s) + 0.01 * np.random.default_rng(1).standard_normal(40)
    for own in (1.0, scale):
        law = cl.fit("s' = -V s/(K + s)", cl.Trials.from_arrays(times, own * measured, names=["s"]), errors="white")
        found.append(named_parameters(law).values[0] / own)
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6)


@pytest.mark.parametrize("scale", [TINY, HUGE])
def test_a_law_of_second_order_with_an_input_is_the_same_whatever_the_scale(scale):
    times = np.linspace(0, 12, 60)
    push = np.sin(0.7 * times)
    motion = np.zeros(60)
    rate, place, step = 0.0, 1.0, 12 / 59 / 200
    for i in range(60):
        motion[i] = place
        for j in range(200):
            rate += step * (np.sin(0.7 * (times[i] + j * step)) - 2 * place - 0.3 * rate)
            place += step * rate
    motion += 0.01 * np.random.default_rng(2).standard_normal(60)
    found = []
    for own in (1.0, scale):
        trials = cl.Trials.from_arrays(times, own * motion, inputs=push / own, names=["x", "u"])
        law = cl.fit("x'' = a u - k x - c v", trials, errors="white")
        values = dict(zip(named_parameters(law).names, named_parameters(law).values[0], strict=True))
        found.append([values["a"] / own**2, values["k"], values["c"]])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6)
