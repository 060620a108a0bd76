"""Part 1: the balls, their drops, and when they land."""

import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
import pandas as pd

from commonlaw.array_types import Floats
from commonlaw.datasets import linear_drag
from commonlaw.plots import plot_trials
from commonlaw.report import Block, Picture, Table, Text
from commonlaw.trials import Trials
from studies.falling_balls.inquiry import Inquiry, left_out
from studies.falling_balls.landing import (
    Balls,
    common_distance,
    density_verdict,
    frame_time,
    landing_table,
    landing_text,
    landing_times,
    listed,
    order_verdict,
)
from studies.falling_balls.plots import plot_displacement, plot_property, plot_strobe
from studies.falling_balls.printed import printed_table, prints_as
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import GOLF_BALL_OUNCES, REFERENCE_DRAGS, STROBE
from studies.falling_balls.speeds import speeds

_TITLE = "The balls and their drops"
_PRINTED = {
    "radius": ("radius_m", "radius (m)"),
    "mass": ("mass_kg", "mass (kg)"),
    "density": ("density_kg_m3", "density (kg/m³)"),
    "max_speed": ("max_speed_m_s", "largest speed (m/s)"),
}
"""Column of the printed table, and head of the columns here, by what is in them."""

Printed = Mapping[str, Mapping[str, str]]
"""Printed numbers by what they are and by ball."""


def data(inquiry: Inquiry) -> Section:
    """Return the part on the measurements themselves: what was dropped, how it fell, and what the paper says of it."""
    drops = inquiry.drops
    if drops is None:
        return left_out("data", _TITLE, inquiry.missing)
    balls = {
        name: {
            **{key: float(value) for key, value in drops.properties[name].items()},
            "max_speed": max(float(speeds(trial).max()) for trial in drops.of_object(name)),
        }
        for name in drops.objects
    }
    printed = _printed()
    frame, distance = frame_time(drops), common_distance(drops)
    landing = landing_times(drops, distance)
    slopes = _final_slopes(drops)
    unknown = [name for name, values in balls.items() if "density" not in values]
    blocks: tuple[Block, ...] = (
        Text(_experiment(drops, frame)),
        Table(
            "balls",
            "The balls: what the paper prints, and what the weights, circumferences and heights in the data files "
            "give. The largest speed is that of both drops. The volleyball was neither weighed nor measured; its "
            "radius is that of other volleyballs.",
            _table(balls, printed),
            digits=6,
        ),
        *_pictures(drops.select(trial="2")),
        Picture(
            "landing-time",
            f"Time that each ball takes to fall {distance:.2f} m against its density, for each drop. "
            f"Left out, as the density is not known: {listed(unknown)}.",
            partial(
                plot_property,
                drops,
                "density",
                {f"drop {name}": times for name, times in landing.items()},
                "landing time (s)",
            ),
        ),
        Table(
            "landing-times",
            f"Time to fall {distance:.2f} m, and by how much the second drop took longer.",
            landing_table(balls, landing),
        ),
        Text(f"{landing_text(landing, frame)}\n\n{_slope_text(slopes)}"),
    )
    verdicts = (_balls_verdict(balls, printed), order_verdict(landing, slopes), density_verdict(balls, landing, frame))
    return Section("data", _TITLE, blocks, verdicts, {"balls": balls, "landing_time": landing})


def _experiment(drops: Trials, frame: float) -> str:
    lengths = [len(trial) for trial in drops]
    fallen = [float(np.ptp(trial.states)) for trial in drops]
    last = [float(trial.states[-1, 0]) for trial in drops]
    return (
        f"In June 2013 {len(drops.objects)} sports balls and a bowling ball were dropped, twice each, from the Alex "
        "Fraser Bridge in Vancouver, about 35 m above the landing site, at 18 °C. A hand-held tablet filmed them at "
        f"{1 / frame:.0f} frames a second, and the balls were tracked in the film: {min(lengths)} to {max(lengths)} "
        f"heights a drop, in which a ball falls {min(fallen):.1f} to {max(fallen):.1f} m. The last heights are "
        f"{min(last):.1f} to {max(last):.1f} m, so the scale has its zero below the place of landing. The bowling ball "
        "is left out, as in the paper: its first drop is corrupted.\n\n"
        "The authors name these sources of error: the low resolution of the film; a camera that was held by hand; a "
        "height of the bridge that is known to 0.5 m; wind; the moments of release and landing, and the speed at "
        "release, which are judged from the film; and balls that are not smooth spheres, least of all the whiffle "
        "balls with their holes.\n\n"
        "What happens at the very end of a drop is not trusted either: it ends before its last irregular frame. "
        f"{' '.join(f'{note[0].upper()}{note[1:]}.' for note in drops.notes)}"
    )


