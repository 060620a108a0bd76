"""How noisy the measured heights are."""

from collections.abc import Mapping
from functools import partial
from math import sqrt

import numpy as np
import pandas as pd

from commonlaw.differentiation import noise_level
from commonlaw.report import Picture, Table, Text
from commonlaw.trials import Trials
from studies.falling_balls.plots import plot_by_object
from studies.falling_balls.rate_errors import LARGEST, NoisyFall, relative
from studies.falling_balls.report import Verdict
from studies.falling_balls.settings import PRINTED_NOISE

Noise = Mapping[str, Mapping[str, Mapping[str, float]]]
"""By drop, ball and way of estimating it, m."""

_WAYS = {"paper_method": "as in the paper", "robust": "from differences"}


def noise_of_drops(drops: Trials, fall: NoisyFall) -> dict[str, dict[str, dict[str, float]]]:
    """Return the noise of every drop, estimated in the paper's way and straight from the data.

    In the paper's way it is the noise at which smoothing changes the simulated fall as much as it changes the drop,
    relatively; zero if it changes the fall more than that without noise. The paper reads it off a figure with one draw
    of noise at each level; here it is exact for the mean over all noise.
    """
    lost, taken = fall.mean_change(LARGEST)
    size, count = float(np.sum(fall.heights**2)), len(fall.heights)
    found: dict[str, dict[str, dict[str, float]]] = {}
    for drop in drops:
        change = float(relative(LARGEST.smooth(drop.times, drop.states), drop.states)[0])
        # Both norms grow with the noise: change^2 (size + count noise^2) = lost + taken noise^2
        square = (change**2 * size - lost) / (taken - change**2 * count)
        found.setdefault(drop.name, {})[drop.object] = {
            "paper_method": sqrt(max(square, 0.0)),
            "robust": float(noise_level(drop.times, drop.states)[0]),
        }
    return found


def noise_blocks(drops: Trials, noise: Noise) -> tuple[Text | Picture | Table, ...]:
    """Return how noisy the drops are, for the report."""
    low, high = PRINTED_NOISE
    panels = {
        text: {f"drop {drop}": {ball: each[way] for ball, each in balls.items()} for drop, balls in noise.items()}
        for way, text in _WAYS.items()
    }
    picture = partial(plot_by_object, panels, "noise (m)", {f"paper: {low:g} to {high:g} m": PRINTED_NOISE})
    return (
        Picture(
            "noise-of-drops",
            "Estimated standard deviation of the noise on the heights of every drop. Left: as in the paper, from how "
            "much smoothing changes the heights. Right: a robust estimate from differences of neighbouring heights.",
            picture,
        ),
        _table(noise),
        Text(_found(drops, noise)),
    )


def noise_verdict(noise: Noise, fall: NoisyFall) -> Verdict:
    """Return whether the noise of all drops is within the range that the paper gives, in its three decimals."""
    low, high = PRINTED_NOISE
    estimates = {(ball, drop): each["paper_method"] for drop, balls in noise.items() for ball, each in balls.items()}
    outside = {key: value for key, value in estimates.items() if not low <= round(value, 3) <= high}
    index = int(np.argmin(np.abs(fall.levels - high)))
    changes = fall.changes(LARGEST)[index]
    text = (
        f"The paper says that the noise of all drops is {low:g} to {high:g} m. In its way it comes out so for "
        f"{len(estimates) - len(outside)} of {len(estimates)} drops."
    )
    if not outside:
        return Verdict("reproduced", text)
    listed = ", ".join(f"{ball}, drop {drop}: {value:.3f} m" for (ball, drop), value in sorted(outside.items()))
    return Verdict(
        "differs",
        f"{text} The others: {listed}. The paper's comparison rests on one draw of noise, which scatters by "
        f"{changes.std() / changes.mean():.0%}.",
    )


def _table(noise: Noise) -> Table:
    balls = list(dict.fromkeys(ball for each in noise.values() for ball in each))
    columns = {
        f"{text}, drop {drop} (m)": [noise[drop][ball][way] for ball in balls]
        for way, text in _WAYS.items()
        for drop in noise
    }
    caption = (
        f"Estimated standard deviation of the noise on the heights of every drop. Printed: "
        f"{PRINTED_NOISE[0]:g} to {PRINTED_NOISE[1]:g} m for all drops, in the paper's way."
    )
    return Table("noise-by-drop", caption, pd.DataFrame({"ball": balls, **columns}), 3)


def _found(drops: Trials, noise: Noise) -> str:
    pairs = {(drop, ball): each for drop, balls in noise.items() for ball, each in balls.items()}
    typical = {way: float(np.median([pair[way] for pair in pairs.values()])) for way in _WAYS}
    drop, ball = max(pairs, key=lambda key: pairs[key]["paper_method"] / pairs[key]["robust"])
    (trial,) = drops.select(object=ball, trial=drop)
    residuals = np.abs(trial.states - LARGEST.smooth(trial.times, trial.states))[:, 0]
    worst, share = int(np.argmax(residuals)), float(np.max(residuals**2) / np.sum(residuals**2))
    return f"""
The median over all drops is {typical["paper_method"]:.3f} m in the paper's way and {typical["robust"]:.3f} m from
differences. The paper's way calls noise all that smoothing changes: also wobbles of the camera that last for several
frames, and single frames that went wrong. Differences see only what changes from one frame to the next, and leave
outliers out. The two are furthest apart for the {ball}, drop {drop}, with {pairs[drop, ball]["paper_method"]:.3f} m and
{pairs[drop, ball]["robust"]:.3f} m: there a single height, at sample {worst + 1} of {len(trial)}, makes up {share:.0%}
of all that smoothing changes, in squares.
"""
