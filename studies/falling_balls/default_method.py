"""Part 8: what the default method of this library, which the paper did not have, says of the measured drops."""

from collections.abc import Mapping
from functools import partial

import numpy as np
import pandas as pd

from commonlaw.law import Law
from commonlaw.law.law import shares_terms
from commonlaw.plots import plot_forecast
from commonlaw.report import Picture, Table, Text
from studies.falling_balls.default_forecasts import CUBIC, DEFAULT, LINEAR, Forecasts, default_forecasts, every
from studies.falling_balls.drag_choices import Choice, agreed, drag_choices, form_of
from studies.falling_balls.inquiry import Inquiry, left_out
from studies.falling_balls.model_error import OTHER_DROP
from studies.falling_balls.plots import plot_errors
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import HORIZON, MODEL_NAMES, RATE_SAMPLES, REDRAWS

_NAME, _TITLE = "default-method", "What the default method says of the drops"
_NAMES = {**MODEL_NAMES, DEFAULT: "default, of 1, v and v²"}


def default_method(inquiry: Inquiry) -> Section:
    """Return the part on the default method: its choice of drag for groups of balls, and its forecasts."""
    drops = inquiry.drops
    if drops is None:
        return left_out(_NAME, _TITLE, inquiry.missing)
    section, choices = drag_choices(drops)
    found = default_forecasts(drops)
    blocks = (
        *section.blocks,
        Text(_ASKED),
        Picture("default-forecasts", _FORECASTS, partial(plot_forecast, found.default["1"])),
        Picture("default-prediction-errors", _ERRORS, partial(plot_errors, _panels(found), "error of height (m)")),
        Table("default-prediction-medians", _MEDIANS, _frame(found), 4),
        Text(_compared(found)),
        Text(_rates(found)),
    )
    names = ("paper_rule", "fitted_to_first_second", "parabola_of_first_second")
    medians = dict(zip(names, found.medians, strict=True))
    forecasts = {
        "errors": dict(zip(names, (found.rule, found.fitted, found.parabola), strict=True)),
        "medians": medians,
        "share_of_initial_rate": {model: found.share(model) for model in found.fitted},
        "gain_on_best_model": found.gain,
        "deviation_of_gain": found.deviation,
    }
    results = {"default_method": {"choices": section.results, "forecasts": forecasts}}
    return Section(_NAME, _TITLE, blocks, _verdicts(choices, found), results)


def _panels(found: Forecasts) -> dict[str, dict[str, Mapping[str, float]]]:
    shown = {
        "linear drag, paper": found.rule[LINEAR],
        "default": found.rule[DEFAULT],
        "default of cubic terms": found.rule[CUBIC],
        "linear drag, fitted rate": found.fitted[LINEAR],
        "default, fitted rate": found.fitted[DEFAULT],
    }
    return {
        f"trained on drop {drop}, tested on drop {other}": {name: errors[drop] for name, errors in shown.items()}
        for drop, other in OTHER_DROP.items()
    }


def _frame(found: Forecasts) -> pd.DataFrame:
    rule, fitted, parabola = found.medians
    rows = [
        {
            "model": _NAMES.get(model, model),
            **{f"law, drop {drop}": _form(law) for drop, law in by_drop.items()},
            "rate by the paper's rule (m)": rule[model]["both"],
            "rate fitted to the first second (m)": fitted[model]["both"] if model in fitted else None,
            "share of the error that goes": found.share(model) if model in fitted else None,
            "rate of a parabola (m)": parabola[model]["both"] if model in parabola else None,
        }
        for model, by_drop in found.laws.items()
    ]
    return pd.DataFrame(rows)


def _form(law: Law) -> str:
    return form_of(law) if shares_terms(law) else "each ball its own"


def _comparison(found: Forecasts) -> str:
    medians = found.medians[0]
    if abs(found.gain) < found.deviation:
        word = "a tie"
    else:
        word = "better" if found.gain > 0 else "worse"
    return (
        f"{medians[DEFAULT]['both']:.3f} m, against {medians[found.best]['both']:.3f} m of the best of "
        f"the paper's, model {found.best}: {word}"
    )


