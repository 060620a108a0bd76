"""Part 13: how much quadratic drag and added mass could hide in these drops, and which experiment would show them."""

from collections.abc import Mapping
from functools import partial

import numpy as np
import pandas as pd

from commonlaw.datasets.sphere_drag import AIR_DENSITY
from commonlaw.discovery import fit
from commonlaw.experiments import Design, design
from commonlaw.experiments.search import MAX_REPEATS
from commonlaw.inference import Bounds, bounds
from commonlaw.law import Law
from commonlaw.law.parameters import named_parameters
from commonlaw.law.quantiles import upper_bound
from commonlaw.plots import plot_design
from commonlaw.report import Picture, Table, Text
from commonlaw.trials import Trials
from studies.falling_balls.inquiry import Inquiry, left_out
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import STANDARD_GRAVITY

_NAME, _TITLE = "next-experiment", "Which experiment next"

_LINEAR, _QUADRATIC, _SQUARE = "x'' = -g - c v", "x'' = -g - d v*abs(v)", "v*abs(v)"
_HEIGHT, _BRIDGE = 100.0, 47.0
"""Of drops from rest, m, and about that of the bridge."""

_FILMED, _FASTER = 15.0, 240.0
"""Samples in a second: as in the films, and of a faster camera."""

_LONGEST = 10.0
"""Of a drop, s; it ends at the ground."""

_SPHERE = 0.5
"""The added mass of a sphere, in masses of the fluid that it displaces."""

_WATER = 1000.0
"""Its density, kg/m³."""


def next_experiment(inquiry: Inquiry) -> Section:
    """Return the part on what could hide in the drops, and on the experiment that would show it."""
    drops = inquiry.drops
    if drops is None:
        return left_out(_NAME, _TITLE, inquiry.missing)
    linear, quadratic = fit(_LINEAR, drops), fit(_QUADRATIC, drops)
    limits, masses = bounds(linear, drops, [_SQUARE]), _added_mass(linear, drops)
    more = {ball: _drop(linear, quadratic, ball, _HEIGHT, _FILMED) for ball in drops.objects}
    best = max(more, key=lambda ball: more[ball].chance)
    lower = _drop(linear, quadratic, best, _BRIDGE, _FILMED)
    faster = _drop(linear, quadratic, best, _HEIGHT, _FASTER)
    blocks = (
        Text(_ASKED),
        Table("unseen-quadratic-drag", _BOUNDS, _bounds_frame(limits), 3),
        Text(f"{limits.sentences[0]} A force in proportion to the square of the speed is far from excluded."),
        Table("next-drop", _DROPS, _drops_frame(more), 2),
        Picture("next-drop-forecasts", _FORECASTS, partial(plot_design, more[best])),
        Table("unseen-added-mass", _MASSES, masses, 3),
        Text(_FLUID),
    )
    largest = max(bound.at_most for bound in limits.bounds)
    results = {
        "at_most": {bound.object: bound.at_most for bound in limits.bounds},
        "chance": {ball: own.chance for ball, own in more.items()},
        "added_mass_at_most": dict(zip(masses["ball"], masses["at most, in air"], strict=True)),
    }
    verdict = _verdict(largest, best, (more[best], lower, faster), masses)
    return Section(_NAME, _TITLE, blocks, (verdict,), {"next_experiment": results})


def _drop(linear: Law, quadratic: Law, ball: str, height: float, rate: float) -> Design:
    """Return what one more drop of a ball from rest would tell of the two laws."""
    vary = {"x": height, "v": 0.0, "duration": _LONGEST, "rate": rate, "object": ball}
    return design([linear, quadratic], vary, within={"x": (0.0, 2 * height)}, progress=lambda _: None)


