"""Streams of trials that exceed memory: forecasts and residuals, part by part, by workers or here."""

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from commonlaw.array_types import Floats, evenly_spaced
from commonlaw.discrepancy.residual_tests import (
    AbstractPatterns,
    Pattern,
    Residuals,
    StateSums,
    correlation_of_neighbours,
    neighbours,
    patterns_of,
    size_over_noise,
)
from commonlaw.discrepancy.residuals import fitted_parameters, noise_of, noise_squares, refuse_discrete_time, untested
from commonlaw.errors import CommonlawError
from commonlaw.forecast.forecast import Forecast, variation
from commonlaw.forecast.prediction import predict
from commonlaw.law import Law, select_objects
from commonlaw.law.population import is_typical
from commonlaw.runtime.arguments import check_types
from commonlaw.runtime.cluster import done_in_parts, on_cluster
from commonlaw.runtime.files import make_folder, write_whole
from commonlaw.runtime.forking import cached_property
from commonlaw.runtime.progress import ProgressCallback, Stage, on_terminal, part, unannounced
from commonlaw.text import counted
from commonlaw.trials import Trials, TrialStream
from commonlaw.trials.stream import as_one, objects_of_parts
from commonlaw.verdict import Findings, find

if TYPE_CHECKING:
    from distributed import Client


WITHIN = "within 95 % band"
"""Column with the share of a state's measurements in the bands of its forecast."""


def forecast_stream(
    law: Law,
    stream: TrialStream,
    *,
    folder: str | os.PathLike[str] | None = None,
    start: int | None = None,
    from_time: float | None = None,
    client: "Client | None" = None,
    progress: ProgressCallback = lambda _: None,
) -> pd.DataFrame:
    """Forecast each trial of a stream from its own initial state, file by file, and return the errors.

    Raises `CommonlawError` if law and trials do not match, see `Law.predict`, or no trial can be forecast.

    Parameters
    ----------
    law
        It must have the objects of the stream, or relations that give their coefficients.
    stream
        What to forecast.
    folder
        Where the forecasts of each file are written, in the columns of `Forecast.to_frame`, as
        ``forecast-000001.parquet`` and so on; on a cluster by the workers.
    start, from_time
        See `Law.predict`. Trials without samples on both sides of that time are left out.
    client
        A dask client whose workers compute; default: this process.
    progress
        Takes the text of each step.

    Returns
    -------
    errors
        A row for each trial and state: the columns of `Forecast.errors`, the number of compared samples, the standard
        deviation of the measurements (``spread``), and the share of them in 95 % bands, if there are any.
    """
    _refuse_trials("forecast-not-a-stream", stream)
    check_types(forecast_stream, locals())
    with on_cluster(client):
        parts = forecast_parts(law, stream, progress, folder, start=start, from_time=from_time)
    result = [frame for frame in parts if len(frame)]
    if not result:
        raise CommonlawError("forecast-no-trial-from", from_time=from_time)
    return pd.concat(result, ignore_index=True)


def _refuse_trials(code: str, stream: object) -> None:
    """Refuse what is no stream, with the verb for trials in memory that a message names."""
    if not isinstance(stream, TrialStream):
        raise CommonlawError(code, type=type(stream).__name__)


def forecast_parts(
    law: Law, stream: TrialStream, progress: ProgressCallback, folder: str | os.PathLike[str] | None = None, **how: Any
) -> list[pd.DataFrame]:
    """Return the errors of `forecast_stream` for each part of a stream; `how` are arguments of `Law.predict`."""
    parts = stream.files
    laws = laws_of_parts(law, parts, part(progress, 0.0, 0.1))
    where = None if folder is None else Path(folder).absolute()
    files = [where and where / f"forecast-{i + 1:06}.parquet" for i in range(len(parts))]
    pieces = list(zip(laws, parts, files, strict=True))
    return done_in_parts(partial(_errors, how), pieces, "forecasting", part(progress, 0.1, 1.0))


def laws_of_parts(law: Law, parts: Sequence[TrialStream], progress: ProgressCallback) -> list[Law]:
    """Return what each part takes of a law, which is small: its objects, nothing of all together."""
    if len(law.objects) == 1:
        return [law] * len(parts)
    light = replace(law, uncertainty=replace(law.uncertainty, shared_factor=None))
    return [law_of(light, names) for names in objects_of_parts(parts, progress)]


def law_of(law: Law, names: Collection[str]) -> Law:
    """Return a law of some objects: its own, and others by relations or means, if there are any."""
    if len(law.objects) == 1:
        return law
    known = {*law.objects}
    unseen = [name for name in names if name not in known]
    if unseen and law.uncertainty.explanation is None:
        raise CommonlawError("object-unknown", object=unseen[0])
    some = law.objects[:2] if unseen else ()  # A law of a single object would be taken for that of all
    return select_objects(law, list(dict.fromkeys([*(name for name in names if name in known), *some])))


