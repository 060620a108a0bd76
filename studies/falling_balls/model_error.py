"""Part 7: how well models that learned from one drop predict the other, and what they say of longer falls."""

from collections.abc import Mapping
from functools import partial

import numpy as np
import pandas as pd

from commonlaw.law import Law
from commonlaw.law.law import shares_terms
from commonlaw.report import Picture, Table, Text
from commonlaw.trials import Trial, Trials
from studies.falling_balls.errata import PREDICTION
from studies.falling_balls.inquiry import Inquiry, left_out
from studies.falling_balls.long_forecasts import long_forecasts
from studies.falling_balls.method import group_law, single_law
from studies.falling_balls.plots import plot_errors
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import HORIZON, MODEL_NAMES, MODEL_TERMS, MODELS, RATE_SAMPLES, SIMILAR

_NAME, _TITLE = "model-error", "How well the models predict"
OTHER_DROP = {"1": "2", "2": "1"}
"""The drop that is forecast by the drop that was learned from."""

Errors = Mapping[str, Mapping[str, Mapping[str, float]]]
"""Of height, m, by model, training drop and ball."""

Medians = Mapping[str, Mapping[str, float]]
"""Of errors, m, by model and training drop, and over "both"."""


def model_error(inquiry: Inquiry) -> Section:
    """Return the part on the error of prediction."""
    drops = inquiry.drops
    if drops is None:
        return left_out(_NAME, _TITLE, inquiry.missing)
    laws = {model: {drop: learned(drops.select(trial=drop), model) for drop in OTHER_DROP} for model in MODELS}
    errors = {model: errors_of_height(by_drop, drops) for model, by_drop in laws.items()}
    medians = medians_of(errors)
    rates = [
        _rate_test(law, trial) for drop, law in laws["2"].items() for trial in drops.select(trial=OTHER_DROP[drop])
    ]
    long = long_forecasts(drops)
    return Section(
        _NAME,
        _TITLE,
        (
            Text(_asked(drops)),
            Picture("prediction-errors", _CAPTION, partial(plot_errors, _panels(errors), "error of height (m)")),
            _error_table(errors),
            _median_table(medians, laws),
            Text(_found(medians, rates)),
            *long.blocks,
        ),
        (_simple_models(medians, laws), _overfit_model(errors, medians), *long.verdicts),
        {
            "prediction_error": errors,
            "prediction_error_medians": medians,
            "prediction_error_fitted_rate_median": float(np.median([error for error, _ in rates])),
            **long.results,
        },
    )


def learned(trials: Trials, model: str) -> Law:
    """Return what one of the paper's models learns from these drops."""
    setting = MODELS[model]
    return (group_law if setting["group"] else single_law)(trials, setting["threshold"], setting["library"])


def errors_of_height(laws: Mapping[str, Law], drops: Trials) -> dict[str, dict[str, float]]:
    """Return how far forecasts of the other drop are off at the horizon, m, by the drop that was learned from and ball.

    A forecast that diverged before is infinitely far off.
    """
    return {drop: _errors(law, drops.select(trial=OTHER_DROP[drop])) for drop, law in laws.items()}


def _errors(law: Law, tests: Trials) -> dict[str, float]:
    # From one sample: the paper's rule, also for laws that could fit their start to more of the unseen drop
    forecast = law.predict(tests, start=1)
    residuals = [
        abs(float(trajectory.states[HORIZON - 1, 0] - trial.states[HORIZON - 1, 0]))
        for trial, trajectory in zip(tests, forecast.trajectories, strict=True)
    ]
    return {
        trial.object: residual if np.isfinite(residual) else np.inf
        for trial, residual in zip(tests, residuals, strict=True)
    }


def medians_of(errors: Errors) -> dict[str, dict[str, float]]:
    """Return the medians of errors over balls, by model and training drop, and over "both"."""
    found = {}
    for model, by_drop in errors.items():
        each = {drop: list(by_ball.values()) for drop, by_ball in by_drop.items()}
        each["both"] = [error for drop in by_drop for error in each[drop]]
        found[model] = {drop: float(np.median(values)) for drop, values in each.items()}
    return found


def _rate_test(law: Law, trial: Trial) -> tuple[float, float]:
    """Return the error at the horizon if the initial rate is fitted to the first samples, and what 1 m/s in it does.

    Heights under linear drag are a linear function of the initial rate.
    """
    resting, moving = (
        law.simulate(trial.times, {trial.object: (trial.states[0, 0], rate)})[trial.object].states[:, 0]
        for rate in (0.0, 1.0)
    )
    effect, missing = moving - resting, trial.states[:, 0] - resting
    early = slice(RATE_SAMPLES)
    rate = effect[early] @ missing[early] / (effect[early] @ effect[early])
    return abs(float(missing[HORIZON - 1] - rate * effect[HORIZON - 1])), float(effect[HORIZON - 1])


def _terms(law: Law) -> tuple[str, ...]:
    return tuple(law.terms.names[k] for k in np.flatnonzero(law.support[0]))


