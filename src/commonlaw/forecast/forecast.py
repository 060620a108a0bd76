"""Forecasts of trials and what was measured: what `Law.predict` gives."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.diagnostics import Outcome
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.integration import Trajectory
from commonlaw.law.quantiles import mixture_interval
from commonlaw.law.uncertainty import IntervalInflation
from commonlaw.likelihood import WHITE_NOISE, ErrorModel
from commonlaw.runtime.arguments import checks_types
from commonlaw.runtime.notebooks import ShownInNotebooks
from commonlaw.text import counted
from commonlaw.trials import Trial, Trials
from commonlaw.trials.transformations import as_measured, natural

if TYPE_CHECKING:
    import pandas as pd

Metric = Literal["r2", "rmse", "mae"] | Callable[[Floats, Floats], float]


def _r_squared(measured: Floats, forecast: Floats) -> float:
    varied = float(np.sum((measured - measured.mean()) ** 2))
    return 1 - float(np.sum((measured - forecast) ** 2)) / varied if varied else np.nan


_METRICS: dict[str, Callable[[Floats, Floats], float]] = {
    "r2": _r_squared,
    "rmse": lambda measured, forecast: float(np.sqrt(np.mean((measured - forecast) ** 2))),
    "mae": lambda measured, forecast: float(np.mean(np.abs(measured - forecast))),
}


class Part(NamedTuple):
    """The forecast by one of the laws of an average, with that law's probability and equations.

    `weights` are its weights in each trial, zero where it diverges.
    """

    probability: float
    forecast: "Forecast"
    weights: tuple[float, ...] = ()
    equations: str = ""


@dataclass(frozen=True, eq=False)
class Forecast(ShownInNotebooks):
    """Each trial forecast from its own initial state.

    Parameters
    ----------
    trials, trajectories
        The measurements, and a trajectory for each trial at its sample times.
    std
        Standard deviations of the measured states, or quantities, by the errors of coefficients and initial states, of
        each trial of shape (n, states), without rates; None if they were not asked for.
    noise
        Standard deviation of the measurement noise of each state, shape (states,), for samples without one of their
        own; None if it is not known.
    from_time
        When forecasts begin, if that is not at the first sample. Measurements before it determined the initial states,
        and are not in tables, errors and scores.
    error_model
        Errors of measurements besides that noise.
    at_more_times
        Makes the same forecasts at more times, see `smooth`; None if they cannot be made again.
    followed
        The same forecast with log-scaled states by their logarithms, if there are any; its errors are symmetric.
    degrees_of_freedom
        Of the estimate of each state's noise, shape (states,), see `Uncertainty`; None if the noise was given.
    parts
        What it is the average of, that of the law itself first.
    horizons
        How far ahead each sample of each trial is of those that determined its initial state, zero before, shape (n,).
    interval_inflation
        Factor by which intervals are wider that far ahead, see `Uncertainty`.
    latent
        States and rates of a law with observation equations, for each trial of shape (n, states + rates); empty for
        other laws, whose trajectories hold them.
    wanted
        Times that were asked for, shape (m,).
    """

    trials: Trials
    trajectories: tuple[Trajectory, ...]
    std: tuple[Floats, ...] | None = None
    noise: Floats | None = None
    from_time: float | None = None
    error_model: ErrorModel = WHITE_NOISE
    at_more_times: Callable[[Sequence[Floats]], "Forecast"] | None = None
    followed: "Forecast | None" = None
    degrees_of_freedom: Floats | None = None
    parts: tuple[Part, ...] = ()
    horizons: tuple[Floats, ...] = ()
    interval_inflation: IntervalInflation | None = None
    latent: tuple[Floats, ...] = ()
    wanted: Floats = field(default_factory=lambda: np.empty(0))

    def __repr__(self) -> str:
        lost = f", {len(self.outcomes)} diverged" if self.outcomes else ""
        return f"<{self.title.capitalize()} of {counted(len(self.trials), 'trial')}{lost}>"

    @property
    def outcomes(self) -> tuple[Outcome, ...]:
        """The divergences of these forecasts."""
        return tuple(trajectory.outcome for trajectory in self.trajectories if trajectory.outcome is not None)

    @property
    def solutions(self) -> tuple[Floats, ...]:
        """States and rates of each trial, as they are and not by their logarithms, shape (n, D)."""
        return self.latent or tuple(trajectory.states for trajectory in self.trajectories)

    @property
    def is_fit(self) -> bool:
        """Whether the initial conditions are estimated from all samples: these are fitted curves, and no forecasts."""
        pairs = zip(self.trials, self.horizons, strict=True)
        return bool(self.horizons) and not any(ahead[_measured(trial)].any() for trial, ahead in pairs)

    @property
    def title(self) -> str:
        """What the curves are: a fit, or a forecast from so many first samples."""
        if self.is_fit:
            return "fit"
        if self.from_time is not None:
            unit = self.trials.schema.units.get(self.trials.schema.time, "")
            return f"forecast from {self.trials.schema.time} = {self.from_time:g} {unit}".rstrip()
        if not self.horizons:
            return "forecast"
        pairs = zip(self.trials, self.horizons, strict=True)
        counts = {int(np.sum(ahead[_measured(trial)] == 0)) for trial, ahead in pairs}
        if counts == {1}:
            return "forecast from the first sample"
        least, most = min(counts), max(counts)
        return f"forecast from the first {most if least == most else f'{least} to {most}'} samples"

    def to_frame(self) -> "pd.DataFrame":
        """Return a long table: object, trial, time, and each state as measured, as forecast, and their difference.

        Rows are the samples of the trials and the times that were asked for. At the time of a dose they show the state
        after it, unless it was measured in the row of the dose.

        With standard deviations each state has the ends of its 95 % interval ("low", "high"), and where the noise is
        known those for a measurement ("measured low", "measured high").
        """
        import pandas as pd

        schema, parts = self.trials.schema, []
        kinds = {} if self.std is None else {"": self.bands()}
        if kinds and self.noise is not None:
            kinds["measured "] = self.bands(measured=True)
        for i, (trial, forecast) in enumerate(zip(self.trials, self._states(), strict=True)):
            times, rows = self._rows(trial)
            part = {schema.object: trial.object, schema.trial: trial.name, schema.time: times}
            for j, name in enumerate(schema.states):
                part[name] = trial.states[rows, j]
                part[f"{name} forecast"] = forecast[rows, j]
                part[f"{name} error"] = forecast[rows, j] - trial.states[rows, j]
                for kind, bands in kinds.items():
                    part[f"{name} {kind}low"], part[f"{name} {kind}high"] = (end[rows, j] for end in bands[i])
            parts.append(pd.DataFrame(part))
        return pd.concat(parts, ignore_index=True)

    @checks_types
    def smooth(self, points: int = 300) -> "Forecast":
        """Return the forecasts at more times, to draw them as curves.

        Each trial gets so many `points`, but none where its samples are as close. Laws in discrete time, and forecasts
        that `Law.predict` did not make, stay as they are. Raises `CommonlawError` if there are not 2 to a million
        points.
        """
        limit = 1_000_000  # No screen has as many
        if not 2 <= points <= limit:
            raise CommonlawError("curve-points", points=points, limit=limit)
        more = [_between(trial.times, points) for trial in self.trials]
        if self.at_more_times is None or not any(len(times) for times in more):
            return self
        return self.at_more_times(more)

    @checks_types
    def interval(self, level: float = 0.95, measured: bool = False) -> "pd.DataFrame":
        """Return a long table: object, trial, time, state, its forecast, and the ends of the prediction interval.

        Raises `CommonlawError` if the forecast has no standard deviations, the level is not between 0 and 1, or the
        noise is not known.

        Parameters
        ----------
        level
            The probability that the state lies in the interval.
        measured
            Whether the interval is for a measurement of the state, with its noise, instead of the state itself.
        """
        import pandas as pd

        schema, parts, bands = self.trials.schema, [], self.bands(level, measured)
        for trial, forecast, (low, high) in zip(self.trials, self._states(), bands, strict=True):
            times, rows = self._rows(trial)
            for j, name in enumerate(schema.states):
                part = {schema.object: trial.object, schema.trial: trial.name, schema.time: times, "state": name}
                part |= {"forecast": forecast[rows, j], "low": low[rows, j], "high": high[rows, j]}
                parts.append(pd.DataFrame(part))
        return pd.concat(parts, ignore_index=True)

    @checks_types
    def bands(self, level: float = 0.95, measured: bool = False) -> tuple[tuple[Floats, Floats], ...]:
        """Return the lower and upper ends of the intervals of each trial, each of shape (n, states); see `interval`."""
        if self.followed is not None:
            ends, schema = self.followed.bands(level, measured), self.followed.trials.schema
            return tuple((natural(low, schema), natural(high, schema)) for low, high in ends)
        parts = self.parts or (Part(1.0, self, (1.0,) * len(self.trials)),)
        scales = [part.forecast._scales(measured) for part in parts]
        centers = [part.forecast._states() for part in parts]
        known = [part.forecast.degrees_of_freedom for part in parts]
        unlimited = np.full(len(self.trials.schema.states), np.inf)
        degrees = np.array([unlimited if freedom is None else freedom for freedom in known])[:, np.newaxis]
        return tuple(
            mixture_interval(
                np.array([part.weights[i] for part in parts]).reshape(-1, 1, 1),
                np.array([center[i] for center in centers]),
                np.array([scale[i] for scale in scales]),
                degrees,
                level,
            )
            for i in range(len(self.trials))
        )

    @checks_types
    def margins(self, level: float = 0.95, measured: bool = False) -> tuple[Floats, ...]:
        """Return half the widths of the intervals of each trial, each of shape (n, states); see `interval`."""
        return tuple((high - low) / 2 for low, high in self.bands(level, measured))

    def _scales(self, measured: bool) -> list[Floats]:
        """Return what intervals are multiples of, for each trial, of shape (n, states); without what parts differ."""
        if self.std is None:
            raise CommonlawError("forecast-without-deviations")
        factors: list[Floats | float] = [1.0] * len(self.std)
        if self.interval_inflation is not None:
            factors = [self.interval_inflation.at(ahead)[:, np.newaxis] for ahead in self.horizons]
        if not measured:
            return [wider * std for wider, std in zip(factors, self.std, strict=True)]
        triples = zip(factors, self.std, self.measurement_std(), strict=True)
        return [wider * np.hypot(std, noise) for wider, std, noise in triples]

    @checks_types
    def measurement_std(self, white: bool = False) -> tuple[Floats, ...]:
        """Return standard deviations of measurements, shape (n, states), or of their `white` noise alone.

        Raises `CommonlawError` if the noise is not known.
        """
        if self.noise is None:
            raise CommonlawError("forecast-without-noise")
        if self.followed is not None:
            columns = np.isin(self.trials.schema.states, self.followed.trials.schema.logarithmic)
            pairs = zip(self.followed.measurement_std(white), self._states(), strict=True)
            return tuple(std * np.where(columns, states, 1.0) for std, states in pairs)
        errors = self.error_model
        noise = [trial.std(errors.noise_of_trial(trial, self.noise)) for trial in self.trials]
        forecast = zip(self.trials, self._states(), noise, strict=True)
        if white:
            return tuple(errors.white_std(states, std) for _, states, std in forecast)
        return tuple(errors.measurement_std(states, std, trial.elapsed) for trial, states, std in forecast)

    @checks_types
    def as_measured(self, measured: Trials) -> "Forecast":
        """Return the forecast of measured trials from this one, which has logarithms of some of their states."""
        schema, again = self.trials.schema, self.at_more_times
        states = [natural(trajectory.states, schema) for trajectory in self.trajectories]
        std = None
        if self.std is not None:  # To first order
            columns, pairs = np.isin(schema.states, schema.logarithmic), zip(self.std, states, strict=True)
            std = tuple(deviations * np.where(columns, x[:, : len(columns)], 1.0) for deviations, x in pairs)
        return replace(
            self,
            trials=as_measured(self.trials, measured),
            trajectories=tuple(replace(path, states=x) for path, x in zip(self.trajectories, states, strict=True)),
            std=std,
            at_more_times=None if again is None else partial(_measured_at, again, measured),
            followed=self,
            parts=(),
        )

    def errors(self) -> "pd.DataFrame":
        """Return a table of errors, one row for each trial and measured state.

        RMS error, largest and last absolute error, in the state's unit, and when the forecast diverged (NaN if it did
        not; its errors are then infinite). Missing measurements do not count; a state without any has NaN.
        """
        import pandas as pd

        schema, rows = self.trials.schema, []
        for trial, trajectory, (states, forecast) in zip(self.trials, self.trajectories, self._compared(), strict=True):
            errors = np.abs(np.nan_to_num(forecast, nan=np.inf) - states)
            lost = np.flatnonzero(np.isnan(trajectory.states).any(axis=1))
            for name in schema.measured:
                j = schema.states.index(name)
                error = errors[~np.isnan(states[:, j]), j]
                rows.append(
                    {
                        schema.object: trial.object,
                        schema.trial: trial.name,
                        "state": name,
                        "rms error": np.sqrt(np.mean(error**2)) if len(error) else np.nan,
                        "largest error": error.max() if len(error) else np.nan,
                        "last error": error[-1] if len(error) else np.nan,
                        "diverged after": np.nan if trajectory.outcome is None else trial.times[lost[0] - 1],
                    }
                )
        return pd.DataFrame(rows)

    def score(self) -> float:
        """Return the mean over states of R^2, the share of the states' variation within trials that is forecast.

        1 is perfect, 0 is as good as each trial's mean, minus infinity a divergence; NaN if no state varied. Missing
        measurements do not count.
        """
        if any(np.isnan(forecast).any() for _, forecast in self._compared()):
            return -np.inf
        missed, varied = self._sums_of_squares().sum(axis=1)
        return float(np.mean(1 - missed[varied > 0] / varied[varied > 0])) if varied.any() else np.nan

    @checks_types
    def metric(self, metric: Metric = "r2") -> float:
        """Return the mean over states of a metric of scikit-learn; missing measurements do not count.

        ``"r2"``, 1 - sum (y - f)^2 / sum (y - mean y)^2; ``"rmse"`` or ``"mae"``, in the unit of the state; or a
        function of measurements and forecasts of a state, shape (n,) each. Where a forecast diverged, R^2 is minus
        infinity, and errors are infinite. States that do not vary have no R^2.

        Raises `CommonlawError` if there is no such metric.
        """
        if isinstance(metric, str):
            check_choice("metric", metric, _METRICS)
            metric = _METRICS[metric]
        measured, forecast = (np.concatenate(parts) for parts in zip(*self._compared(), strict=True))
        seen, forecast = np.isfinite(measured), np.where(np.isnan(forecast), np.inf, forecast)
        columns = np.flatnonzero(seen.any(axis=0))
        values = [float(metric(measured[seen[:, j], j], forecast[seen[:, j], j])) for j in columns]
        known = [value for value in values if not np.isnan(value)]
        return float(np.mean(known)) if known else np.nan

    def bounded_score(self) -> float:
        """Return the mean of R^2 over trials and states, each at least -1, also where the forecast diverged.

        One forecast that fails does not outweigh many good ones. Missing measurements and states that did not vary do
        not count; NaN if none did.
        """
        missed, varied = self._sums_of_squares()
        scores = np.maximum(1 - missed[varied > 0] / varied[varied > 0], -1.0)
        return float(np.mean(scores)) if len(scores) else np.nan

    def _sums_of_squares(self) -> Floats:
        """Return those of errors and of variations about the mean of each state in each trial, (2, trials, states)."""
        sums = list[Floats]()
        for states, forecast in self._compared():
            errors = np.where(np.isfinite(states), np.nan_to_num(forecast - states, nan=np.inf), 0.0)
            sums.append(np.array([np.sum(errors**2, axis=0), variation(states)[1]]))
        return np.stack(sums, axis=1)

    @property
    def ahead(self) -> tuple[Bools, ...]:
        """Which samples of each trial are forecast, each of shape (n,); the others determined the initial state."""
        return tuple(trial.times >= (-np.inf if self.from_time is None else self.from_time) for trial in self.trials)

    def _rows(self, trial: Trial) -> tuple[Floats, Indices]:
        """Return the times of a trial in tables, and the samples that these show, shape (n,) each."""
        wanted = self.wanted[(self.wanted >= trial.times[0]) & (self.wanted <= trial.times[-1])]
        is_added = np.isin(trial.times, trial.corners[:, 0])
        is_row, is_measured = ~is_added, _measured(trial) & ~is_added
        is_row[np.rint(np.interp(wanted, trial.times, np.arange(len(trial)))).astype(int)] = True
        rows = np.flatnonzero(is_row & (trial.times >= (-np.inf if self.from_time is None else self.from_time)))
        samples = rows.copy()
        for end, at in trial.corners[np.isfinite(trial.corners).all(axis=1)].tolist():
            samples[(trial.times[rows] == at) & ~is_measured[rows]] = np.searchsorted(trial.times, end)
        return trial.times[rows], samples

    def _compared(self) -> list[tuple[Floats, Floats]]:
        """Return for each trial the states as measured and as forecast, at the samples that are forecast."""
        triples = zip(self.trials, self._states(), self.ahead, strict=True)
        return [(trial.states[ahead], forecast[ahead]) for trial, forecast, ahead in triples]

    def _states(self) -> list[Floats]:
        width = len(self.trials.schema.states)
        return [trajectory.states[:, :width] for trajectory in self.trajectories]


def variation(states: Floats) -> tuple[Floats, Floats]:
    """Return how many values of each state are measured, and their sum of squares about the mean, shape (d,) each."""
    seen = np.isfinite(states)
    counts = seen.sum(axis=0, dtype=np.float64)
    means = np.sum(states, axis=0, where=seen) / np.maximum(counts, 1)
    return counts, np.sum((states - means) ** 2, axis=0, where=seen)


def squared_errors(forecast: Forecast) -> "pd.DataFrame":
    """Return the squared error of each measurement, a row for each sample with its object and a column for each state.

    A state that was not measured has NaN, and one after a divergence infinity. Zeros of a state that is absent from a
    trial, `Trial.absent`, have NaN where the law keeps it at zero: it cannot miss these.
    """
    import pandas as pd

    schema = forecast.trials.schema
    errors = [(np.nan_to_num(curve, nan=np.inf) - states) ** 2 for states, curve in forecast._compared()]
    for trial, (_, curve), squares in zip(forecast.trials, forecast._compared(), errors, strict=True):
        squares[trial.absent & (curve == 0)] = np.nan
    names = np.repeat([trial.object for trial in forecast.trials], [*map(len, errors)])
    frame = pd.DataFrame(np.concatenate(errors), index=names, columns=list(schema.states))
    return frame[list(schema.measured)]


def _measured_at(again: Callable[[Sequence[Floats]], Forecast], measured: Trials, times: Sequence[Floats]) -> Forecast:
    return again(times).as_measured(measured)


def _between(times: Floats, points: int) -> Floats:
    """Return so many times over the span of a trial, but none where samples are as close as these."""
    grid = np.linspace(times[0], times[-1], points + 1)[1:-1]
    far = np.append(np.diff(times) > (times[-1] - times[0]) / points, False)
    return np.asarray(grid[far[np.searchsorted(times, grid, side="right") - 1]])


def _measured(trial: Trial) -> Bools:
    """Return in which samples of a trial anything was measured, shape (n,)."""
    return np.asarray(np.isfinite(trial.states).any(axis=1))
