"""When balls land: the time that they take to fall a fixed distance."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from scipy.stats import spearmanr

from commonlaw.trials import Trials
from studies.falling_balls.errata import LANDING
from studies.falling_balls.report import Verdict
from studies.falling_balls.settings import BASKETBALLS, FASTER_AT_FIRST, HORIZON, WHIFFLE_BALLS

Balls = Mapping[str, Mapping[str, float]]
"""Properties by ball."""

Landing = Mapping[str, Mapping[str, float]]
"""Landing times by drop and ball, s."""

_HALF_WAY = 1.5
"""Logarithmic slope of the distance fallen, half way from that at constant speed to that without drag."""


def common_distance(drops: Trials) -> float:
    """Return the distance, m, that every ball has fallen at the last sample that all drops have."""
    return min(float(trial.states[0, 0] - trial.states[HORIZON - 1, 0]) for trial in drops)


def landing_times(drops: Trials, distance: float) -> dict[str, dict[str, float]]:
    """Return by drop and ball the time of the first sample at which a ball has fallen that far, s."""
    times: dict[str, dict[str, float]] = {}
    for trial in drops:
        landed = int(np.argmax(trial.states[0, 0] - trial.states[:, 0] >= distance))
        times.setdefault(trial.name, {})[trial.object] = float(trial.times[landed] - trial.times[0])
    return times


def delays(landing: Landing) -> dict[str, float]:
    """Return by how much later each ball lands in the second drop, s, to a millisecond."""
    # The sum makes a plain zero of a negative one
    return {name: round(landing["2"][name] - landing["1"][name], 3) + 0.0 for name in landing["1"]}


def frame_time(drops: Trials) -> float:
    """Return the time from one frame to the next, s."""
    return float(np.median(np.concatenate([np.diff(trial.times) for trial in drops])))


def landing_table(balls: Balls, landing: Landing) -> pd.DataFrame:
    """Return density and landing times of every ball."""
    return pd.DataFrame(
        {
            "ball": list(balls),
            "density (kg/m³)": [values.get("density") for values in balls.values()],
            "drop 1 (s)": [landing["1"][name] for name in balls],
            "drop 2 (s)": [landing["2"][name] for name in balls],
            "drop 2 − drop 1 (s)": [delays(landing)[name] for name in balls],
        }
    )


def landing_text(landing: Landing, frame: float) -> str:
    """Return what differs between the two drops, in words."""
    moved = {name: round(delay / frame) for name, delay in delays(landing).items()}
    later = [f"{name} by {_frames(count)}" for name, count in moved.items() if count > 0]
    earlier = [f"{name} by {_frames(count)}" for name, count in moved.items() if count < 0]
    same = [name for name, count in moved.items() if not count]
    return (
        f"A landing time is that of a frame, so it is known to {frame:.3f} s. In the second drop these balls land "
        f"later: {listed(later)}. These land earlier: {listed(earlier)}. These land at the same frame: {listed(same)}."
    )


def order_verdict(landing: Landing, slopes: Sequence[float]) -> Verdict:
    """Return whether the whiffle balls come last, all balls land within a second, and none falls at constant speed.

    Parameters
    ----------
    landing
        Landing times.
    slopes
        Logarithmic slope of the distance fallen against time at the end of each drop.
    """
    last = all(
        min(times[name] for name in WHIFFLE_BALLS) > max(times[name] for name in times.keys() - set(WHIFFLE_BALLS))
        for times in landing.values()
    )
    spread = max(max(times.values()) - min(times.values()) for times in landing.values())
    accelerates = min(slopes) > _HALF_WAY
    return Verdict(
        "reproduced" if last and spread < 1 and accelerates else "differs",
        f"The whiffle balls {'are' if last else 'are not'} the last to land in both drops. All balls land within "
        f"{spread:.2f} s of each other (the paper: within a second). {'No' if accelerates else 'Some'} ball "
        f"has reached its terminal speed: in the last second the slope of the distance fallen on logarithmic axes is "
        f"{min(slopes):.2f} or more, where constant speed tends to 1 and free fall has 2.",
    )


def density_verdict(balls: Balls, landing: Landing, frame: float) -> Verdict:
    """Return whether the balls land as the paper says in the two drops, and the denser ones faster."""
    dense = [name for name, values in balls.items() if "density" in values]
    later, quicker = ([name for name in dense if sign * delays(landing)[name] > frame / 2] for sign in (1, -1))
    others = [name for name in dense if name not in BASKETBALLS]
    with_all, without = (
        [_rank_correlation(balls, times, names, frame) for times in landing.values()] for names in (dense, others)
    )
    defy = all(
        max(times[name] for name in BASKETBALLS) < min(times[name] for name in WHIFFLE_BALLS)
        for times in landing.values()
    )
    holds = set(later) == set(FASTER_AT_FIRST) and max(without) < min(with_all) < 0 and defy
    return Verdict(
        "reproduced with correction" if holds else "differs",
        f"Printed: {LANDING.where.lower()}, {LANDING.printed}. {LANDING.found} Here each drop has its own. Faster in "
        f"the first drop by a frame or more: {listed(later)} (the paper: {listed(FASTER_AT_FIRST)}); faster in the "
        f"second: {listed(quicker)} (not in the paper). Denser balls are faster: the rank correlation of density and "
        f"landing time is {_signed(with_all)} in the two drops, and {_signed(without)} without the basketballs. These "
        f"{'defy' if defy else 'do not defy'} the trend: the least dense of all, they land "
        f"{'before every whiffle ball' if defy else 'after some whiffle balls'}.",
    )


def listed(names: Sequence[str]) -> str:
    """Return names as a list in a sentence.

    >>> listed(["a", "b", "c"]), listed(["a"]), listed([])
    ('a, b and c', 'a', 'none')
    """
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]])) or "none"


def _rank_correlation(balls: Balls, times: Mapping[str, float], names: Sequence[str], frame: float) -> float:
    """Return the rank correlation of density and landing time; balls that land at the same frame share a rank."""
    frames = [round(times[name] / frame) for name in names]
    return float(spearmanr([balls[name]["density"] for name in names], frames).statistic)


def _frames(count: int) -> str:
    return f"{abs(count)} frame{'s' if abs(count) > 1 else ''}"


def _signed(values: Sequence[float]) -> str:
    return listed([f"{value:.2f}".replace("-", "−") for value in values])