def _table(balls: Balls, printed: Printed) -> pd.DataFrame:
    columns: dict[str, list[object]] = {"ball": list(balls)}
    for key, (_, head) in _PRINTED.items():
        columns[f"{head}: printed"] = [printed[key][name] for name in balls]
        columns[f"{head}: found"] = [values.get(key) for values in balls.values()]
    return pd.DataFrame(columns)


def _printed() -> Printed:
    table = printed_table("ball_properties")
    return {
        key: dict(zip(table["object"].tolist(), table[column].tolist(), strict=True))
        for key, (column, _) in _PRINTED.items()
    }


def _pictures(second: Trials) -> tuple[Picture, ...]:
    """Return how the balls fell in the second drop."""
    return (
        Picture(
            "strobe",
            f"The second drop of every ball as under a strobe light: height $x$ at every {STROBE}rd frame, one column "
            "for each ball. Grey lines join the same frame of neighbouring balls.",
            partial(plot_strobe, second, every=STROBE),
        ),
        Picture(
            "heights",
            "Height $x$ over time $t$ in the second drop. Black: simulated falls from the mean of the first heights, "
            f"without drag, and slowed by {listed([f'{-drag:g}/s' for drag in REFERENCE_DRAGS])} times the speed $v$.",
            partial(plot_trials, second, references=_references(second)),
        ),
        Picture(
            "displacement",
            "Distance fallen in the second drop on logarithmic axes. A body that falls at constant speed runs along "
            "slope one in the end, one without drag along slope two.",
            partial(plot_displacement, second),
        ),
    )


def _final_slopes(drops: Trials) -> list[float]:
    """Return for each drop the logarithmic slope of the distance fallen over the last second."""
    slopes = []
    for trial in drops:
        last = trial.times > trial.times[-1] - 1
        times, fallen = trial.times[last] - trial.times[0], trial.states[0, 0] - trial.states[last, 0]
        slopes.append(float(np.polyfit(np.log(times), np.log(fallen), 1)[0]))
    return slopes


def _slope_text(slopes: Sequence[float]) -> str:
    steep = sum(slope > 2 for slope in slopes)
    return (
        "Over the last second of a drop the distance fallen has a logarithmic slope of "
        f"{min(slopes):.2f} to {max(slopes):.2f}. In {steep} of {len(slopes)} drops it is above 2, steeper than "
        "without drag, as when the first frame shows the ball some time before it is let go."
    )


def _references(drops: Trials) -> dict[str, tuple[Floats, Floats]]:
    """Return simulated falls from the drops' mean first height, down to where the drops end."""
    start = float(np.mean([trial.states[0, 0] for trial in drops]))
    end = min(float(trial.states.min()) for trial in drops)
    drags, samples = (0.0, *REFERENCE_DRAGS), max(map(len, drops))
    falls = linear_drag(drag=drags, height=start, samples=samples, trials=1, noise=0.0)
    labels = ["no drag", *(f"drag {-drag:g} v" for drag in REFERENCE_DRAGS)]
    return {
        label: (fall.times, np.where(fall.states[:, 0] >= end, fall.states[:, 0], np.nan))
        for label, fall in zip(labels, falls, strict=True)
    }


def _balls_verdict(balls: Balls, printed: Printed) -> Verdict:
    total = sum(bool(text) for texts in printed.values() for text in texts.values())
    off = [
        f"{key} of the {name}"
        for key, texts in printed.items()
        for name, text in texts.items()
        if not _agrees(balls[name].get(key), text)
    ]
    golf, ratio = balls["Golf Ball"], GOLF_BALL_OUNCES["printed"] / GOLF_BALL_OUNCES["measured"]
    explained = [
        f"{key} of the Golf Ball"
        for key in ("mass", "density")
        if _agrees(golf[key] * ratio, printed[key]["Golf Ball"])
    ]
    text = f"{total - len(off)} of {total} radii, masses, densities and largest speeds come out as printed"
    if not off:
        return Verdict("reproduced", f"{text}.")
    if off != explained:
        return Verdict("differs", f"{text}; not the {listed(off)}.")
    return Verdict(
        "reproduced with correction",
        f"{text}. The others are those of the golf ball: printed are {printed['mass']['Golf Ball']} kg and "
        f"{printed['density']['Golf Ball']} kg/m³, that is {GOLF_BALL_OUNCES['printed']:g} oz; the data file has "
        f"{GOLF_BALL_OUNCES['measured']:g} oz, that is {golf['mass']:.6f} kg and {golf['density']:.1f} kg/m³.",
    )


def _agrees(value: float | None, text: str) -> bool:
    """Return whether a value prints as the text, or has its first six digits: the authors' ounce is rounded to six."""
    if value is None or not text:
        return value is None and not text
    return prints_as(value, text) or math.isclose(value, float(text), rel_tol=1e-6)
