"""A tennis ball in still air, simulated: how linear drag compares with that of a real sphere."""

from collections.abc import Mapping
from functools import partial

import numpy as np

from commonlaw import datasets
from commonlaw.array_types import Floats
from commonlaw.plots import Figure
from commonlaw.report import Block, Picture, Text
from studies.falling_balls.plots import Curve, plot_curves
from studies.falling_balls.settings import CIRCUMFERENCES, LINEAR_RIVALS, LONG_FALL, OUNCE, OUNCES, RATE, TENNIS_BALL

_SPHERE = "Reynolds-dependent drag"
_LINES = ("-", "--", ":")
Falls = Mapping[str, Mapping[int, Floats]]
"""Heights above the start and velocities, shape (samples, 2), by kind of drag and number of samples."""


def real_balls() -> dict[str, tuple[float, ...]]:
    """Return radius and mass of the simulated balls, from the measured circumferences and weights."""
    radii = tuple(each / 200 / np.pi for each in CIRCUMFERENCES)
    return {"radius": radii, "mass": tuple(OUNCE * each for each in OUNCES)}


def tennis_ball_falls() -> tuple[Block, ...]:
    """Compare the fall of a tennis ball under Reynolds-dependent and under linear drag."""
    falls = _falls()
    return (
        Picture(
            "reynolds-drag-falls",
            "A tennis ball falling from rest, simulated: with drag that depends on the Reynolds number, with the "
            "linear drag learned from the measured drops, and with a linear drag and a gravity that mimic the former. "
            "Above for the length of a measured drop, below for a minute.",
            partial(_draw, falls),
        ),
        Text(_mimicry(falls)),
    )


def _falls() -> Falls:
    ball = {name: values[TENNIS_BALL] for name, values in real_balls().items()}
    laws = {_SPHERE: datasets.reynolds_drag.truth(**ball, viscosity=datasets.PRINTED_VISCOSITY)}
    laws |= {name: datasets.linear_drag.truth(**options) for name, options in LINEAR_RIVALS.items()}
    return {
        name: {n: law.simulate(_times(n), [0.0, 0.0])[law.objects[0]].states for n in LONG_FALL}
        for name, law in laws.items()
    }


def _draw(falls: Falls) -> Figure:
    panels, labels = {}, {}
    for n in LONG_FALL:
        for state, (what, label) in enumerate((("height", "height above start (m)"), ("velocity", "velocity (m/s)"))):
            title = f"{what}, {n / RATE:.0f} s"
            labels[title] = label
            panels[title] = [
                Curve(name, _times(n), fall[n][:, state], line=line)
                for (name, fall), line in zip(falls.items(), _LINES, strict=True)
            ]
    return plot_curves(panels, "t (s)", labels, columns=2, share_x=False, share_y=False)


def _mimicry(falls: Falls) -> str:
    return (
        f"The drag of a sphere lets the ball reach {_final_speed(falls[_SPHERE]):.1f} m/s and no more. The linear drag "
        "learned from the measured drops goes astray sooner or later; one that may change gravity along with it does "
        "not:\n\n"
        + "\n".join(_beside(falls[_SPHERE], name, falls[name]) for name in LINEAR_RIVALS)
        + "\n\nSo a fit that may choose both numbers explains such drops well without quadratic drag."
    )


def _beside(sphere: Mapping[int, Floats], name: str, fall: Mapping[int, Floats]) -> str:
    """Return how a fall under linear drag compares, as an item of a list."""
    gravity, drag = LINEAR_RIVALS[name]["gravity"], LINEAR_RIVALS[name]["drag"]
    apart = [f"{np.abs(fall[n][:, 0] - sphere[n][:, 0]).max():.1f} m within {n / RATE:.0f} s" for n in LONG_FALL]
    return (
        f"- {name}, $\\ddot x = {gravity:g} {drag:+g}\\,v$: apart by up to {' and '.join(apart)}; final speed "
        f"{_final_speed(fall):.1f} m/s"
    )


def _final_speed(fall: Mapping[int, Floats]) -> float:
    return float(-fall[LONG_FALL[-1]][-1, 1])


def _times(samples: int) -> Floats:
    return np.arange(samples) / RATE
