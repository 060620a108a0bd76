"""Part 7, continued: two balls on the drop that was learned from, and far beyond it."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from commonlaw.array_types import Floats
from commonlaw.differentiation import parse_differentiation
from commonlaw.integration import Trajectory
from commonlaw.law import Law
from commonlaw.law.law import object_index
from commonlaw.report import Picture, Table, Text
from commonlaw.report.document import cell
from commonlaw.trials import Trial, Trials
from studies.falling_balls.method import single_law
from studies.falling_balls.plots import Curve, plot_curves
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import (
    DIFFERENTIATION,
    ERROR_LIMITS,
    LONG_AGREEMENT,
    LONG_DROP,
    LONG_LIMITS,
    LONG_MODELS,
    LONG_STARTS,
    LONG_TIME,
    MODEL_NAMES,
    UNBOUNDED_AFTER,
)

_TIMES = np.linspace(0, LONG_TIME, 601)


@dataclass(frozen=True, eq=False)
class _Forecast:
    """One model of one ball: on the drop that it learned from, and for 15 s from the same start."""

    law: Law
    near: Trajectory
    far: Trajectory
    raised: Floats

    @property
    def end(self) -> float:
        """Raised height after 15 s, m; NaN after a divergence."""
        return float(self.raised[-1])

    def at(self, time: float) -> float:
        """Return the raised height at one of the times of the forecast, m."""
        return float(self.raised[np.searchsorted(_TIMES, time)])


@dataclass(frozen=True, eq=False)
class _Ball:
    """One ball: its drop as measured and as smoothed, and its forecasts by model."""

    trial: Trial
    smoothed: Floats
    forecasts: Mapping[str, _Forecast]

    def error(self, heights: Floats) -> Floats:
        """Return how far heights are from the measured ones, m."""
        return np.asarray(np.abs(heights - self.trial.states[:, 0]))

    def rms(self, heights: Floats) -> float:
        """Return the root of the mean squared distance, m."""
        return float(np.sqrt(np.mean(self.error(heights) ** 2)))


def long_forecasts(drops: Trials) -> Section:
    """Return blocks, a verdict and results for the part on prediction."""
    balls = {name: _study(drops.select(object=name, trial=LONG_DROP)) for name in LONG_STARTS}
    far = partial(plot_curves, _far_panels(balls), "t (s)", "height (m)", y_limits=LONG_LIMITS)
    near = partial(plot_curves, _near_panels(balls), "t (s)", "height (m)")
    errors = partial(
        plot_curves, _error_panels(balls), "t (s)", "absolute error (m)", log_y=True, y_limits=ERROR_LIMITS
    )
    return Section(
        "long-forecasts",
        "Beyond what was seen",
        (
            Text(_ASKED),
            Picture("forecasts-of-the-learned-drop", f"{_HERE} Measured heights and forecasts.", near),
            Picture("errors-on-the-learned-drop", f"{_HERE} {_OBSERVED}", errors),
            Text(_near_found(balls)),
            Picture("long-forecasts", _FAR, far),
            _equations(balls),
            Text(_far_found(balls)),
        ),
        (_verdict(balls),),
        {"long_forecasts": {name: _results(ball) for name, ball in balls.items()}},
    )


def _study(trials: Trials) -> _Ball:
    (trial,) = trials
    smoothed = parse_differentiation(DIFFERENTIATION).differentiate(trial.times, trial.states, 1).states[:, 0]
    forecasts = {}
    for model, setting in LONG_MODELS.items():
        law = single_law(trials, setting["threshold"], setting["library"])
        near = law.predict(trials).trajectories[0]
        # Terms in x hold for heights as measured, so the forecast starts there and is raised afterwards. Raised drops
        # give the same law, but from rows next to singular: cubes of 1000 m beside ones.
        far = law.simulate(_TIMES, near.states[0])[trial.object]
        raised = far.states[:, 0] + LONG_STARTS[trial.object] - trial.states[0, 0]
        forecasts[model] = _Forecast(law, near, far, raised)
    return _Ball(trial, smoothed, forecasts)


def _near_panels(balls: Mapping[str, _Ball]) -> dict[str, list[Curve]]:
    panels = {}
    for name, ball in balls.items():
        measured = Curve("measured", ball.trial.times, ball.trial.states[:, 0], line="")
        heights = {model: forecast.near.states[:, 0] for model, forecast in ball.forecasts.items()}
        panels[name] = [measured, *_curves(ball.trial.times, heights)]
    return panels


def _error_panels(balls: Mapping[str, _Ball]) -> dict[str, list[Curve]]:
    panels = {}
    for name, ball in balls.items():
        # All forecasts begin at the measured height, and a logarithmic axis has no place for an error of nothing
        times = ball.trial.times[1:]
        errors = {model: ball.error(forecast.near.states[:, 0])[1:] for model, forecast in ball.forecasts.items()}
        panels[name] = [Curve("observed", times, ball.error(ball.smoothed)[1:], line=":"), *_curves(times, errors)]
    return panels


def _far_panels(balls: Mapping[str, _Ball]) -> dict[str, list[Curve]]:
    panels = {}
    for name, ball in balls.items():
        # The first label keeps the colours that the models have in the figures of the learned drop
        start = Curve("height at the start", [0.0], [LONG_STARTS[name]], line="")
        panels[name] = [start, *_curves(_TIMES, {model: forecast.raised for model, forecast in ball.forecasts.items()})]
        ended = [forecast.far.ended for forecast in ball.forecasts.values() if forecast.far.ended is not None]
        if ended:
            panels[name].append(Curve("diverges", ended, np.full(len(ended), LONG_LIMITS[0] + 30), line=""))
    return panels


def _curves(times: Floats, values: Mapping[str, Floats]) -> list[Curve]:
    """Return a curve for each model; that of model 3, which often covers that of model 2, is dashed."""
    return [
        Curve(MODEL_NAMES[model], times, value, line="--" if model == "3" else "-") for model, value in values.items()
    ]


def _results(ball: _Ball) -> dict[str, dict[str, str | float | None]]:
    return {
        model: {
            "equation": forecast.law.equations()[0],
            "diverged_after": forecast.far.ended,
            "height_at_15_s": forecast.end if forecast.far.outcome is None else None,
        }
        for model, forecast in ball.forecasts.items()
    }


def _equations(balls: Mapping[str, _Ball]) -> Table:
    rows = [
        {
            "ball": name,
            "model": MODEL_NAMES[model],
            "equation": forecast.law.equations()[0].replace("-", "−"),
            f"error on drop {LONG_DROP} (m)": ball.rms(forecast.near.states[:, 0]),
            "diverges after (s)": forecast.far.ended,
            "height after 15 s (m)": forecast.end,
        }
        for name, ball in balls.items()
        for model, forecast in ball.forecasts.items()
    ]
    caption = (
        f"The models of the long forecasts, learned from drop {LONG_DROP} of each ball, with $x$ as measured. The "
        "error is the root of the mean square over the drop; the heights after 15 s are those of the raised curves."
    )
    return Table("long-forecast-models", caption, pd.DataFrame(rows).astype({"diverges after (s)": float}), 4)


def _verdict(balls: Mapping[str, _Ball]) -> Verdict:
    golf, whiffle = balls["Golf Ball"].forecasts, balls["Whiffle Ball 2"].forecasts
    ended, law = golf["4"].far.ended, golf["3"].law
    coefficient = float(law.coefficients[object_index(law, "Golf Ball")][0, law.terms.index("v^2")])
    runs_away = ended is not None and UNBOUNDED_AFTER[0] <= ended < UNBOUNDED_AFTER[1]
    # Heights count upwards: what hurries a falling ball has the sign of gravity
    hurries = coefficient < 0 and golf["3"].end < golf["1"].end
    apart = abs(whiffle["3"].end - whiffle["2"].end)
    fallen = LONG_STARTS["Whiffle Ball 2"] - whiffle["2"].end
    agree = apart < LONG_AGREEMENT * fallen
    text = (
        "The paper says that model 4 of the golf ball grows without bound after seven seconds; here it "
        + ("stays finite. " if ended is None else f"diverges after {ended:.2f} s. ")
        + "It says that models 2 and 3 of whiffle ball 2 agree; after 15 s they are "
        f"{apart:.1f} m apart, after a fall of {fallen:.0f} m. It says that the $v^2$ term in model 3 of the golf ball "
        "is wrongly positive and cancels the drag, so that the ball falls too fast; the coefficient is "
        f"{cell(coefficient, 2)} with heights counted upwards, as in the paper's equations, "
        + (
            f"so it does hurry the fall, to {golf['1'].end - golf['3'].end:.0f} m below model 1 after 15 s, but its "
            "sign is negative."
            if hurries
            else "and does not make the ball fall faster than without drag."
        )
    )
    return Verdict("reproduced with correction" if runs_away and hurries and agree else "differs", text)


_HERE = f"Forecasts of the drop that the models learned from, drop {LONG_DROP}, from its first height and speed."
_OBSERVED = (
    "Absolute errors; the dotted line is the distance between measured and smoothed heights, which tells how large the "
    "noise is."
)
_FAR = (
    f"Forecasts to {LONG_TIME:.0f} s from the start of drop {LONG_DROP}, as if the balls fell from "
    + " and ".join(f"{height:.0f} m ({name})" for name, height in LONG_STARTS.items())
    + ". A cross at the foot of a panel marks when a forecast runs away to infinity. The balls were observed for less "
    "than four seconds."
)

_ASKED = f"""
What do the models say where nothing was measured? Drop {LONG_DROP} of the golf ball and of whiffle ball 2 is forecast
by four models that learned from this drop, each from one ball alone: first over the drop itself, where all should do
well, then for {LONG_TIME:.0f} s. The balls would be deep in the ground by then, so the curves are raised to start at
{" m and ".join(f"{height:.0f}" for height in LONG_STARTS.values())} m. In terms with $x$ the height is as measured: at
the raised height model 4 would stand far outside of what it learned from at once.
"""


def _near_found(balls: Mapping[str, _Ball]) -> str:
    lines = []
    for name, ball in balls.items():
        first, *others = (ball.rms(forecast.near.states[:, 0]) for forecast in ball.forecasts.values())
        lines.append(
            f"- {name}: {first:.3f} m for model 1, {min(others):.3f} m to {max(others):.3f} m for models 2 to 4; the "
            f"measured heights are {ball.rms(ball.smoothed):.3f} m from the smoothed ones."
        )
    return "Roots of the mean squared error over the drop:\n\n" + "\n".join(lines)


def _far_found(balls: Mapping[str, _Ball]) -> str:
    lines = []
    for name, ball in balls.items():
        ends = [ball.forecasts[model].end for model in "123"]
        apart = [abs(ball.forecasts["4"].at(time) - ball.forecasts["2"].at(time)) for time in (4.0, 6.0, 7.0)]
        lines.append(
            f"- {name}: after {LONG_TIME:.0f} s models 1 to 3 are within {max(ends) - min(ends):.0f} m of each other. "
            f"Model 4 is {apart[0]:.2f} m, {apart[1]:.1f} m and {apart[2]:.0f} m from model 2 after 4 s, 6 s and 7 s."
        )
    return "How far the models part beyond the drop:\n\n" + "\n".join(lines)
