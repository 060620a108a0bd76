"""Differentiation methods as texts."""

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
    format_differentiation,
    parse_differentiation,
)
from tests.refusals import refused

TEXTS = {
    "centered": CenteredDifference(),
    "forward": ForwardDifference(),
    "finite:4": FiniteDifference(4),
    "savgol:35:3": SmoothedDifference(SavitzkyGolay(35, 3)),
    "savgol:15:2:forward": SmoothedDifference(SavitzkyGolay(15, 2), ForwardDifference()),
    "median:7:finite:4": SmoothedDifference(MedianFilter(7), FiniteDifference(4)),
    "median:5:savgol:15:3": SmoothedDifference(MedianFilter(5), SmoothedDifference(SavitzkyGolay(15, 3))),
    "wiener:9": SmoothedDifference(WienerFilter(9)),
    "spline:None": SmoothingSpline(),
    "spline:0.01": SmoothingSpline(0.01),
    "spectral:None": SpectralDerivative(),
    "spectral:2.5": SpectralDerivative(2.5),
    "tv:1e-05": TotalVariationDerivative(1e-5),
}
SHORT_TEXTS = {
    "finite": FiniteDifference(2),
    "savgol": SmoothedDifference(),
    "savgol:polynomial=2": SmoothedDifference(SavitzkyGolay(35, 2)),
    "savgol:15:forward": SmoothedDifference(SavitzkyGolay(15, 3), ForwardDifference()),
    "savgol:35:3:centered": SmoothedDifference(),
    "spline": SmoothingSpline(),
    "spectral": SpectralDerivative(),
}


@pytest.mark.parametrize(("text", "method"), TEXTS.items())
def test_text_and_method_stand_for_each_other(text, method):
    assert parse_differentiation(text) == method
    assert format_differentiation(method) == text


@pytest.mark.parametrize(("text", "method"), SHORT_TEXTS.items())
def test_a_text_may_leave_out_defaults_or_write_them(text, method):
    assert parse_differentiation(text) == method


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("savgl:35", Diagnostic("unknown-name", {"kind": "differentiation", "name": "savgl"})),
        ("savgol:34", Diagnostic("window-even", {"window": 34}, "differentiation 'savgol:34'")),
        ("savgol:35:forwrd", Diagnostic("whole-number", {"name": "polynomial", "value": "forwrd"})),
        ("tv", Diagnostic("spec-syntax", {"text": "tv", "usage": "'tv:STRENGTH'"})),
        ("finite:2:3", Diagnostic("spec-syntax", {"usage": "'finite:[ACCURACY=2]'"})),
        ("centered:forward", Diagnostic("differentiation-chain", {"head": "centered", "rest": "forward"})),
    ],
)
def test_a_text_that_does_not_fit_is_refused_with_the_way_out(text, message):
    with refused(message):
        parse_differentiation(text)
