"""What methods of differentiation refuse: trials and settings that do not fit them."""

import re

import numpy as np
import pytest

from commonlaw.differentiation import (
    CenteredDifference,
    FiniteDifference,
    ForwardDifference,
    MedianFilter,
    SavitzkyGolay,
    SmoothedDifference,
    SmoothingSpline,
    SpectralDerivative,
    TotalVariationDerivative,
    WienerFilter,
)
from commonlaw.errors import CommonlawError


@pytest.mark.parametrize(
    ("method", "needed", "message"),
    [
        (CenteredDifference(), 4, "3 samples are fewer than the 4 that centred differences take"),
        (ForwardDifference(), 3, "2 samples are fewer than the 3 that forward differences take"),
        (FiniteDifference(4), 6, "5 samples are fewer than the 6 that finite differences of accuracy 4 take"),
        (SmoothingSpline(), 5, "4 samples are fewer than the 5"),
        (SpectralDerivative(), 3, "2 samples are fewer than the 3"),
        (TotalVariationDerivative(1e-3), 3, "2 samples are fewer than the 3"),
        (
            SmoothedDifference(MedianFilter(5)),
            5,
            "4 samples are fewer than the window of 5; choose a window of at most 3",
        ),
        (
            SmoothedDifference(WienerFilter(5)),
            5,
            "4 samples are fewer than the window of 5; choose a window of at most 3",
        ),
        (
            SmoothedDifference(SavitzkyGolay(45, 3)),
            45,
            "44 samples are fewer than the window of 45; choose a window of",
        ),
    ],
)
def test_a_trial_that_is_too_short_is_refused_and_one_sample_more_is_taken(method, needed, message):
    times = np.arange(float(needed))
    states = np.sin(times)[:, np.newaxis]
    assert np.all(np.isfinite(method.differentiate(times, states, 2).derivatives))
    with pytest.raises(CommonlawError, match=re.escape(message)):
        method.differentiate(times[:-1], states[:-1], 2)


def test_the_largest_window_that_fits_is_named():
    with pytest.raises(
        CommonlawError, match="42 samples are fewer than the window of 45; choose a window of at most 41"
    ):
        SavitzkyGolay(45, 3).smooth(np.arange(42.0), np.zeros((42, 1)))
    with pytest.raises(CommonlawError, match="2 samples are fewer than the window of 5; drop the trial"):
        MedianFilter(5).smooth(np.arange(2.0), np.zeros((2, 1)))


def test_sampling_that_is_not_uniform_is_refused_with_its_sample():
    times = np.arange(60.0) / 15
    times[40:] += 0.1
    states = np.zeros((60, 1))
    with pytest.raises(
        CommonlawError, match=r"from sample 40 to sample 41 is 0.166667, the median step 0.0666667.*50%"
    ):
        SmoothedDifference().differentiate(times, states, 1)
    with pytest.raises(CommonlawError, match="the spectral derivative assumes uniform sampling"):
        SpectralDerivative().differentiate(times, states, 1)


def test_a_third_derivative_of_a_cubic_spline_is_refused():
    with pytest.raises(CommonlawError, match="no smooth derivative of order 3"):
        SmoothingSpline().differentiate(np.arange(9.0), np.zeros((9, 1)), 3)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SavitzkyGolay(34, 3), "window is 34, an even number: give an odd one, such as 35"),
        (lambda: SavitzkyGolay(5, 5), "choose a degree of at most 4"),
        (lambda: SavitzkyGolay(5, -1), "polynomial is -1"),
        (lambda: SavitzkyGolay(5.0, 3), "window is 5.0: give a whole number of at least 3"),
        (lambda: MedianFilter(1), "window is 1: give a whole number of at least 3"),
        (lambda: WienerFilter("5"), "window is '5'"),
        (lambda: FiniteDifference(3), "accuracy is 3; give an even number"),
        (lambda: FiniteDifference(True), "accuracy is True"),
        (lambda: SmoothingSpline(0), "strength is 0: give a finite number above 0"),
        (lambda: SpectralDerivative(-1.0), "cutoff is -1.0"),
        (lambda: TotalVariationDerivative(float("nan")), "strength is nan"),
        (lambda: TotalVariationDerivative("much"), "strength is 'much'"),
    ],
)
def test_settings_that_do_not_fit_are_refused_at_once(make, message):
    with pytest.raises(CommonlawError, match=re.escape(message)):
        make()