def _errors(how: dict[str, Any], piece: tuple[Law, TrialStream, Path | None]) -> pd.DataFrame:
    """Forecast the trials of a part by its law; return their errors, and write the forecasts if there is a file."""
    law, stream, file = piece
    trials, from_time = stream.read(), how.get("from_time")
    # The typical coefficients are not known from what is sent of a law
    if len(law.objects) > 1 and law.uncertainty.explanation is not None:
        for name in trials.objects:
            if is_typical(law, name, trials):
                wanted = [*law.uncertainty.explanation.properties]
                raise CommonlawError("object-without-properties", object=name, properties=wanted)
    if from_time is not None and not any(trial.times[0] < from_time <= trial.times[-1] for trial in trials):
        return pd.DataFrame()
    with unannounced():
        forecast = predict(law, trials, return_std=law.uncertainty.has_std, **how)
    if file is not None:
        content = BytesIO()
        forecast.to_frame().to_parquet(content, index=False)
        make_folder(file.parent)
        write_whole(file, content.getvalue())
    known = forecast.std is not None and forecast.noise is not None
    bands = forecast.bands(measured=True) if known else [None] * len(forecast.trials)
    compared = [_compared(forecast, i, band) for i, band in enumerate(bands)]
    errors, schema = forecast.errors(), forecast.trials.schema
    measured = [schema.states.index(name) for name in schema.measured]
    samples, spread, within = np.array(compared).transpose(1, 0, 2)[:, :, measured].reshape(3, -1)
    return errors.assign(**{"samples": samples.astype(int), "spread": spread, WITHIN: within})


def _compared(forecast: Forecast, index: int, band: tuple[Floats, Floats] | None) -> tuple[Any, Any, Any]:
    """Return of each state of a trial how many samples are compared, their standard deviation, the share in bands."""
    ahead = forecast.ahead[index]
    states = forecast.trials[index].states[ahead]
    counts, squares = variation(states)
    share = np.full(states.shape[1], np.nan)
    if band is not None:
        low, high = (end[ahead] for end in band)
        share = ((low <= states) & (states <= high)).sum(axis=0) / np.maximum(counts, 1)
    return counts, np.sqrt(squares / np.maximum(counts, 1)), share


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
    frames = forecast_parts(law, stream, part(progress, 0.0, 0.9))
    errors = pd.concat(frames, ignore_index=True)
    ranked = _relative(errors).index
    # Figures and tables of so many objects can be read
    rows = evenly_spaced(len(ranked), 24)
    names = {*ranked[rows].astype(str)}
    pieces = zip(stream.files, frames, strict=True)
    parts = [piece for piece, frame in pieces if names & {*frame.iloc[:, 0]}]
    few, training = as_one(_read(names, parts, part(progress, 0.9, 1.0))), None
    if learned is not None:
        learned_parts = _read(names, learned.files, part(progress, 0.9, 1.0))
        training = as_one(learned_parts) if learned_parts else Trials((next(iter(learned)),), learned.schema)
        there = {(trial.object, trial.name) for trial in few}
        others = [trial for trial in training if (trial.object, trial.name) not in there]
        few = as_one([few, training.with_trials(others)]) if others else few
    progress(Stage(f"assessing forecasts of {len(rows)} objects", 1.0))
    findings = find(law_of(law, few.objects), few, training)
    law = replace(law, provenance=findings.law.provenance)
    return ManyFindings(law, errors, findings)


def _read(names: set[str], parts: Sequence[TrialStream], progress: ProgressCallback) -> list[Trials]:
    """Return the trials of some objects in parts that have some."""
    pieces = done_in_parts(partial(_some, names), parts, "reading representative objects", progress)
    return [piece for piece in pieces if piece is not None]


def _some(names: set[str], part: TrialStream) -> Trials | None:
    trials = part.read()
    chosen = [trial for trial in trials if trial.object in names]
    return trials.with_trials(chosen) if chosen else None


def _relative(errors: pd.DataFrame) -> pd.Series:
    weights = errors["samples"]
    spread = (errors["spread"] ** 2 * weights).groupby(errors["state"]).sum() / weights.groupby(errors["state"]).sum()
    squared = errors["rms error"] ** 2 / errors["state"].map(spread.replace(0.0, np.nan))
    relative: pd.Series = squared.groupby(errors.iloc[:, 0], sort=False).mean().pow(0.5)
    return relative.sort_values(kind="stable")


_SUMS = ["samples", "total", "squares", "pairs", "products", "sums"]
"""Columns that are added where an object has trials in several parts."""


@dataclass(frozen=True, eq=False)
class StreamResiduals(AbstractPatterns):
    """Tests of the residuals of a law in a stream of trials; prints as sentences.

    Parameters
    ----------
    objects
        A row for each object and state: ``samples``, ``RMS over noise`` of residuals (root mean square) with its
        p-value, the p-value ``adjusted`` for all rows, and the ``autocorrelation``.
    patterns
        Tests of the residuals of all objects together.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(noise=0.05)
    >>> stream = cl.TrialStream(drops.schema, lambda: drops)
    >>> print(cl.check_stream(cl.fit("x'' = -g - c v", drops), stream))
    The residuals look like white noise: no pattern is significant.
    """

    objects: pd.DataFrame
    patterns: tuple[Pattern, ...]

    def __repr__(self) -> str:
        among = f"{len(self.significant)} of {len(self.patterns)} patterns are significant"
        return f"<Residuals of {counted(self.objects.iloc[:, 0].nunique(), 'object')}: {among}>"