def _simple_models(medians: Medians, laws: Mapping[str, Mapping[str, Law]]) -> Verdict:
    """Compare models 1 to 3: linear drag helps much, quadratic drag makes little difference."""
    wrong = [
        f"model {model} has the terms {', '.join(_terms(law))} on drop {drop}"
        for model, wanted in MODEL_TERMS.items()
        for drop, law in laws[model].items()
        if _terms(law) != wanted or not shares_terms(law)
    ]
    gains = {drop: medians["1"][drop] - medians["2"][drop] for drop in OTHER_DROP}
    changes = {drop: abs(medians["3"][drop] - medians["2"][drop]) for drop in OTHER_DROP}
    holds = not wrong and all(gains[drop] > 0 and changes[drop] < SIMILAR * gains[drop] for drop in OTHER_DROP)
    text = (
        "The paper says that the error falls much from model 1 to model 2, and that models 2 and 3 predict equally "
        f"well. Medians after training on drop 1 and on drop 2: {_pair(medians['1'])} for constant acceleration, "
        f"{_pair(medians['2'])} with linear drag, {_pair(medians['3'])} with quadratic drag too."
    )
    return Verdict("reproduced" if holds else "differs", " ".join([text, *(f"But {each}." for each in wrong)]))


def _overfit_model(errors: Errors, medians: Medians) -> Verdict:
    """Compare model 4 with the others: a little worse than those with drag, better than the one without."""
    holds = all(
        max(medians["2"][drop], medians["3"][drop]) < medians["4"][drop] < medians["1"][drop] for drop in OTHER_DROP
    )
    golf = {drop: errors["4"][drop]["Golf Ball"] for drop in OTHER_DROP}
    text = (
        f"{PREDICTION.where}: {PREDICTION.printed} was printed. {PREDICTION.found} That error is {_pair(golf)}. "
        f"Computed for each ball, model 4 has medians of {_pair(medians['4'])}; "
        + (
            "the slight increase over models 2 and 3 that the paper states is there."
            if holds
            else "the paper's slight increase over models 2 and 3 is not there."
        )
    )
    return Verdict("reproduced with correction" if holds else "differs", text)


def _pair(by_drop: Mapping[str, float]) -> str:
    return f"{by_drop['1']:.2f} m and {by_drop['2']:.2f} m"


def _panels(errors: Errors) -> dict[str, dict[str, Mapping[str, float]]]:
    return {
        f"trained on drop {drop}, tested on drop {other}": {MODEL_NAMES[model]: errors[model][drop] for model in MODELS}
        for drop, other in OTHER_DROP.items()
    }


def _error_table(errors: Errors) -> Table:
    columns = {f"{model}, drop {drop}": errors[model][drop] for model in MODELS for drop in OTHER_DROP}
    frame = pd.DataFrame(columns).rename_axis("ball").reset_index()
    caption = (
        "Absolute error of the predicted height at sample 42 (m). The columns name the model and the drop that it "
        "learned from; it is tested on the other drop."
    )
    return Table("prediction-errors-by-ball", caption, frame, 3)


def _median_table(medians: Medians, laws: Mapping[str, Mapping[str, Law]]) -> Table:
    rows = [
        {
            "model": MODEL_NAMES[model],
            **{
                f"terms, drop {drop}": ", ".join(_terms(law)) if shares_terms(law) else "each ball its own"
                for drop, law in laws[model].items()
            },
            **{f"median, drop {drop} (m)": medians[model][drop] for drop in OTHER_DROP},
            "median, both (m)": medians[model]["both"],
        }
        for model in MODELS
    ]
    caption = (
        "The terms that each model has, and the median over the ten balls of its error at sample 42, by the drop that "
        "it learned from. The paper shows these errors in a figure only, without numbers."
    )
    return Table("prediction-error-medians", caption, pd.DataFrame(rows), 3)


_CAPTION = (
    "Error of the predicted height at sample 42, one mark for each ball and a line at the median. The paper calls it "
    "the error in landing time, and draws the golf ball's error of model 4 for every ball; here each ball has its own."
)


def _asked(drops: Trials) -> str:
    ends = [trial.times[HORIZON - 1] - trial.times[0] for trial in drops]
    return f"""
A law is worth something if it predicts what it has not seen. Four models of growing size learn from one drop of each
ball. Each then gets the first height and the estimated first speed of the same ball's *other* drop, and says how high
the ball is at the last sample of the shortest drop, sample {HORIZON}. The error is the distance from the height
measured there. Four models, ten balls and two drops make 80 forecasts.

- Model 1 is a constant acceleration, model 2 adds a drag that grows with the speed, model 3 a part that grows with its
  square. These three are group models: all balls have the same terms, and each has its own coefficients.
- Model 4 is overfit on purpose: each ball chooses its own terms up to third powers, with a low threshold.

The paper puts sample {HORIZON} at 2.8 s; it was taken {min(ends):.3f} s to {max(ends):.3f} s after the first. The paper
also calls the result the error in landing time, but it is an error of height, in metres.
"""


def _found(medians: Medians, rates: list[tuple[float, float]]) -> str:
    fitted, effect = np.median(rates, axis=0)
    return f"""
Over both drops the median errors of models 1 to 4 are {medians["1"]["both"]:.2f} m, {medians["2"]["both"]:.2f} m,
{medians["3"]["both"]:.2f} m and {medians["4"]["both"]:.2f} m. How much of this is due to the first speed, which is
estimated at the very end of the smoothing window? If it is wrong by 0.1 m/s, the height at sample {HORIZON} is wrong by
{0.1 * effect:.2f} m. With a first speed fitted to the first {RATE_SAMPLES} samples of the drop, about one second, the
median error of model 2 is {fitted:.2f} m instead of {medians["2"]["both"]:.2f} m.
"""
