"""What is found out about a law by the objects of a stream: errors of all, findings about few that stand for all."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import pandas as pd

from commonlaw.forecast.many_objects import WITHIN, forecast_parts, law_of
from commonlaw.law import Law
from commonlaw.runtime.cluster import done_in_parts
from commonlaw.runtime.progress import ProgressCallback, Stage, part
from commonlaw.spacing import evenly_spaced
from commonlaw.text import counted
from commonlaw.trials import Trials, TrialStream
from commonlaw.trials.stream import as_one
from commonlaw.verdict.findings import Findings, find

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
