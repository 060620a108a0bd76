"""Simulated drops of balls whose drag is proportional to their velocity."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.datasets import exact
from commonlaw.datasets.dataset import DE_SILVA_2020, Dataset
from commonlaw.datasets.measurement import Floats, Measurement, Seed, ball_names, fixed, numbers, sample_times
from commonlaw.trials import Schema, Trials

if TYPE_CHECKING:
    from commonlaw.law import Law

_DRAG = (-0.1, -0.3, -0.3, -0.5, -0.7)
_GRAVITY = -9.8
_SCHEMA = Schema(("x",), units={"x": "m", "t": "s", "drag": "1/s"})


def _load(
    drag: float | Sequence[float] = _DRAG,
    gravity: float = _GRAVITY,
    trials: int = 2,
    samples: int = 49,
    rate: float = 15.0,
    height: float = 47.33,
    noise: float = 0.01,
    seed: Seed = 0,
) -> Trials:
    """Return drops of balls that obey ``x'' = gravity + drag x'`` from rest (de Silva et al. 2020, section 2.2).

    The heights are exact, but for the noise: ``height + gravity t^2 M(1, 3, drag t) / 2`` with Kummer's function M.

    Parameters
    ----------
    drag
        Drag coefficient of each ball, 1/s; negative slows the ball down, 0 is free fall.
    gravity
        m/s^2, negative is down.
    trials
        Drops of each ball.
    samples
        Heights measured in each drop.
    rate
        Measurements in a second.
    height
        At the start, m.
    noise
        Standard deviation of the white noise on the heights, m.
    seed
        A whole number; or a NumPy generator of random numbers, which is drawn from ball by ball, drop by drop.

    Raises
    ------
    CommonlawError
        If an option cannot be, such as a negative noise.
    """
    coefficients = numbers("drag", drag)
    times = sample_times(samples, rate)
    start, acceleration = numbers("height", height)[0], numbers("gravity", gravity)[0]
    names = ball_names(len(coefficients))
    return Measurement(times, trials, noise, seed).of(
        {
            name: fixed(start + _fall(times, acceleration, each)[:, np.newaxis])
            for name, each in zip(names, coefficients, strict=True)
        },
        _SCHEMA,
        {name: {"drag": each} for name, each in zip(names, coefficients, strict=True)},
    )


def _truth(drag: float | Sequence[float] = _DRAG, gravity: float = _GRAVITY) -> "Law":
    """Return the law ``x'' = gravity + drag v`` of these balls."""
    coefficients = numbers("drag", drag)
    rows = {name: [[gravity, each]] for name, each in zip(ball_names(len(coefficients)), coefficients, strict=True)}
    return exact.law(_SCHEMA, ["1", "v"], rows, rates=["v"])


def _fall(times: Floats, gravity: float, drag: float) -> Floats:
    """Return the height gained since the start, m, shape (n,)."""
    from scipy.special import hyp1f1

    return np.asarray(gravity * times**2 / 2 * hyp1f1(1.0, 3.0, drag * times))


linear_drag = Dataset(
    "linear-drag",
    "simulated drops of five balls with linear drag: x'' = -9.8 + D x'",
    DE_SILVA_2020,
    _load,
    _truth,
)
