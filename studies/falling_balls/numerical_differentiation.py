"""Part 9: what noise and smoothing do to rates, and how noisy the drops are."""

from collections.abc import Mapping
from functools import partial

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation import SavitzkyGolay
from commonlaw.plots import Figure
from commonlaw.report import Picture, Text
from studies.falling_balls.drop_noise import noise_blocks, noise_of_drops, noise_verdict
from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.plots import Curve, plot_curves
from studies.falling_balls.rate_errors import BEST, METHODS, ORDERS, WINDOW_METHODS, Medians, NoisyFall, at, medians
from studies.falling_balls.rate_verdicts import method_verdict, window_verdict
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import (
    END_SAMPLES,
    PRINTED_NOISE,
    REPORTED_NOISES,
    SHOWN_NOISES,
    STUDIED_DRAWS,
    STUDIED_FALL,
    WINDOWS,
)

_NAME, _TITLE = "numerical-differentiation", "Rates from noisy heights"


def numerical_differentiation(inquiry: Inquiry) -> Section:
    """Return the part on rates from noisy heights."""
    fall = NoisyFall.simulated(inquiry.seed)
    errors = {name: fall.errors(method) for name, method in METHODS.items()}
    window_errors = {name: fall.errors(method) for name, method in WINDOW_METHODS.items()}
    changes = {str(window): np.median(fall.changes(SavitzkyGolay(window, 3)), axis=1) for window in WINDOWS}
    by_method, by_window = medians(errors), medians(window_errors)
    blocks = (
        Text(_asked(fall)),
        Picture("noisy-fall", _FALL_CAPTION, partial(plot_curves, _fall_panels(fall), "t (s)", "x (m)")),
        Picture("differentiation-errors", _METHOD_CAPTION, partial(_plot, _method_panels(fall, errors), "error")),
        Picture("window-errors", _WINDOW_CAPTION, partial(_plot, _window_panels(fall, by_window), "error")),
        Picture("smoothing-change", _CHANGE_CAPTION, partial(_plot, _change_panel(fall, changes), "change")),
        Text(_found(fall, by_window)),
    )
    verdicts = (method_verdict(fall, by_method), window_verdict(fall, by_window, changes))
    results = {"differentiation_error": _reported(fall, by_method), "window_error": _reported(fall, by_window)}
    if inquiry.drops is None:
        missing = Text(f"The noise of the drops is left out, as they are missing: {inquiry.missing}")
        left_out = Verdict("left out", "the noise of every drop needs the measured drops")
        return Section(_NAME, _TITLE, (*blocks, missing), (*verdicts, left_out), results)
    noise = noise_of_drops(inquiry.drops, fall)
    return Section(
        _NAME,
        _TITLE,
        (*blocks, *noise_blocks(inquiry.drops, noise)),
        (*verdicts, noise_verdict(noise, fall)),
        {**results, "noise_of_drops": noise},
    )


def _reported(fall: NoisyFall, errors: Medians) -> dict[str, dict[str, dict[str, float]]]:
    """Return the errors at a few levels by order, method and level."""
    return {
        str(order): {
            method: {f"{level:g}": at(fall.levels, values, level) for level in REPORTED_NOISES}
            for method, values in by_method.items()
        }
        for order, by_method in errors.items()
    }


def _fall_panels(fall: NoisyFall) -> dict[str, list[Curve]]:
    indices = [int(np.argmin(np.abs(np.log(fall.levels / level)))) for level in SHOWN_NOISES]
    return {
        f"noise {level:g} m": [
            Curve("measured", fall.times, fall.measured[:, index, 0], line="", points=True),
            Curve("fall", fall.times, fall.heights),
        ]
        for level, index in zip(SHOWN_NOISES, indices, strict=True)
    }


def _method_panels(fall: NoisyFall, errors: Mapping[str, Mapping[int, Floats]]) -> dict[str, list[Curve]]:
    return {
        title: [
            Curve(name, fall.levels, middle, low, high, line="--" if "forward" in name else "-")
            for name, error in errors.items()
            for middle, low, high in [np.quantile(error[order], [0.5, 0.1, 0.9], axis=1)]
        ]
        for order, title in ORDERS.items()
    }


def _window_panels(fall: NoisyFall, errors: Medians) -> dict[str, list[Curve]]:
    return {
        ORDERS[order]: [Curve(f"{name} samples", fall.levels, values) for name, values in by_window.items()]
        for order, by_window in errors.items()
    }