def _compared(found: Forecasts) -> str:
    cubic = {drop: f"${form_of(law)}$" for drop, law in found.laws[CUBIC].items()}
    default, best = np.array(every(found.rule[DEFAULT])), np.array(every(found.rule[found.best]))
    return (
        f"The default's median error is {_comparison(found)}. The medians differ by {abs(found.gain):.3f} m; over "
        f"{REDRAWS} draws of {len(default)} forecasts from these, with repetition, that difference has a standard "
        f"deviation of {found.deviation:.2f} m. The default is the nearer of the two in {np.sum(default < best)} of "
        f"{len(default)} forecasts. If it is given no library either, it has all terms in $x$ and $v$ up to the third "
        f"degree to choose from: it takes {cubic['1']} on drop 1 and {cubic['2']} on drop 2, and has a median of "
        f"{found.medians[0][CUBIC]['both']:.3f} m. "
        f"Of the heights measured at sample {HORIZON}, {found.inside} of {len(default)} lie in the default's 95 % "
        "bands. These count the noise, the errors of the coefficients and of the law; that another drop of the same "
        "ball is another fall, with another wind, they cannot know from one drop of each ball."
    )


def _rates(found: Forecasts) -> str:
    rule, fitted, parabola = found.medians
    squares = [float(np.sqrt(np.mean(np.square(every(errors[DEFAULT]))))) for errors in (found.rule, found.fitted)]
    remains = "Less" if min(found.share(LINEAR), found.share(DEFAULT)) > 0.5 else "More"
    return (
        f"How much of the error is the initial rate's? With the rate fitted to the first {RATE_SAMPLES} samples the "
        f"default's median is {fitted[DEFAULT]['both']:.2f} m instead of {rule[DEFAULT]['both']:.2f} m, and that of "
        f"the paper's linear drag {fitted[LINEAR]['both']:.2f} m instead of {rule[LINEAR]['both']:.2f} m: "
        f"{found.share(DEFAULT):.0%} and {found.share(LINEAR):.0%} of the error go. The default's root of the mean "
        f"squared error goes from {squares[0]:.2f} m to {squares[1]:.2f} m. These forecasts have seen the first second "
        "of the drop that they forecast, and a rate that is fitted through the law also makes up for some of the law's "
        "own faults, so the shares are rather too large. The rate of a parabola, which knows nothing of the law, gives "
        f"{parabola[DEFAULT]['both']:.2f} m and {parabola[LINEAR]['both']:.2f} m. {remains} than half of the error "
        "remains for the law: its form, and what one drop can teach of another."
    )


def _verdicts(choices: Mapping[str, Choice], found: Forecasts) -> tuple[Verdict, ...]:
    by_form: dict[str, list[str]] = {}
    for group, choice in choices.items():
        by_form.setdefault(choice.form, []).append(group)
    chosen = "; ".join(f"{form} for the {', the '.join(groups)}" for form, groups in by_form.items())
    drag = (
        f"The default method chooses {chosen}. The evidence names the same law for {len(agreed(choices))} of "
        f"{len(choices)} groups."
    )
    _, fitted, _ = found.medians
    forecast = (
        f"The median error of its {len(every(found.rule[DEFAULT]))} forecasts at sample {HORIZON} is "
        f"{_comparison(found)}. With an initial rate fitted to the first second of the unseen drop it is "
        f"{fitted[DEFAULT]['both']:.2f} m: {found.share(DEFAULT):.0%} of the error goes with the initial rate."
    )
    return Verdict("beyond the paper", drag), Verdict("beyond the paper", forecast)


_ASKED = f"""
The forecasts are those of the part before this one. Laws of all ten balls learn from one drop of each and are tested on
the other, from its first height and the rate that the paper's rule gives there; what counts is the error at sample
{HORIZON}. The default method stands beside the paper's four models. Then the two models with a linear drag start with a
better rate: the one with which the law's own trajectory, from the same first height, is nearest to the first
{RATE_SAMPLES} samples (least squares). This is the rate that the law itself would have wanted, but it uses about one
second of the drop that is forecast.
"""
_FORECASTS = (
    "Forecasts of drop 2 by the default's law of all ten balls, learned from drop 1. Above: heights. Below: forecast "
    "minus measurement, and the 95 % band in which it should lie."
)
_ERRORS = (
    f"Error of the forecast height at sample {HORIZON}, one mark for each ball and a line at the median. The last two "
    "columns start with a rate fitted to the first second of the drop that they forecast; the others start with the "
    "paper's."
)
_MEDIANS = (
    f"Median error of height at sample {HORIZON} over 20 forecasts, by model and by the initial rate of the forecast. "
    "The law is the one learned from that drop of all ten balls. The share is that of the median error which goes when "
    "the rate is fitted to the first second of the unseen drop."
)
