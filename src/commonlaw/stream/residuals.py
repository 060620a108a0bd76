"""How well a law fits the trials of a stream, part by part: sums over residuals, and a row for each object."""

from dataclasses import dataclass
from functools import partial, reduce
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.discrepancy.residual_tests import (
    AbstractPatterns,
    Pattern,
    Residuals,
    StateSums,
    correlation_of_neighbours,
    neighbours,
    noise_of,
    noise_squares,
    patterns_of,
    refuse_discrete_time,
    size_over_noise,
    untested,
)
from commonlaw.errors import CommonlawError
from commonlaw.law import Law
from commonlaw.runtime.cluster import done_in_parts, on_cluster
from commonlaw.runtime.progress import ProgressCallback, on_terminal, part, unannounced
from commonlaw.stream.forecasts import laws_of_parts
from commonlaw.text import counted
from commonlaw.trials import TrialStream

if TYPE_CHECKING:
    import pandas as pd
    from distributed import Client


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

    objects: "pd.DataFrame"
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
    import pandas as pd
    from scipy.stats import false_discovery_control

    if not isinstance(stream, TrialStream):
        raise CommonlawError("residuals-not-a-stream", type=type(stream).__name__)
    refuse_discrete_time(law)
    parts, progress = stream.parts or (stream,), progress or on_terminal()
    with on_cluster(client):
        laws, noise = laws_of_parts(law, parts, part(progress, 0.0, 0.1)), law.uncertainty.noise
        if noise is None:
            noise = noise_of(done_in_parts(_noise, parts, "estimating noise", part(progress, 0.1, 0.2)))
        pieces = list(zip(laws, parts, strict=True))
        found = done_in_parts(partial(_of_part, noise), pieces, "fitting trajectories", part(progress, 0.2, 1.0))
    name = law.schema.object
    rows = pd.concat([frame for frame, _ in found], ignore_index=True)
    summed = rows.groupby([name, "state"], sort=False)
    rows = summed[[*_SUMS, "starts"]].sum().join(summed["coefficients"].first()).reset_index()
    rows["spent"] = rows["starts"] + rows["coefficients"]
    spent = rows.groupby("state", sort=False)["spent"].sum()
    sums = [reduce(_added, own) for own in zip(*(each for _, each in found), strict=True)]
    patterns = patterns_of(
        law.schema.states, sums, law.schema.time, [float(spent.get(state, 0.0)) for state in law.schema.states]
    )
    rows = rows[rows["samples"] > 0]
    tested = [size_over_noise(*each) for each in rows[["samples", "squares", "spent"]].itertuples(index=False)]
    size, p_value = np.array(tested).T
    objects = rows[[name, "state", "samples"]].assign(
        **{
            "samples": rows["samples"].astype(int),
            "RMS over noise": size,
            "p-value": p_value,
            "adjusted": false_discovery_control(p_value, method="by"),
            "autocorrelation": correlation_of_neighbours(*(rows[each].to_numpy() for each in _SUMS)),
        }
    )
    return StreamResiduals(objects.reset_index(drop=True), patterns)


def _noise(stream: TrialStream) -> tuple[int, Floats]:
    return noise_squares(stream.read())


def _added(first: StateSums | None, second: StateSums | None) -> StateSums | None:
    return first + second if first and second else first or second


def _of_part(noise: Floats, piece: tuple[Law, TrialStream]) -> "tuple[pd.DataFrame, list[StateSums | None]]":
    """Return sums of each object's residuals, and over all those of each state."""
    law, trials = piece[0], piece[1].read()
    with unannounced():
        found, spent = untested(law, trials, noise)
    sums = [StateSums.of(j, found.standardized, found.columns, name) for j, name in enumerate(law.schema.states)]
    return _rows(law, found, spent), sums


def _rows(law: Law, found: Residuals, spent: Floats) -> "pd.DataFrame":
    """Return a row for each object and state."""
    import pandas as pd

    rows, series = list[dict[str, object]](), dict[str, list[Floats]]()
    for trial, own in zip(found.trials, found.standardized, strict=True):
        series.setdefault(trial.object, []).append(own)
    orders = np.broadcast_to(np.array(law.order), len(law.schema.states)).tolist()
    for (name, trials), taken in zip(series.items(), spent.tolist(), strict=True):
        for j, state in enumerate(law.schema.states):
            values = np.concatenate([trial[:, j] for trial in trials])
            seen = values[np.isfinite(values)]
            pairs = sum((neighbours(trial[:, j]) for trial in trials), np.zeros(4))
            starts = orders[j] * len(trials)
            row = dict(zip(_SUMS, [len(seen), seen.sum(), seen @ seen, *pairs[:3]], strict=True))
            rows.append(
                {law.schema.object: name, "state": state, **row, "starts": starts, "coefficients": taken[j] - starts}
            )
    return pd.DataFrame(rows)
