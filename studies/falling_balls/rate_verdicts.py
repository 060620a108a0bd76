"""What the paper says of rates from noisy heights, and whether it holds."""

from collections.abc import Mapping
from math import floor, log10, sqrt

import numpy as np

from commonlaw.array_types import Floats
from studies.falling_balls.rate_errors import BEST, LARGEST, ORDERS, Medians, NoisyFall, at
from studies.falling_balls.report import Verdict
from studies.falling_balls.settings import (
    LINEAR_FROM,
    LINEAR_WITHIN,
    PRINTED_HARM,
    PRINTED_NOISE,
    PRINTED_ORDERS,
    WINDOWS,
)

_PLAIN = ("forward", "centred")
_SMALLEST, _LARGEST = str(WINDOWS[0]), str(WINDOWS[-1])


def method_verdict(fall: NoisyFall, errors: Medians) -> Verdict:
    """Return whether what the paper says of the four methods holds."""
    levels, high = fall.levels, fall.levels >= LINEAR_FROM
    slopes = [
        float(np.polyfit(np.log(levels[high]), np.log(values[high]), 1)[0])
        for by_method in errors.values()
        for values in by_method.values()
    ]
    pairs = [(by_method[f"smoothed {name}"], by_method[name]) for by_method in errors.values() for name in _PLAIN]
    crossing = max(_last_above(levels, smoothed, plain) for smoothed, plain in pairs)
    gains = [plain[-1] / smoothed[-1] for smoothed, plain in pairs]
    shares = {
        order: float(np.mean(np.argmin(list(by_method.values()), axis=0) == list(by_method).index(BEST)))
        for order, by_method in errors.items()
    }
    ratios = [second / first for first, second in zip(errors[1].values(), errors[2].values(), strict=True)]
    clean = float(errors[1][BEST][0] / errors[1]["centred"][0])
    return _judged(
        "the four methods",
        {
            f"smoothing helps as noise grows (always above {crossing:.4f} m; by a factor of {min(gains):.0f} to "
            f"{max(gains):.0f} at {levels[-1]:g} m)": crossing < PRINTED_NOISE[0],
            f"errors end up growing in proportion to the noise (logarithmic slopes of {min(slopes):.2f} to "
            f"{max(slopes):.2f} above {LINEAR_FROM:g} m)": max(abs(slope - 1) for slope in slopes) < LINEAR_WITHIN,
            f"accelerations are less accurate than velocities (by a factor of {np.min(ratios):.1f} to "
            f"{np.max(ratios):.0f})": bool(np.min(ratios) > 1),
            "centred differences of clean heights give better velocities without smoothing (with it, the error is "
            f"{clean:.1f} times as large at {levels[0]:g} m)": clean > 1,
            f"smoothed centred differences are best at most levels ({shares[1]:.0%} of them for the velocity, "
            f"{shares[2]:.0%} for the acceleration)": min(shares.values()) > 0.5,
        },
    )


def window_verdict(fall: NoisyFall, errors: Medians, changes: Mapping[str, Floats]) -> Verdict:
    """Return whether what the paper says of windows holds, and of the errors at the noise of the drops."""
    table = {order: np.array(list(error.values())) for order, error in errors.items()}
    hurt = {order: float(each[-1, 0] / each[:, 0].min()) for order, each in table.items()}
    help_ = {order: float(each[0, -1] / each[-1, -1]) for order, each in table.items()}
    closer = float(at(fall.levels, changes[_LARGEST] / changes[_SMALLEST], PRINTED_NOISE[1])) - 1
    lost, taken = fall.mean_change(LARGEST)
    harm = sqrt(lost / taken)
    spans = {order: [at(fall.levels, errors[order][_LARGEST], noise) for noise in PRINTED_NOISE] for order in ORDERS}
    powers = {order: {floor(log10(error)) for error in span} for order, span in spans.items()}
    orders = {order: " to ".join(f"{error:.4f}" for error in span) for order, span in spans.items()}
    return _judged(
        "the window",
        {
            f"large windows do harm at small noise (at {fall.levels[0]:g} m the largest has {hurt[1]:.0f} and "
            f"{hurt[2]:.0f} times the error of the best, for velocity and acceleration)": min(hurt.values()) > 2,
            f"they help at large noise (at {fall.levels[-1]:g} m the error falls with every step from {_SMALLEST} to "
            f"{_LARGEST} samples, by factors of {help_[1]:.0f} and {help_[2]:.0f} in all)": all(
                np.all(np.diff(each[:, -1]) < 0) for each in table.values()
            ),
            f"small windows change the heights less, but only slightly so (at {PRINTED_NOISE[1]:g} m the largest "
            f"changes them by {closer:.0%} more than the smallest)": 0 < closer < 0.5,
            f"the largest does harm to the heights only below about {PRINTED_HARM:g} m (it takes more from the fall "
            f"itself than from the noise below {harm:.4f} m)": abs(log10(harm / PRINTED_HARM)) < 0.5,
            f"at the noise of the drops, {PRINTED_NOISE[0]:g} to {PRINTED_NOISE[1]:g} m, errors are of the order of "
            f"$10^{{{PRINTED_ORDERS[1]}}}$ for the velocity and $10^{{{PRINTED_ORDERS[2]}}}$ for the acceleration "
            f"({orders[1]} and {orders[2]})": powers == {order: {power} for order, power in PRINTED_ORDERS.items()},
        },
    )


def _judged(subject: str, statements: Mapping[str, bool]) -> Verdict:
    """Return the verdict on several statements of the paper, each with its numbers."""
    true, false = ([text for text, holds in statements.items() if bool(holds) is wanted] for wanted in (True, False))
    parts = []
    if true:
        parts.append(f"What the paper says of {subject} holds: {'; '.join(true)}.")
    if false:
        parts.append(f"What it says of {subject} does not hold: {'; '.join(false)}.")
    return Verdict("differs" if false else "reproduced", " ".join(parts))


def _last_above(levels: Floats, first: Floats, second: Floats) -> float:
    """Return the highest level at which the first is not below the second; zero if it always is."""
    return float(max(levels[first >= second], default=0.0))
