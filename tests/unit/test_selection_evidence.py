"""What rows are worth: how many are independent, and how exact their targets are."""

import numpy as np
import pytest

from commonlaw.differentiation import MedianFilter, SmoothedDifference, parse_differentiation
from commonlaw.formulation import StrongForm, differentiation_bias, effective_share, law_variables
from commonlaw.library import PolynomialLibrary
from commonlaw.trials import Schema, Trial
from tests.refusals import refused

TIMES = np.arange(200) / 10


def trial(noise=0.0, times=TIMES):
    states = np.sin(times) + noise * np.random.default_rng(0).standard_normal(len(times))
    return Trial("A", "1", times, states[:, np.newaxis])


def test_central_differences_of_white_noise_count_two_rows_of_three():
    # Differences two samples apart share a sample: correlation -1/2 at lags of two, so 1 / (1 + 2 / 4)
    assert effective_share(StrongForm(parse_differentiation("centered")), trial()) == pytest.approx(2 / 3, rel=1e-6)


@pytest.mark.parametrize("text", ["savgol:15:3", "savgol:25:3", "finite:4"])
@pytest.mark.parametrize("order", [1, 2])
def test_the_share_is_that_of_the_autocorrelation_of_differentiated_noise(text, order):
    differentiation, count = parse_differentiation(text), 200_000
    noise = np.random.default_rng(0).standard_normal((count, 1))
    rates = differentiation.differentiate(np.arange(count) / 10, noise, order).derivatives[-1][:, 0]
    middle = rates[100:-100]
    lags = [np.mean(middle[: len(middle) - k] * middle[k:]) for k in range(60)]
    expected = 1 / (1 + 2 * np.sum((np.array(lags[1:]) / lags[0]) ** 2))
    assert effective_share(StrongForm(differentiation, order), trial()) == pytest.approx(expected, rel=0.03)


def test_wider_windows_leave_fewer_independent_rows():
    forms = [StrongForm(parse_differentiation(f"savgol:{window}:3"), trim=10) for window in (9, 17, 33)]
    shares = [effective_share(form, trial()) for form in forms]
    assert shares == sorted(shares, reverse=True)
    assert 0 < shares[-1] < shares[0] < 1


def test_a_median_that_does_not_feel_an_impulse_counts_one_row_a_window():
    times = np.arange(50.0)
    peaked = Trial("A", "1", times, -np.abs(times - 25)[:, np.newaxis])
    form = StrongForm(SmoothedDifference(MedianFilter(5)))
    assert effective_share(form, peaked) == 1 / 7


def test_a_trial_that_is_too_short_is_named():
    with refused("window-too-long", where="A, trial 1"):
        effective_share(StrongForm(parse_differentiation("savgol:25:3")), trial(times=TIMES[:10]))


@pytest.mark.parametrize(
    ("text", "noise"), [("centered", 0.0), ("savgol:15:1", 0.0), ("savgol:15:1", 0.01), ("savgol:25:3", 0.01)]
)
def test_the_resolution_is_the_error_of_the_targets_without_noise(text, noise):
    form = StrongForm(parse_differentiation(text), 2, trim=15)
    terms = PolynomialLibrary(1).bind(law_variables(Schema(("x",)), form.order)).take([1, 2])
    targets = form.samples(trial())[1][:, 0]
    error = np.mean((targets + np.sin(TIMES[15:-15])) ** 2)  # x'' = -x
    found = differentiation_bias(form, terms, [trial(noise)], 0, np.array([-1.0, 0.0]))
    assert error / 2 < found < 2 * error


def test_the_resolution_of_a_method_that_is_exact_is_rounding():
    form = StrongForm(parse_differentiation("savgol:15:3"), 2, trim=10)
    terms = PolynomialLibrary(0).bind(law_variables(Schema(("x",)), form.order))
    falling = Trial("A", "1", TIMES, (10 - 4.9 * TIMES**2)[:, np.newaxis])
    assert differentiation_bias(form, terms, [falling], 0, np.array([-9.8])) < 1e-18
