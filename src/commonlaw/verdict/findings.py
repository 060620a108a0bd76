"""What is found out about a law by trials: verdict, fit, and forecasts."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np

from commonlaw.diagnostics import marked
from commonlaw.errors import CommonlawError
from commonlaw.forecast import Forecast, fitted
from commonlaw.forecast.initial_state import can_fit_initial_state
from commonlaw.law import Law
from commonlaw.law.alignment import has_bands, matched
from commonlaw.trials import Trials
from commonlaw.verdict.judge import judge, samples_before
from commonlaw.verdict.law_verdict import LawVerdict

T = TypeVar("T")

_NOT_JUDGED, _NOT_FITTED = "the forecast assessment failed", "the law has no fitted curves"
_NOT_CHECKED = "the law was not checked by forecasts"


@dataclass(frozen=True, eq=False)
class Findings:
    """A law and its assessment: all that the command line, a report and the app show of it.

    Parameters
    ----------
    law
        It has the reliable forecast horizon.
    trials, training
        All measurements, in the units of the law, and those that it was fitted to.
    verdict
        None if the law could not be assessed.
    fit
        Solutions of the law through all samples of the training data; None if there are none.
    forecast
        Of held-out trials, or if there are none of the training data with later samples, each from its first samples;
        None if there are no forecasts.
    start
        How many first samples the initial conditions are estimated from, None for the default of `Law.predict`.
    lacking
        Why there is no verdict or no forecast.
    """

    law: Law
    trials: Trials
    training: Trials
    verdict: LawVerdict | None = None
    fit: Forecast | None = None
    forecast: Forecast | None = None
    start: int | None = None
    lacking: tuple[str, ...] = ()

    @property
    def shown(self) -> Forecast | None:
        """What is shown first: the fit, or forecasts if there is none."""
        return self.fit or self.forecast

    @property
    def is_held_out(self) -> bool:
        """Whether the forecasts are of trials that the law was not learned from."""
        if self.forecast is None:
            return True
        first = self.forecast.trials[0]
        return (first.object, first.name) not in _names(self.training)

    @property
    def has_later_samples(self) -> bool:
        """Whether the forecasts are of trials that the law was learned from, with later samples of them."""
        if self.forecast is None or self.is_held_out:
            return False
        return sum(map(len, self.forecast.trials)) > sum(map(len, self.training))

    @property
    def sentences(self) -> tuple[str, ...]:
        """The verdict in words, or why there is none."""
        return self.lacking if self.verdict is None else self.verdict.sentences

    @property
    def is_exact(self) -> bool:
        """Whether the law leaves no more than errors of measurement, as far as it was judged."""
        return self.verdict is None or self.verdict.exact


def find(law: Law, trials: Trials, learned: Trials | None = None, bands: bool = True) -> Findings:
    """Assess a law and check it by forecasts; what fails is noted in `Findings.lacking`.

    The law was fitted to `learned`, by default all trials; `bands` says whether forecasts have bands. Raises
    `CommonlawError` if the trials do not have the variables of the law.
    """
    whole = matched(law, trials, observed=True)
    training = whole if learned is None or learned is trials else matched(law, learned, observed=True)
    lacking = list[str]()
    bands = bands and has_bands(law)
    fit = _tried(_NOT_FITTED, partial(fitted, law, training, bands), lacking) if law.order != 0 else None
    verdict = _tried(_NOT_JUDGED, partial(judge, law, whole, training), lacking)
    # Held-out trials, or if there are none of the objects of the law, the training data
    learned_from = _names(training)
    others = [each for each in whole if (each.object, each.name) not in learned_from]
    held_out = [each for each in others if each.object in law.objects]
    checked = whole.with_trials(held_out or [each for each in whole if (each.object, each.name) in learned_from])
    start = samples_before(min(map(len, checked)), law.order) if can_fit_initial_state(law) or law.observation else None
    checking = partial(law.predict, checked, return_std=bands, start=start)
    forecast = _tried(_NOT_CHECKED, checking, lacking)
    if verdict is not None and verdict.usable is not None:
        horizon = verdict.horizon if verdict.usable else 0.0
        law = replace(law, provenance=law.provenance.judged(horizon, verdict.longest))
    return Findings(law, whole, training, verdict, fit, forecast, start, tuple(lacking))


def _tried(failure: str, step: Callable[[], T], lacking: list[str]) -> T | None:
    """Return what a step gives; if it cannot, None, and add why."""
    try:
        return step()
    except CommonlawError as error:
        lacking.append(f"{failure}: {error.sentence(marked)}")
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        lacking.append(f"{failure}: {type(error).__name__}: {error}")
    return None


def _names(trials: Trials) -> set[tuple[str, str]]:
    return {(each.object, each.name) for each in trials}
