"""Part 14: what the method can and cannot say here, computed from the results of the other parts."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from commonlaw.array_types import Floats
from commonlaw.report import Block, Picture, Table, Text
from studies.falling_balls.errata import ERRATA
from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.landing import listed
from studies.falling_balls.plots import Curve, plot_curves
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import STANDARD_GRAVITY, WHIFFLE_BALLS

Results = Mapping[str, Any]


def findings(inquiry: Inquiry, results: Results) -> Section:
    """Return the last part: what the results of all others, by key, say together."""
    errata: tuple[Block, ...] = (Text(_ERRATA), Table("errata", _ERRATA_CAPTION, _errata_table()))
    if inquiry.drops is None:
        verdict = Verdict("left out", f"what the measured drops say is left out; {_simulated(results)}")
        return Section("findings", "Findings", errata, (verdict,))
    models = results["group_models"]
    blocks = (
        Text(_ASKED),
        Picture("gravity-and-drag", _COEFFICIENTS, partial(plot_curves, {"": _curves(models)}, _GRAVITY, _DRAG)),
        Table("constants", _CONSTANTS, _constants_table(models)),
        Text("\n".join(f"- {each}" for each in _said(results))),
        *errata,
    )
    numbers = {"gravity": _summary(models, "1"), "drag": _summary(models, "v")}
    return Section("findings", "Findings", blocks, (_gravity_verdict(models), _drag_verdict(models)), numbers)


def _values(models: Results, term: str) -> Floats:
    """Return the coefficients of a term, shape (drops, balls)."""
    return np.array([[model[term] for model in balls.values()] for balls in models.values()])


def _summary(models: Results, term: str) -> dict[str, float]:
    """Return how a coefficient varies: over balls, and between the two drops of a ball."""
    values = _values(models, term)
    return {
        "mean": float(values.mean()),
        "least": float(values.min()),
        "largest": float(values.max()),
        "spread_between_balls": float(values.mean(axis=0).std(ddof=1)),
        "spread_between_drops": float(np.sqrt(np.mean(np.diff(values, axis=0) ** 2) / 2)),
    }


def _gravity_verdict(models: Results) -> Verdict:
    constant = _summary(models, "1")
    near = np.abs(_values(models, "1") + STANDARD_GRAVITY) < 0.5
    varied = constant["spread_between_balls"] > 0.5 and near.mean() < 0.5
    return Verdict(
        "reproduced" if varied else "differs",
        f"The paper: by these data one would not conclude that all balls feel the same gravity. The parameters run "
        f"from {_number(constant['least'])} to {_number(constant['largest'])} m/s², {near.sum()} of {near.size} within "
        f"0.5 m/s² of −{STANDARD_GRAVITY}; they vary by {constant['spread_between_balls']:.2f} m/s² from ball to ball "
        f"and by {constant['spread_between_drops']:.2f} m/s² between drops of one ball (standard deviations).",
    )


def _drag_verdict(models: Results) -> Verdict:
    drags = dict(zip(_balls(models), _values(models, "v").T, strict=True))
    wrong = [name for name, drag in drags.items() if max(drag) > 0]
    means = {name: float(drag.mean()) for name, drag in drags.items()}
    others = [mean for name, mean in means.items() if name not in WHIFFLE_BALLS]
    strongest = max(means[name] for name in WHIFFLE_BALLS) < min(others)
    return Verdict(
        "reproduced" if wrong and strongest else "differs",
        f"The paper: some balls get a drag of the wrong sign. {listed(wrong)} do, in at least one drop; and the "
        f"whiffle balls have {'' if strongest else 'not '}the strongest drag of all.",
    )


def _said(results: Results) -> list[str]:
    """Return what the results say, sentence by sentence."""
    models, medians = results["group_models"], results["prediction_error_medians"]
    constant, drag = _values(models, "1").ravel(), _values(models, "v").ravel()
    forecasts = results["long_forecasts"]
    return [
        f"**The constant and the drag make up for each other.** Over the {constant.size} models their correlation is "
        f"{_number(np.corrcoef(constant, drag)[0, 1])}: a fall that begins too fast for gravity alone is given a drag "
        "that pushes. A value of either means little without the other.",
        f"**Two terms do as well as three.** The median error of height at the end of the other drop is "
        f"{medians['1']['both']:.2f} m with gravity alone, {medians['2']['both']:.2f} m with drag, and "
        f"{medians['3']['both']:.2f} m with a term in $v^2$ too; overfitted models have {medians['4']['both']:.2f} m.",
        "**Nobody should extrapolate.** After 15 s the models of one and the same drop are apart by "
        + listed([f"{_apart(forecast):.0f} m ({ball})" for ball, forecast in forecasts.items()])
        + ", and of the overfitted ones "
        + listed([f"that of the {ball} diverges after {time:.1f} s" for ball, time in _diverged(forecasts).items()])
        + ".",
        f"**Simulated drops tell what to expect.** {_simulated(results).capitalize()}.",
    ]


def _simulated(results: Results) -> str:
    shares = results["recovery"]["group, all balls"]
    noises = listed([f"{share:.0%} at {noise} m" for noise, share in shares.items()])
    return f"with linear drag known to be there, the group method finds exactly gravity and drag in {noises} of noise"


def _apart(models: Results) -> float:
    heights = [model["height_at_15_s"] for model in models.values() if model["height_at_15_s"] is not None]
    return float(max(heights) - min(heights))


def _diverged(forecasts: Results) -> dict[str, float]:
    return {
        ball: model["diverged_after"]
        for ball, models in forecasts.items()
        for model in models.values()
        if model["diverged_after"] is not None
    }


def _curves(models: Results) -> list[Curve]:
    constant, drag = _values(models, "1"), _values(models, "v")
    curves = [Curve(name, constant[:, i], drag[:, i], points=True) for i, name in enumerate(_balls(models))]
    ends = np.array([drag.min(), drag.max()])
    return [*curves, Curve("gravity", np.full(2, -STANDARD_GRAVITY), ends, line=":")]


def _constants_table(models: Results) -> pd.DataFrame:
    constant, drag = _values(models, "1"), _values(models, "v")
    return pd.DataFrame(
        {
            "ball": _balls(models),
            "constant, drop 1 (m/s²)": constant[0],
            "drop 2 (m/s²)": constant[1],
            "coefficient of v, drop 1 (1/s)": drag[0],
            "drop 2 (1/s)": drag[1],
        }
    )


def _errata_table() -> pd.DataFrame:
    return pd.DataFrame([{"where": each.where, "printed": each.printed, "found": each.found} for each in ERRATA])


def _balls(models: Results) -> list[str]:
    return list(models["1"])


def _number(value: float) -> str:
    return f"{value:.2f}".replace("-", "−")


_ASKED = """
The parts before this one are put together here. If one law governs all balls, then gravity should be the same for each
of them, drag should slow every ball, and what was learned from one drop should hold for the other and beyond. The group
models, $\\ddot x = a + b v$, say so or not.
"""
_GRAVITY = "constant term a (m/s²)"
_DRAG = "coefficient b of the velocity (1/s)"
_COEFFICIENTS = (
    "Both coefficients of every ball, one point for each drop, joined. The dotted line is gravity, where all points "
    "should lie; above zero the drag has the wrong sign."
)
_CONSTANTS = "The coefficients of the group models of each ball."
_ERRATA = "In some places the print and the authors' own method disagree. This is what the study found:"
_ERRATA_CAPTION = "Errors in print, and what the method gives."