def _added_mass(law: Law, drops: Trials) -> pd.DataFrame:
    """Return what the acceleration at rest of balls of known mass says of their added mass, and what it is in water.

    With r the density of the fluid over that of the ball, and C the added mass in masses of displaced fluid, a ball
    at rest accelerates by g (1 - r) / (1 + C r).
    """
    parameters = named_parameters(law)
    values, errors = parameters.values, parameters.errors
    freedom = law.uncertainty.degrees_of_freedom
    degrees, rows = np.inf if freedom is None else float(freedom[0]), []
    for i, ball in enumerate(law.objects):
        known = drops.properties.get(ball, {})
        if "mass" not in known:
            continue
        mass, radius = (float(known[name]) for name in ("mass", "radius"))
        density = mass / (4 / 3 * np.pi * radius**3)
        in_air, in_water = AIR_DENSITY / density, _WATER / density
        free, measured, error = STANDARD_GRAVITY * (1 - in_air), float(values[i, 0]), float(errors[i, 0])
        bound = upper_bound((free / measured - 1) / in_air, free * error / measured**2 / in_air, degrees, 0.95)
        shares = [1 - 1 / (1 + _SPHERE * each) for each in (in_air, in_water)]
        rows.append(
            {
                "ball": ball,
                "at most, in air": float(bound),
                "share of the acceleration, in air (%)": 100 * shares[0],
                "standard error here (%)": 100 * error / measured,
                "share of the acceleration, in water (%)": 100 * shares[1],
            }
        )
    return pd.DataFrame(rows)


def _bounds_frame(bounds: Bounds) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "ball": bound.object,
            "coefficient (1/m)": bound.coefficient,
            "standard error": bound.error,
            "at most (1/m)": bound.at_most,
            "adds at most (m/s²)": bound.effect,
        }
        for bound in bounds.bounds
    )


def _drops_frame(designs: Mapping[str, Design]) -> pd.DataFrame:
    return pd.DataFrame(
        {"ball": ball, "chance": own.chance, "drops for 0.95": str(own.repeats or f"over {MAX_REPEATS}")}
        for ball, own in designs.items()
    )


def _verdict(largest: float, ball: str, designs: tuple[Design, Design, Design], masses: pd.DataFrame) -> Verdict:
    found, lower, faster = designs
    often = f"; {found.repeats} such drops make it 0.95" if found.repeats and found.repeats > 1 else ""
    least = masses["at most, in air"].min()
    return Verdict(
        "beyond the paper",
        f"A coefficient of $v|v|$ up to {largest:.2g}/m would not have been seen. Linear and quadratic drag are best "
        f"told apart by {ball}: one drop from {_HEIGHT:g} m, filmed at {_FILMED:g} Hz, tells with a chance of "
        f"{found.chance:.2f}{often}. From the {_BRIDGE:g} m of the bridge it is {lower.chance:.2f}, and at "
        f"{_FASTER:g} Hz {faster.chance:.2f}. An added mass up to {least:.2g} displaced masses of air could hide, a "
        f"sphere's being {_SPHERE}: it takes water, where it is up to {masses.iloc[:, -1].max():.0f} % of the "
        "acceleration.",
    )


_ASKED = (
    "The paper ends with the question which experiment would show what its drops could not: the drag in the square "
    "of the speed, and the added mass, the air that a ball has to accelerate with itself. Both can be computed from "
    "what the drops leave open. The laws are fitted to all drops of all balls; they have a model error, a smooth "
    "force, which counts in all that follows."
)
_BOUNDS = (
    "How large the coefficient of $v|v|$ beside gravity and linear drag could be, at 95 %, and what it would add at "
    "the largest speeds."
)
_DROPS = (
    "The chance that the more probable of the two laws, linear and quadratic drag, each as probable as the other "
    f"beforehand, is the right one after one more drop of a ball from rest, {_HEIGHT:g} m to the ground, filmed as "
    "these were; 0.5 would tell nothing. And how many such drops make it 0.95."
)
_FORECASTS = "What the two laws forecast of the drop that tells most, less the forecast of linear drag."
_MASSES = (
    "How large the added mass could be, in masses of displaced air, by the acceleration of each ball at rest; what "
    "a sphere's added mass of one half takes from that acceleration in air; how well these drops tell it; and what "
    "it takes in water, where balls lighter than water rise."
)
_FLUID = (
    "In air the added mass takes far less from the acceleration than these drops can tell, from whatever height and "
    "at whatever rate. In water it is of the size of the mass of the ball itself, so that the first moments of one "
    "release show it."
)