def check_stream(
    law: Law, stream: TrialStream, *, client: "Client | None" = None, progress: ProgressCallback | None = None
) -> StreamResiduals:
    """Test how well a law fits the trials of a stream, file by file, and which patterns its residuals have.

    Patterns are those of `Law.residuals`, from sums over files. Of more than 5000 residuals the scatter is ranked by
    cells of sizes (16 for each factor of two), and normality is tested by skewness and kurtosis (Jarque and Bera 1987).

    Raises `CommonlawError` if the law is of discrete time, or does not match the trials.

    Parameters
    ----------
    law
        It must have the objects of the stream, or relations that give their coefficients.
    stream
        What was measured.
    client
        A dask client whose workers compute; default: this process.
    progress
        Takes the text of each step. Default: written to the terminal after two seconds.
    """
    from scipy.stats import false_discovery_control

    _refuse_trials("residuals-not-a-stream", stream)
    check_types(check_stream, locals())
    refuse_discrete_time(law)
    parts, progress = stream.files, progress or on_terminal()
    with on_cluster(client):
        laws, noise = laws_of_parts(law, parts, part(progress, 0.0, 0.1)), law.uncertainty.noise
        if noise is None:
            noise = noise_of(done_in_parts(_noise, parts, "estimating noise", part(progress, 0.1, 0.2)))
        pieces = list(zip(laws, parts, strict=True))
        results = done_in_parts(partial(_of_part, noise), pieces, "fitting trajectories", part(progress, 0.2, 1.0))
    name = law.schema.object
    rows = pd.concat([frame for frame, _ in results], ignore_index=True)
    summed = rows.groupby([name, "state"], sort=False)
    rows = summed[[*_SUMS, "starts"]].sum().reset_index()
    fitted, totals = rows["starts"] + rows[name].map(fitted_parameters(law)).fillna(0.0), rows.groupby(name)["samples"]
    rows["spent"] = fitted * rows["samples"] / totals.transform("sum").clip(lower=1)
    spent = rows.groupby("state", sort=False)["spent"].sum()
    by_state = zip(*(part_sums for _, part_sums in results), strict=True)
    sums = [reduce(lambda total, more: total + more if total and more else total or more, sums) for sums in by_state]
    patterns = patterns_of(
        law.schema.states, sums, law.schema.time, [float(spent.get(state, 0.0)) for state in law.schema.states]
    )
    rows = rows[rows["samples"] > 0]
    tested = [size_over_noise(*row) for row in rows[["samples", "squares", "spent"]].itertuples(index=False)]
    size, p_value = np.array(tested).T
    objects = rows[[name, "state", "samples"]].assign(
        **{
            "samples": rows["samples"].astype(int),
            "RMS over noise": size,
            "p-value": p_value,
            "adjusted": false_discovery_control(p_value, method="by"),
            "autocorrelation": correlation_of_neighbours(*(rows[column].to_numpy() for column in _SUMS)),
        }
    )
    return StreamResiduals(objects.reset_index(drop=True), patterns)


def _noise(stream: TrialStream) -> tuple[int, Floats]:
    return noise_squares(stream.read())


def _of_part(noise: Floats, piece: tuple[Law, TrialStream]) -> tuple[pd.DataFrame, list[StateSums | None]]:
    """Return sums of each object's residuals, and over all those of each state."""
    law, trials = piece[0], piece[1].read()
    with unannounced():
        residuals, starts = untested(law, trials, noise)
    sums = [
        StateSums.of(j, residuals.standardized, residuals.columns, name) for j, name in enumerate(law.schema.states)
    ]
    return _rows(law, residuals, starts), sums


def _rows(law: Law, found: Residuals, starts: Mapping[str, int]) -> pd.DataFrame:
    """Return a row for each object and state."""
    rows, series = list[dict[str, object]](), dict[str, list[Floats]]()
    for trial, residuals in zip(found.trials, found.standardized, strict=True):
        series.setdefault(trial.object, []).append(residuals)
    for name, trials in series.items():
        for j, state in enumerate(law.schema.states):
            values = np.concatenate([trial[:, j] for trial in trials])
            seen = values[np.isfinite(values)]
            pairs = sum((neighbours(trial[:, j]) for trial in trials), np.zeros(4))
            row = dict(zip(_SUMS, [len(seen), seen.sum(), seen @ seen, *pairs[:3]], strict=True))
            rows.append({law.schema.object: name, "state": state, **row, "starts": starts[name]})
    return pd.DataFrame(rows)
