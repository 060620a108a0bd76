"""What is found out about a law by trials, or by the objects of a stream: verdict, fit, and forecasts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
import pandas as pd

from commonlaw.errors import CommonlawError
from commonlaw.forecast import Forecast, fitted
from commonlaw.forecast.initial_state import can_fit_initial_state
from commonlaw.forecast.many_objects import WITHIN, forecast_parts, law_of
from commonlaw.law import Law
from commonlaw.law.alignment import matched
from commonlaw.runtime.cluster import done_in_parts
from commonlaw.runtime.progress import ProgressCallback, Stage, part
from commonlaw.spacing import evenly_spaced
from commonlaw.text import counted
from commonlaw.trials import Trials, TrialStream
from commonlaw.trials.stream import as_one
from commonlaw.verdict.judge import judge, samples_before
from commonlaw.verdict.law_verdict import LawVerdict

T = TypeVar("T")

_NOT_JUDGED, _NOT_FITTED = "the law was not judged", "the law has no fitted curves"
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
    whole = matched(law, trials)
    training = whole if learned is None or learned is trials else matched(law, learned)
    lacking = list[str]()
    bands = bands and law.uncertainty.has_std
    fit = _tried(_NOT_FITTED, partial(fitted, law, training, bands), lacking) if law.order != 0 else None
    verdict = _tried(_NOT_JUDGED, partial(judge, law, whole, training), lacking)
    # Held-out trials, or if there are none of the objects of the law, the training data
    learned_from = _names(training)
    others = [each for each in whole if (each.object, each.name) not in learned_from]
    held_out = [each for each in others if each.object in law.objects]
    checked = whole.with_trials(held_out or [each for each in whole if (each.object, each.name) in learned_from])
    start = samples_before(min(map(len, checked)), law.order) if can_fit_initial_state(law) else None
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
        lacking.append(f"{failure}: {error}")
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        lacking.append(f"{failure}: {type(error).__name__}: {error}")
    return None


def _names(trials: Trials) -> set[tuple[str, str]]:
    return {(each.object, each.name) for each in trials}


_MAX_OBJECTS = 24
"""Objects that stand for all, evenly by rank of their errors: figures and tables of so many can be read."""

_FORECAST = 0.9
"""Share of the time after which all are forecast. It is only shown."""


@dataclass(frozen=True, eq=False)
class ManyFindings:
    """A law with the forecast errors of a stream, and findings about a few of its objects."""

    law: Law
    errors: pd.DataFrame
    few: Findings

    @cached_property
    def relative(self) -> pd.Series:
        """Root mean square error of each object's forecasts, in units of the states' spread, the best first."""
        return _relative(self.errors)

    @property
    def score(self) -> float:
        """The mean over states of R^2 of all forecasts, see `Forecast.score`."""
        squares = self.errors[["rms error", "spread"]].pow(2).mul(self.errors["samples"], axis=0)
        missed, varied = (squares[name].groupby(self.errors["state"]).sum() for name in squares)
        return float((1 - missed[varied > 0] / varied[varied > 0]).mean())

    @property
    def coverage(self) -> float:
        """The share of the measurements that are in their 95 % bands, of those that have some; NaN if none has."""
        known = self.errors.dropna(subset=WITHIN)
        return float(np.average(known[WITHIN], weights=known["samples"])) if known["samples"].any() else np.nan

    @property
    def trials(self) -> int:
        """How many trials were forecast."""
        return len(self.errors) // self.errors["state"].nunique()

    @property
    def forecast_of(self) -> str:
        """What was forecast, in words."""
        kind = "held-out trial" if self.few.forecast and self.few.is_held_out else "trial"
        return f"{counted(self.trials, kind)} of {counted(len(self.relative), 'object')}"

    @property
    def diverged(self) -> int:
        """How many forecasts run away."""
        return int(np.isinf(self.errors.groupby(self.errors.columns[:2].tolist())["rms error"].max()).sum())


def find_by_stream(
    law: Law, stream: TrialStream, progress: ProgressCallback, learned: TrialStream | None = None
) -> ManyFindings:
    """Forecast all trials of a stream, part by part, and assess the law by a few objects that represent all.

    The law was fitted to `learned`: other trials, or the first samples of these; the same by default. Raises
    `CommonlawError` if law and trials do not match.
    """
    frames = forecast_parts(law, stream, part(progress, 0.0, _FORECAST))
    errors = pd.concat(frames, ignore_index=True)
    ranked = _relative(errors).index
    rows = evenly_spaced(len(ranked), _MAX_OBJECTS)
    names = {*ranked[rows].astype(str)}
    pieces = zip(stream.parts or (stream,), frames, strict=True)
    parts = [each for each, frame in pieces if names & {*frame.iloc[:, 0]}]
    few, training = as_one(_read(names, parts, part(progress, _FORECAST, 1.0))), None
    if learned is not None:
        own = _read(names, learned.parts or (learned,), part(progress, _FORECAST, 1.0))
        training = as_one(own) if own else Trials((next(iter(learned)),), learned.schema)
        there = {(each.object, each.name) for each in few}
        others = [each for each in training if (each.object, each.name) not in there]
        few = as_one([few, training.with_trials(others)]) if others else few
    progress(Stage(f"judging the law by {len(rows)} objects", 1.0))
    found = find(law_of(law, few.objects), few, training)
    law = replace(law, provenance=found.law.provenance)
    return ManyFindings(law, errors, found)


def _read(names: set[str], parts: Sequence[TrialStream], progress: ProgressCallback) -> list[Trials]:
    """Return the trials of some objects in parts that have some."""
    found = done_in_parts(partial(_some, names), parts, "reading objects that stand for all", progress)
    return [each for each in found if each is not None]


def _some(names: set[str], part: TrialStream) -> Trials | None:
    trials = part.read()
    chosen = [each for each in trials if each.object in names]
    return trials.with_trials(chosen) if chosen else None


def _relative(errors: pd.DataFrame) -> pd.Series:
    weights = errors["samples"]
    spread = (errors["spread"] ** 2 * weights).groupby(errors["state"]).sum() / weights.groupby(errors["state"]).sum()
    squared = errors["rms error"] ** 2 / errors["state"].map(spread.replace(0.0, np.nan))
    relative: pd.Series = squared.groupby(errors.iloc[:, 0], sort=False).mean().pow(0.5)
    return relative.sort_values(kind="stable")