def _change_panel(fall: NoisyFall, changes: Mapping[str, Floats]) -> dict[str, list[Curve]]:
    return {"": [Curve(f"{name} samples", fall.levels, values) for name, values in changes.items()]}


def _plot(panels: Mapping[str, list[Curve]], what: str) -> Figure:
    return plot_curves(panels, "noise, standard deviation (m)", f"relative {what}", log_x=True, log_y=True)


_FALL_CAPTION = (
    "The simulated fall, and its heights as measured with three levels of noise. Noise of 0.1 m is hardly seen."
)
_METHOD_CAPTION = (
    "Relative error of the velocity (left) and of the acceleration (right) against the noise, for four ways of taking "
    f"differences. Lines are medians over {STUDIED_DRAWS} draws of the noise at each level, bands hold the middle 80 % "
    "of the draws. Both axes are logarithmic."
)
_WINDOW_CAPTION = (
    "Relative error of the velocity (left) and of the acceleration (right) against the noise, from smoothed centred "
    f"differences with smoothing windows of {WINDOWS[0]} to {WINDOWS[-1]} samples: medians over {STUDIED_DRAWS} draws."
)
_CHANGE_CAPTION = (
    "By how much smoothing changes the heights, relatively, against the noise, for smoothing windows of "
    f"{WINDOWS[0]} to {WINDOWS[-1]} samples: medians over {STUDIED_DRAWS} draws."
)


def _asked(fall: NoisyFall) -> str:
    low, high = fall.levels[0], fall.levels[-1]
    return f"""
The method needs velocities and accelerations, but only heights were measured. Differences of neighbouring heights
multiply the noise, and those of the second order do so twice. Smoothing takes noise away before, and some of the motion
with it. How far off are the rates, and how noisy are the drops?

A fall is simulated whose rates are known: $\\ddot x = {STUDIED_FALL["gravity"]:g} {STUDIED_FALL["drag"]:+g} v$ from
{STUDIED_FALL["height"]:g} m at rest, {len(fall.times)} heights, {1 / fall.times[1]:.0f} a second. White noise of
{len(fall.levels)} levels between {low:g} m and {high:g} m is added to the heights, from the same {STUDIED_DRAWS} draws
at each level (the paper: one draw). Errors are relative: the root of the summed squares of what is off, over that of
the exact rates.

- Forward differences look one sample ahead; centred ones look one sample to each side.
- Each is taken with smoothing before it and without: every height is replaced by the value of a cubic that is fitted to
  the {WINDOWS[-1]} samples around it, and so is every velocity before the acceleration is taken.
- Then the smoothing window is changed, from {WINDOWS[0]} to {WINDOWS[-1]} samples.
"""


def _found(fall: NoisyFall, errors: Medians) -> str:
    low, high = PRINTED_NOISE
    best = {
        order: " and ".join(_least(fall, by_window, noise) for noise in PRINTED_NOISE)
        for order, by_window in errors.items()
    }
    residuals = fall.derivative_errors(METHODS[BEST], (low + high) / 2)
    ends = {order: _share_of_ends(error) for order, error in residuals.items()}
    largest = {
        order: float(np.median(np.max(np.abs(error), axis=0)) / np.max(np.abs(exact)))
        for (order, error), exact in zip(residuals.items(), fall.rates, strict=True)
    }
    usual = {order: at(fall.levels, errors[order][str(WINDOWS[-1])], (low + high) / 2) for order in ORDERS}
    return f"""
Which window is best depends on the noise. At {low:g} m and {high:g} m, between which the paper puts the drops, the
least error of the velocity comes with {best[1]} samples, that of the acceleration with {best[2]}.

Most of what is wrong is at the ends of a drop, where the window is one-sided: with {WINDOWS[-1]} samples and noise of
{(low + high) / 2:g} m, the first and the last {END_SAMPLES} of {len(fall.times)} samples hold {ends[1]:.0%} of the
squared error of the velocity and {ends[2]:.0%} of that of the acceleration. The paper adds that the largest error,
relative to the largest rate, is marginally larger than these errors. It is {largest[1] / usual[1]:.1f} times as large
for the velocity and {largest[2] / usual[2]:.1f} times for the acceleration.
"""


def _least(fall: NoisyFall, errors: Mapping[str, Floats], noise: float) -> str:
    """Return the window with the least error."""
    return min(errors, key=lambda window: at(fall.levels, errors[window], noise))


def _share_of_ends(error: Floats) -> float:
    squares = np.sum(error**2, axis=1)
    return float((squares[:END_SAMPLES].sum() + squares[-END_SAMPLES:].sum()) / squares.sum())
