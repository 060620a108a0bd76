"""Simulated drops of balls whose drag is proportional to their velocity, perhaps with a term in its square."""

from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.datasets.dataset import (
    DE_SILVA_2020,
    Dataset,
    PerObject,
    Seed,
    exact_heights,
    exact_law,
    fixed,
    measure,
    numbers,
    objects,
    sample_times,
)
from commonlaw.trials import Schema, Trials

if TYPE_CHECKING:
    from commonlaw.law import Law

_SCHEMA = Schema(("x",), units={"x": "m", "t": "s", "drag": "1/s"})


def _load(
    drag: PerObject = (-0.1, -0.3, -0.3, -0.5, -0.7),
    gravity: float = -9.8,
    trials: int = 2,
    samples: int = 49,
    rate: float = 15.0,
    height: float = 47.33,
    noise: float = 0.01,
    seed: Seed = 0,
    quadratic: PerObject = 0.0,
) -> Trials:
    """Return drops of balls that obey ``x'' = gravity + drag x'`` from rest (de Silva et al. 2020, section 2.2).

    The heights are exact, but for the noise: ``height + gravity t^2 M(1, 3, drag t) / 2`` with Kummer's function M.
    With `quadratic` the balls obey ``x'' = gravity + drag x' + quadratic x'^2``, which is integrated.

    Parameters
    ----------
    drag
        Drag coefficient of each ball, 1/s; negative slows the ball down, 0 is free fall.
    gravity
        m/s^2, negative is down.
    trials, samples, rate
        Drops of each ball, heights measured in each drop, and measurements in a second.
    height, noise
        At the start, and the standard deviation of the white noise on all heights, m.
    seed
        A whole number; or a NumPy generator of random numbers, which is drawn from ball by ball, drop by drop.
    quadratic
        Coefficient of the squared velocity for each ball, 1/m; positive slows a falling ball down.

    Raises
    ------
    CommonlawError
        If an option cannot be, such as a negative noise, or a negative `quadratic` with which a ball runs away.
    """
    balls = objects("Ball", drag=drag, quadratic=quadratic)
    times = sample_times(samples, rate)
    start, acceleration = numbers("height", height)[0], numbers("gravity", gravity)[0]
    paths = {
        name: fixed(_drop(name, slope, square, acceleration, start, times)) for name, (slope, square) in balls.items()
    }
    properties = {name: {"drag": slope} for name, (slope, _) in balls.items()}
    return measure(paths, _SCHEMA, times, trials, noise, seed, properties)


def _truth(drag: PerObject, gravity: float, quadratic: PerObject) -> "Law":
    """Return the law of these balls: ``x'' = gravity + drag v``, and ``+ quadratic v^2`` where a ball has that."""
    balls = objects("Ball", drag=drag, quadratic=quadratic)
    terms = ["1", "v", "v**2"] if any(square for _, square in balls.values()) else ["1", "v"]
    rows = {name: [[gravity, *ball][: len(terms)]] for name, ball in balls.items()}
    return exact_law(_SCHEMA, terms, rows, rates=["v"])


def _drop(name: str, drag: float, quadratic: float, gravity: float, height: float, times: Floats) -> Floats:
    """Return the heights of a drop without noise, m, shape (n, 1)."""
    if quadratic:
        return exact_heights(lambda v: gravity + drag * v + quadratic * v**2, height, times, name)
    from scipy.special import hyp1f1

    return np.asarray(height + gravity * times**2 / 2 * hyp1f1(1.0, 3.0, drag * times))[:, np.newaxis]


linear_drag = Dataset(
    "linear-drag", "simulated drops of five balls with linear drag: x'' = -9.8 + D x'", DE_SILVA_2020, _load, _truth
)
