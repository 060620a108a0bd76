"""Forecasts that check a law: of trials held out, or if there is none, of those that it was learned from."""

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.law import Forecast, Law
from commonlaw.trials import Trials
from commonlaw.verdict.segments import samples_before


def checked_forecast(
    law: Law, trials: Trials, training: Trials, bands: bool
) -> tuple[Forecast | None, tuple[str, ...]]:
    """Return forecasts by a law, with bands if wanted and known, and words on what they lack.

    They are of the trials that the law was not learned from, or if there is none whose object it knows, of the others,
    later samples included.
    """
    learned_from = _names(training)
    others = [each for each in trials if (each.object, each.name) not in learned_from]
    held_out = [each for each in others if each.object in law.objects]
    checked = held_out or [each for each in trials if (each.object, each.name) in learned_from]
    start = checked_start(law, trials)
    try:
        return law.predict(trials.with_trials(checked), return_std=bands and law.has_std, start=start), ()
    except (CommonlawError, ArithmeticError, np.linalg.LinAlgError) as error:
        return None, (f"the law was not checked by forecasts, nor drawn: {error}",)


def checked_start(law: Law, trials: Trials) -> int | None:
    """Return how many first samples tell where these forecasts start, None for those that `Law.predict` takes.

    A law of second order with a model error follows these samples: they are to be few, as they are no forecasts.
    """
    follows = law.order == 2 and law.uncertainty.error_model.of_law
    return samples_before(min(map(len, trials)), law.order) if follows else None


def is_of_training(forecast: Forecast, training: Trials) -> bool:
    """Whether forecasts are of trials that a law was learned from."""
    first = forecast.trials[0]
    return (first.object, first.name) in _names(training)


def _names(trials: Trials) -> set[tuple[str, str]]:
    return {(each.object, each.name) for each in trials}
