"""What is found out about a law by the objects of a stream: errors of all, findings about few that stand for all."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from commonlaw.cluster import done_in_parts
from commonlaw.forecast.many_objects import WITHIN, forecast_parts, law_of
from commonlaw.law import Law
from commonlaw.progress import ProgressCallback, Stage, part
from commonlaw.spacing import evenly_spaced
from commonlaw.trials import Trials, TrialStream
from commonlaw.verdict.findings import Findings, find

_FEW = 24
"""Objects that stand for all, evenly by rank of their errors: figures and tables of so many can be read."""

_FORECAST = 0.9
"""Share of the time after which all are forecast. It is only shown."""


@dataclass(frozen=True, eq=False)
class ManyFindings:
    """A law with what forecasts of all trials of a stream are off, and findings about few objects.

    Parameters
    ----------
    law
        Of all objects.
    errors
        A row for each trial and state, see `commonlaw.forecast_stream`.
    files
        How many parts the stream has.
    few
        Findings about objects that stand for all.
    """

    law: Law
    errors: pd.DataFrame
    files: int
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
    def diverged(self) -> int:
        """How many forecasts run away."""
        return int(np.isinf(self.errors.groupby(self.errors.columns[:2].tolist())["rms error"].max()).sum())


def find_by_stream(law: Law, stream: TrialStream, progress: ProgressCallback) -> ManyFindings:
    """Forecast all trials of a stream, part by part, and judge the law by few objects that stand for all.

    Raises
    ------
    CommonlawError
        If the law and the trials do not go together.
    """
    frames = forecast_parts(law, stream, part(progress, 0.0, _FORECAST))
    errors = pd.concat(frames, ignore_index=True)
    ranked = _relative(errors).index
    rows = evenly_spaced(len(ranked), _FEW)
    names = {*ranked[rows].astype(str)}
    wanted = [
        (each, names & {*frame.iloc[:, 0]}) for each, frame in zip(stream.parts or (stream,), frames, strict=True)
    ]
    few = _joined(_read(wanted, part(progress, _FORECAST, 1.0)))
    progress(Stage(f"judging the law by {len(rows)} objects", 1.0))
    return ManyFindings(law, errors, len(frames), find(law_of(law, few.objects), few))


def _read(wanted: Sequence[tuple[TrialStream, set[str]]], progress: ProgressCallback) -> Iterator[Trials]:
    """Yield the trials of some objects of each part, in order of the parts."""
    pieces = [each for each in wanted if each[1]]
    found = dict(done_in_parts(_some, pieces, "reading objects that stand for all", progress))
    return (found[i] for i in range(len(pieces)))


def _some(piece: tuple[TrialStream, set[str]]) -> Trials:
    stream, names = piece
    return stream.read().select(object=sorted(names))


def _joined(parts: Iterator[Trials]) -> Trials:
    first, *others = parts
    properties = {name: own for each in (first, *others) for name, own in each.properties.items()}
    return Trials(tuple(trial for each in (first, *others) for trial in each), first.schema, properties)


def _relative(errors: pd.DataFrame) -> pd.Series:
    weights = errors["samples"]
    spread = (errors["spread"] ** 2 * weights).groupby(errors["state"]).sum() / weights.groupby(errors["state"]).sum()
    squared = errors["rms error"] ** 2 / errors["state"].map(spread.replace(0.0, np.nan))
    relative: pd.Series = squared.groupby(errors.iloc[:, 0], sort=False).mean().pow(0.5)
    return relative.sort_values(kind="stable")
