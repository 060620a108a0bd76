"""What methods of differentiation refuse: trials and settings that do not fit them."""

import numpy as np
import pytest

from commonlaw.diagnostics import Diagnostic
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
from tests.refusals import refused


@pytest.mark.parametrize(
    ("method", "needed", "message"),
    [
        (
            CenteredDifference(),
            4,
            Diagnostic("too-few-samples", {"count": 3, "needed": 4, "method": "centred differences"}),
        ),
        (
            ForwardDifference(),
            3,
            Diagnostic("too-few-samples", {"count": 2, "needed": 3, "method": "forward differences"}),
        ),
        (
            FiniteDifference(4),
            6,
            Diagnostic("too-few-samples", {"count": 5, "needed": 6, "method": "finite differences of accuracy 4"}),
        ),
        (SmoothingSpline(), 5, Diagnostic("too-few-samples", {"count": 4, "needed": 5})),
        (SpectralDerivative(), 3, Diagnostic("too-few-samples", {"count": 2, "needed": 3})),
        (TotalVariationDerivative(1e-3), 3, Diagnostic("too-few-samples", {"count": 2, "needed": 3})),
        (SmoothedDifference(MedianFilter(5)), 5, Diagnostic("window-too-long", {"count": 4, "window": 5})),
        (SmoothedDifference(WienerFilter(5)), 5, Diagnostic("window-too-long", {"count": 4, "window": 5})),
        (SmoothedDifference(SavitzkyGolay(45, 3)), 45, Diagnostic("window-too-long", {"count": 44, "window": 45})),
    ],
)
def test_a_trial_that_is_too_short_is_refused_and_one_sample_more_is_taken(method, needed, message):
    times = np.arange(float(needed))
    states = np.sin(times)[:, np.newaxis]
    assert np.all(np.isfinite(method.differentiate(times, states, 2).derivatives))
    with refused(message):
        method.differentiate(times[:-1], states[:-1], 2)


def test_the_largest_window_that_fits_is_named():
    with refused("window-too-long", count=42, window=45, remedy="choose a window of at most 41"):
        SavitzkyGolay(45, 3).smooth(np.arange(42.0), np.zeros((42, 1)))
    with refused("window-too-long", count=2, window=5, remedy="drop the trial"):
        MedianFilter(5).smooth(np.arange(2.0), np.zeros((2, 1)))


def test_sampling_that_is_not_uniform_is_refused_with_its_sample():
    times = np.arange(60.0) / 15
    times[40:] += 0.1
    states = np.zeros((60, 1))
    with refused("uneven-sampling", sample=40, next_sample=41, step=0.16666666666666652, median=0.06666666666666665):
        SmoothedDifference().differentiate(times, states, 1)
    with refused("uneven-sampling", method="the spectral derivative"):
        SpectralDerivative().differentiate(times, states, 1)


def test_a_third_derivative_of_a_cubic_spline_is_refused():
    with refused("spline-order", order=3):
        SmoothingSpline().differentiate(np.arange(9.0), np.zeros((9, 1)), 3)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SavitzkyGolay(34, 3), Diagnostic("window-even", {"window": 34, "odd": 35})),
        (lambda: SavitzkyGolay(5, 5), Diagnostic("polynomial-fills-window", {"limit": 4})),
        (lambda: SavitzkyGolay(5, -1), Diagnostic("whole-number", {"name": "polynomial", "value": -1})),
        (
            lambda: SavitzkyGolay(5.0, 3),
            Diagnostic("whole-number", {"name": "window", "value": 5.0, "bounds": "of at least 3"}),
        ),
        (
            lambda: MedianFilter(1),
            Diagnostic("whole-number", {"name": "window", "value": 1, "bounds": "of at least 3"}),
        ),
        (lambda: WienerFilter("5"), Diagnostic("whole-number", {"name": "window", "value": "5"})),
        (lambda: FiniteDifference(3), Diagnostic("accuracy-odd", {"accuracy": 3})),
        (lambda: FiniteDifference(True), Diagnostic("whole-number", {"name": "accuracy", "value": True})),
        (
            lambda: SmoothingSpline(0),
            Diagnostic("finite-number-bounded", {"name": "strength", "value": 0, "bound": "above"}),
        ),
        (lambda: SpectralDerivative(-1.0), Diagnostic("finite-number-bounded", {"name": "cutoff", "value": -1.0})),
        (lambda: TotalVariationDerivative(float("nan")), Diagnostic("finite-number-bounded", {"name": "strength"})),
        (
            lambda: TotalVariationDerivative("much"),
            Diagnostic("finite-number-bounded", {"name": "strength", "value": "much"}),
        ),
    ],
)
def test_settings_that_do_not_fit_are_refused_at_once(make, message):
    with refused(message):
        make()
