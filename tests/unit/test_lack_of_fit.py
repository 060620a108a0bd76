"""Lack of fit of compared laws, by noise that does not come from the misfit itself."""

import numpy as np
import pytest

import commonlaw as cl
from tests.unit.decays import trials_of

TIMES = np.arange(0.0, 8.0, 0.7)


def logistic(noise, copies=1):
    random, times = np.random.default_rng(3), np.repeat(TIMES, copies)

    def curve(k, limit):
        return limit / (1 + (limit / 0.5 - 1) * np.exp(-k * times)) + noise * random.standard_normal(len(times))

    return trials_of({"A": (times, curve(0.9, 10.0)), "B": (times, curve(0.7, 8.0))}, ["x"])


@pytest.mark.parametrize("start", ["", "; x(0) = 0.5"])
def test_a_law_with_larger_residuals_than_another_lacks_fit(start):
    trials = logistic(0.15)
    laws = {text: cl.fit(text + start, trials) for text in ("x' = r x", "x' = r x - b x^2")}
    compared = cl.compare(laws, trials, errors="white").set_index("law")["lack of fit"]
    assert compared.to_dict() == {"x' = r x": True, "x' = r x - b x^2": False}


@pytest.mark.parametrize(("copies", "lacks"), [(1, False), (4, True)])
def test_repeats_show_lack_of_fit_of_a_single_law(copies, lacks):
    """A line through noise that hides, without repeats, that the curve is bent."""
    random, times = np.random.default_rng(1), np.repeat(np.arange(0.0, 6.0), copies)
    x = times - 0.15 * times**2 + 0.05 * random.standard_normal(len(times))
    trials = trials_of({"A": (times, x)}, ["x"])
    compared = cl.compare([cl.fit("x' = a; x(0) = 0", trials)], trials)
    assert compared["lack of fit"].tolist() == [lacks]


@pytest.mark.parametrize("start", ["", "; x(0) = 0"])
def test_no_law_of_exact_data_lacks_fit_by_rounding(start):
    times = np.arange(8.0)
    trials = trials_of({"A": (times, 2 * times)}, ["x"])
    laws = {text: cl.fit(text + start, trials) for text in ("x' = a", "x' = a + b x", "x' = a x + 1")}
    compared = cl.compare(laws, trials, errors="white").set_index("law")["lack of fit"]
    assert compared.to_dict() == {"x' = a": False, "x' = a + b x": False, "x' = a x + 1": True}


def test_a_wrong_law_of_exact_data_lacks_fit_with_autocorrelated_errors():
    """Innovations of such errors are autocorrelated, too, as the law misses a curve."""
    times = np.arange(0.0, 10.1, 0.5)
    trials = trials_of({"A": (times, 10 * np.exp(-0.3 * times))}, ["x"])
    law = cl.fit("x' = -k x^2", trials, errors="white")
    assert cl.compare([law], trials, errors="autocorrelated")["lack of fit"].tolist() == [True]
