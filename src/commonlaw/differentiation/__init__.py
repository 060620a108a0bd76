"""From measured states to smoothed states and rates."""

from collections.abc import Callable, Mapping

from commonlaw.differentiation.base import AbstractDifferentiator, AbstractSmoother, Rates
from commonlaw.differentiation.differences import (
    CenteredDifference,
    FiniteDifference,
    ForwardDifference,
    SpectralDerivative,
)
from commonlaw.differentiation.noise import (
    differences,
    noise_correlation,
    noise_degrees_of_freedom,
    noise_level,
    noise_order,
    outliers_among,
    outliers_of_window,
    without_outliers,
)
from commonlaw.differentiation.penalized import SmoothingSpline, TotalVariationDerivative
from commonlaw.differentiation.robust import RobustSpline
from commonlaw.differentiation.smoothers import MedianFilter, SavitzkyGolay, SmoothedDifference, WienerFilter
from commonlaw.errors import CommonlawError
from commonlaw.runtime.arguments import checks_types, format_spec, parse_spec

__all__ = [
    "METHODS",
    "AbstractDifferentiator",
    "AbstractSmoother",
    "CenteredDifference",
    "FiniteDifference",
    "ForwardDifference",
    "MedianFilter",
    "Rates",
    "RobustSpline",
    "SavitzkyGolay",
    "SmoothedDifference",
    "SmoothingSpline",
    "SpectralDerivative",
    "TotalVariationDerivative",
    "WienerFilter",
    "default_differentiation",
    "differences",
    "format_differentiation",
    "noise_correlation",
    "noise_degrees_of_freedom",
    "noise_level",
    "noise_order",
    "outliers_among",
    "outliers_of_window",
    "parse_differentiation",
    "without_outliers",
]

METHODS: Mapping[str, Callable[..., AbstractDifferentiator | AbstractSmoother]] = {
    "centered": CenteredDifference,
    "forward": ForwardDifference,
    "finite": FiniteDifference,
    "savgol": SavitzkyGolay,
    "median": MedianFilter,
    "wiener": WienerFilter,
    "spline": SmoothingSpline,
    "robust": RobustSpline,
    "spectral": SpectralDerivative,
    "tv": TotalVariationDerivative,
}
"""Differentiators and smoothers by the names that they have in texts."""


def default_differentiation(order: int, samples: float = float("inf")) -> AbstractDifferentiator:
    """Return the method for a law of this order where none is chosen, and no trial has fewer samples than this.

    First order: `FiniteDifference` of accuracy 2, exact three-point stencils on any grid. It smooths nothing, so it
    bends no fast state; where noise is visible choose a smoother. Second order: the falling-ball paper's rule,
    `SmoothedDifference` with Savitzky-Golay windows of 35 samples, as differencing twice multiplies noise by the
    squared sampling rate and no data but synthetic ones survive that unsmoothed; or where these do not fit into the
    trials, `SmoothingSpline`.
    """
    if order == 1:
        return FiniteDifference(2)
    smoother = SavitzkyGolay(35, 3)
    return SmoothingSpline() if samples < smoother.window else SmoothedDifference(smoother, CenteredDifference())


@checks_types
def parse_differentiation(text: str) -> AbstractDifferentiator:
    """Make the differentiator that a text such as ``savgol:35:3`` names.

    The names are those of `METHODS`, each with its parameters in order. The name of a smoother gives a
    `SmoothedDifference`; the difference may follow (``savgol:35:3:forward``, ``median:5:finite:4``) and is the centred
    one otherwise.

    Raises `CommonlawError` if a name is not known, a parameter does not fit, or something follows a method that is not
    a smoother.

    Examples
    --------
    >>> parse_differentiation("median:7:forward")
    SmoothedDifference(smoother=MedianFilter(window=7), difference=ForwardDifference())
    """
    parts = text.split(":")
    end = next((i for i, part in enumerate(parts) if i and part in METHODS), len(parts))
    head, rest = ":".join(parts[:end]), ":".join(parts[end:])
    method = parse_spec("differentiation", head, METHODS)
    if isinstance(method, AbstractSmoother):
        return SmoothedDifference(method, parse_differentiation(rest) if rest else CenteredDifference())
    if rest:
        raise CommonlawError("differentiation-chain", text=text, head=head, rest=rest)
    return method


def format_differentiation(differentiator: AbstractDifferentiator) -> str | None:
    """Return the text that `parse_differentiation` reads back, or None if the method is not among `METHODS`.

    Examples
    --------
    >>> format_differentiation(SmoothedDifference(SavitzkyGolay(15, 3), ForwardDifference()))
    'savgol:15:3:forward'
    """
    if not isinstance(differentiator, SmoothedDifference):
        return _text(differentiator)
    smoother = _text(differentiator.smoother)
    if differentiator.difference == CenteredDifference():
        return smoother
    difference = format_differentiation(differentiator.difference)
    return None if smoother is None or difference is None else f"{smoother}:{difference}"


def _text(method: AbstractDifferentiator | AbstractSmoother) -> str | None:
    """Return name and parameters of one method, or None if it has no name."""
    return next((format_spec(name, method) for name, maker in METHODS.items() if type(method) is maker), None)
