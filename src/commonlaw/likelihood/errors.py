"""Error models besides white noise, one class each: levels, bounds, and initial values of their estimation."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import ClassVar, Literal

import numpy as np

from commonlaw.array_types import Floats, Indices
from commonlaw.likelihood.observation_model import LatentProcesses
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.trials import Trial


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """Levels of errors besides white noise, in units of states and time; None without a kind.

    Levels of `Heteroscedastic` noise are by kind, each of shape (d,); `walk` is a random walk of states and rates, for
    a unit of time, shape (D,), `sensor_walk` one of measurements, (d,). For the others see `LatentProcesses`. White
    noise, and the walk, of an object are those of all objects times its factors in `by_object`, shape (d,); of objects
    that are not there they are those of all. White noise of a fitted trial, by its label, is that of all times its
    factors in `by_trial`, where it is there; its object then has the root mean square.
    """

    heteroscedastic: Mapping[ErrorKind, Floats] = field(default_factory=dict)
    correlated: Floats | None = None
    memory: float = np.inf
    force: Floats | None = None
    force_time: float = np.inf
    walk: Floats | None = None
    sensor_walk: Floats | None = None
    offset: Floats | None = None
    slope: Floats | None = None
    trend: Floats | None = None
    by_object: Mapping[str, Floats] = field(default_factory=dict)
    by_trial: Mapping[str, Floats] = field(default_factory=dict)

    @property
    def kinds(self) -> tuple[ErrorKind, ...]:
        """All kinds of errors besides white noise."""
        levels: Mapping[ErrorKind, Floats | Mapping[str, Floats] | None] = {
            "gp-forcing": self.force,
            "autocorrelated": self.correlated,
            "sensor-walk": self.sensor_walk,
            "drift": self.slope,
            **self.heteroscedastic,
            "by-object": None if self.by_trial else self.by_object or None,
            "by-trial": self.by_trial or None,
            "random-walk": self.walk,
        }
        return tuple(kind for kind, level in levels.items() if level is not None)

    @property
    def kind(self) -> ErrorKind:
        return next(iter(self.kinds), "white")

    @property
    def correlation_time(self) -> float:
        """The correlation time of latent processes, infinite if they have none."""
        return min(self.memory, self.force_time)

    @property
    def latent(self) -> LatentProcesses:
        """The latent processes, which are eliminated with the states."""
        correlated = self.correlated if self.sensor_walk is None else self.sensor_walk
        drift = self.offset, self.slope, self.trend
        return LatentProcesses(correlated, self.memory, self.force, self.force_time, *drift)

    @property
    def levels(self) -> Floats:
        """Levels of errors, then times, as `AbstractErrors.model` takes them."""
        if self.correlated is not None:
            return np.append(self.correlated, self.memory)
        if self.force is not None:
            return np.append(self.force, self.force_time)
        if self.sensor_walk is not None:
            return self.sensor_walk
        if self.latent.drift is not None:
            trend, none = self.latent.mean[len(self.latent.drift) // 2 :], np.finfo(float).tiny
            return np.concatenate([self.latent.drift, np.maximum(trend, none), np.maximum(-trend, none)])
        return np.concatenate([np.zeros(0), *self.heteroscedastic.values()])

    def __bool__(self) -> bool:
        return self.kind != "white"

    @property
    def of_law(self) -> bool:
        """Whether there is process noise, besides measurement errors."""
        return self.force is not None or self.walk is not None

    @property
    def rounds(self) -> int:
        """Rounds of alternating estimation: heteroscedastic noise depends on fitted states."""
        return 2 if self.heteroscedastic else 1

    @property
    def of_measurements(self) -> "ErrorModel":
        """The errors of measurements among these."""
        return replace(self, force=None, force_time=np.inf, walk=None)

    def noise_of(self, owner: str, noise: Floats) -> Floats:
        """Return the white noise of an object, shape (d,), given that of all objects."""
        return noise * self.by_object.get(owner, 1.0)

    @property
    def grouping(self) -> ErrorKind:
        """By which groups white noise differs, if it does."""
        return "by-trial" if self.by_trial else "by-object"

    def noise_of_trial(self, trial: Trial, noise: Floats) -> Floats:
        """Return the white noise of a fitted trial, shape (d,), given that of all objects."""
        factors = self.by_trial.get(trial.label)
        return self.noise_of(trial.object, noise) if factors is None else noise * factors

    def walk_of(self, owner: str, second: Indices) -> Floats | None:
        """Return the random walk of an object, whose states of second order are given by index."""
        factors = self.by_object.get(owner)
        return self.walk if self.walk is None or factors is None else self.walk * np.append(factors, factors[second])

    def white_std(self, states: Floats, noise: Floats) -> Floats:
        """Return the standard deviation of white noise at states, shape (n, d), given that at zero, (n, d) or (d,)."""
        relative = np.ones_like(noise)
        for kind, levels in self.heteroscedastic.items():
            relative = np.hypot(relative, levels / noise * heteroscedastic(kind).growth(states))
        return noise * relative

    def heteroscedastic_in_words(self, names: Sequence[str]) -> dict[ErrorKind, str]:
        """Return the levels of heteroscedastic noise as text, by kind, for the states of these names."""
        return {
            kind: ", ".join(heteroscedastic(kind).in_words(*pair) for pair in zip(levels.tolist(), names, strict=True))
            for kind, levels in self.heteroscedastic.items()
        }

    def measurement_std(self, states: Floats, noise: Floats, elapsed: Floats) -> Floats:
        """Return the standard deviation of a measurement about states, shape (n, d), see `white_std`.

        The times since the first sample of the trial have shape (n,).
        """
        std = self.white_std(states, noise) + np.zeros_like(states)
        if self.correlated is not None:
            std = np.hypot(std, self.correlated)
        if self.sensor_walk is not None:
            std = np.hypot(std, self.sensor_walk * np.sqrt(elapsed)[:, np.newaxis])
        if self.offset is not None:
            std = np.hypot(np.hypot(std, self.offset), self.root_mean_square_slope * elapsed[:, np.newaxis])
        return std

    def mean(self, elapsed: Floats) -> Floats:
        """Return the mean error of measurements at times since the first sample of a trial, shape (n, d) or (n, 1)."""
        return elapsed[:, np.newaxis] * (np.zeros(1) if self.trend is None else self.trend)

    @property
    def root_mean_square_slope(self) -> Floats:
        """The root mean square slope of a drift, shape (d,): other trials may drift the other way."""
        slope = np.zeros(1) if self.slope is None else self.slope
        return slope if self.trend is None else np.hypot(slope, self.trend)


WHITE_NOISE = ErrorModel()
"""White noise alone."""


@dataclass(frozen=True)
class Scales:
    """Scales that bound the levels and times of errors.

    Standard deviations of states and of their highest derivatives have shape (d,). The step is the median one, the
    duration that of the longest trial. The smallest levels, `least`, are a share of these standard deviations, and the
    smallest random walk is relative to the noise. Trials are counted.
    """

    states: Floats
    rates: Floats
    step: float
    duration: float
    least: float
    least_walk: float
    trials: int = 1


class AbstractErrors(ABC):
    """A kind of errors: its levels and times, their bounds, and initial values of their estimation."""

    label: ClassVar[str]
    """Name in messages and reports."""
    description: ClassVar[str] = ""
    """What there is beyond a law, with fields for its `amount` and its correlation `time`; empty for white noise."""
    distinguished_by: ClassVar[str] = ""
    """What would distinguish it from missing terms; empty where they are not confused."""
    group: ClassVar[Literal["white", "measurement", "law"]] = "measurement"
    """What is affected besides white noise; the best kind of each group is fitted with its own law."""
    is_independent: ClassVar[bool] = False
    """Whether errors of measurements are independent: outliers are rejected then, and count linearly else."""
    correlation_times: ClassVar[int] = 0
    """How many of the values are correlation times, the last ones."""
    is_of_trials: ClassVar[bool] = False
    """Whether each trial has one number of each level, so that levels are known from trials, not from measurements."""
    shares: ClassVar[tuple[float, ...]] = (0.2, 0.5, 0.7)
    """Initial levels, as shares of the interval between the logarithms of the bounds."""

    @abstractmethod
    def model(self, values: Floats) -> ErrorModel:
        """Return the error model with given levels, then times."""

    @abstractmethod
    def bounds(self, scales: Scales) -> tuple[Floats, Floats]:
        """Return the least and the largest levels, then times."""

    def starts(self, log_noise: Floats, low: Floats, high: Floats) -> list[Floats]:
        """Return initial logarithms of levels and times, between bounds."""
        return [low + share * (high - low) for share in self.shares]

    def highest(self, start: Floats, low: Floats, high: Floats) -> Floats:
        """Return the largest logarithms of levels and times in a search that begins at a start, between bounds."""
        return high

    def means(self, levels: int) -> range:
        """Return which of so many levels are means, each of which costs as much as a coefficient, log n (BIC)."""
        return range(0)

    def size(self, errors: ErrorModel, duration: float) -> Floats | None:
        """Return the standard deviation of an error of a measurement at the end of a trial, besides white noise, (d,).

        None of errors of the law, which move the path of a trial, and of noise that is not of one size.
        """
        return None


class White(AbstractErrors):
    """White noise alone."""

    label = "white noise"
    group = "white"
    is_independent = True

    def model(self, values: Floats) -> ErrorModel:
        return WHITE_NOISE

    def bounds(self, scales: Scales) -> tuple[Floats, Floats]:
        return np.empty(0), np.empty(0)

    def starts(self, log_noise: Floats, low: Floats, high: Floats) -> list[Floats]:
        return [np.empty(0)]


class Heteroscedastic(AbstractErrors):
    """White noise whose variance is ``noise^2 + (level growth(x))^2``."""

    kind: ClassVar[ErrorKind]
    description = "noise that grows with the measured value, {amount}"
    is_independent = True

    @abstractmethod
    def growth(self, states: Floats) -> Floats:
        """Return the standard deviation at states for a level of one."""

    @abstractmethod
    def in_words(self, level: float, state: str) -> str:
        """Return the noise of a state at a level as text."""

    def model(self, values: Floats) -> ErrorModel:
        return ErrorModel({self.kind: values})

    def bounds(self, scales: Scales) -> tuple[Floats, Floats]:
        growth = self.growth(scales.states)
        largest = np.divide(scales.states, growth, out=np.ones_like(growth), where=growth > 0)
        return scales.least * largest, largest


class Proportional(Heteroscedastic):
    """Noise in proportion to the state."""

    kind = "proportional"
    label = "proportional noise"
    description = "noise in proportion to the measured value, {amount}"

    def growth(self, states: Floats) -> Floats:
        return states

    def in_words(self, level: float, state: str) -> str:
        return f"{100 * level:.3g} % of {state}"


class ByGroup(AbstractErrors):
    """White noise of a standard deviation for each group of measurements, see `noise_scatter`."""

    is_independent = True

    def model(self, values: Floats) -> ErrorModel:
        return WHITE_NOISE

    def bounds(self, scales: Scales) -> tuple[Floats, Floats]:
        return np.empty(0), np.empty(0)

    @abstractmethod
    def group_of(self, trial: Trial) -> str:
        """Return the name of the group of a trial."""

    def groups(self, trials: Iterable[Trial]) -> Indices:
        """Return the number of the group of each trial, in the order in which they come."""
        numbers = dict[str, int]()
        return np.array([numbers.setdefault(self.group_of(trial), len(numbers)) for trial in trials], dtype=np.int64)

    @abstractmethod
    def of_factors(self, trials: Sequence[Trial], factors: Floats) -> ErrorModel:
        """Return the errors of trials whose groups have factors of the noise, shape (groups, d)."""


class ByObject(ByGroup):
    """White noise of each object's own standard deviation."""

    label = "noise by object"
    description = "noise that differs between objects, {amount}"

    def group_of(self, trial: Trial) -> str:
        return trial.object

    def of_factors(self, trials: Sequence[Trial], factors: Floats) -> ErrorModel:
        objects = dict.fromkeys(trial.object for trial in trials)
        return ErrorModel(by_object=dict(zip(objects, factors, strict=True)))


class ByTrial(ByGroup):
    """White noise of each trial's own standard deviation; that of its object is the root mean square."""

    label = "noise by trial"
    description = "noise that differs between trials, {amount}"

    def group_of(self, trial: Trial) -> str:
        return trial.label

    def of_factors(self, trials: Sequence[Trial], factors: Floats) -> ErrorModel:
        of_objects = dict[str, list[tuple[Floats, Floats]]]()
        for trial, factor in zip(trials, factors, strict=True):
            counts = np.maximum(trial.counts.sum(axis=0), 1.0)
            of_objects.setdefault(trial.object, []).append((counts, factor))
        typical = {
            owner: np.sqrt(sum(n * factor**2 for n, factor in parts) / sum(n for n, _ in parts))
            for owner, parts in of_objects.items()
        }
        labels = [trial.label for trial in trials]
        return ErrorModel(by_object=typical, by_trial=dict(zip(labels, factors, strict=True)))


class _Timed(AbstractErrors):
    """Autocorrelated errors: levels, followed by one correlation time."""

    correlation_times = 1
    times: ClassVar[tuple[float, ...]] = (0.2, 0.5, 0.8)

    def starts(self, log_noise: Floats, low: Floats, high: Floats) -> list[Floats]:
        times = [low[-1:] + share * (high - low)[-1:] for share in self.times]
        levels = self._levels(log_noise, low[:-1], high[:-1])
        return [np.concatenate(pair) for pair in product(levels, times)]

    def _levels(self, log_noise: Floats, low: Floats, high: Floats) -> list[Floats]:
        return super().starts(log_noise, low, high)


class Correlated(_Timed):
    """Autocorrelated errors of measurements (Ornstein-Uhlenbeck)."""

    label = "autocorrelated measurement errors"
    description = "errors of the sensor that are correlated over {time}, {amount}"
    distinguished_by = "a second sensor, or trials from the same start, would distinguish them from missing terms"
    shares = (0.3, 1.0)
    """Initial levels relative to the noise."""

    def model(self, values: Floats) -> ErrorModel:
        return ErrorModel(correlated=values[:-1], memory=float(values[-1]))

    def bounds(self, scales: Scales) -> tuple[Floats, Floats]:
        return np.append(scales.least * scales.states, scales.step), np.append(scales.states, 3 * scales.duration)

    def _levels(self, log_noise: Floats, low: Floats, high: Floats) -> list[Floats]:
        return [log_noise + np.log(share) for share in self.shares]

    def size(self, errors: ErrorModel, duration: float) -> Floats | None:
        return errors.correlated


class SensorWalk(AbstractErrors):
    """A random walk of the measurements of each trial (Wiener process), zero at its first sample."""

    label = "a random walk of the sensor"
    description = "a random walk of the sensor, about {amount} by the end of a trial"
    distinguished_by = "a second sensor, or trials from the same start, would distinguish it from missing terms"

    def model(self, values: Floats) -> ErrorModel:
        return ErrorModel(sensor_walk=values)

    def bounds(self, scales: Scales) -> tuple[Floats, Floats]:
        return scales.least * scales.states / np.sqrt(scales.duration), scales.states / np.sqrt(scales.step)

    def size(self, errors: ErrorModel, duration: float) -> Floats | None:
        return None if errors.sensor_walk is None else errors.sensor_walk * np.sqrt(duration)


class Drift(AbstractErrors):
    """An offset and a slope in time of the measurements of each trial: ``b0 + b1 t`` from its first sample on.

    Both are normal. The mean slope of several trials is that upwards less that downwards, of which one is next to
    nothing; of a single trial it would be no error but a term in time, and is zero.
    """

    label = "a drift of the sensor"
    description = "a drift of the sensor, about {amount} by the end of a trial"
    distinguished_by = "a second sensor, or a trial at rest, would distinguish it from a constant of the law"
    is_of_trials = True

    def model(self, values: Floats) -> ErrorModel:
        offset, slope, up, down = np.split(values, 4)
        return ErrorModel(offset=offset, slope=slope, trend=up - down)

    def bounds(self, scales: Scales) -> tuple[Floats, Floats]:
        slopes = scales.states / scales.duration
        largest = np.concatenate([scales.states, slopes, *[np.sqrt(12) * slopes] * 2])  # Lines with that SD
        low = scales.least * largest
        of_one = scales.trials == 1 and np.isin(np.arange(len(low)), self.means(len(low)))
        return low, np.where(of_one, low, largest)

    def starts(self, log_noise: Floats, low: Floats, high: Floats) -> list[Floats]:
        signs = product((False, True), repeat=len(low) // 4)
        without = [np.append(np.zeros(len(low) // 2, dtype=np.bool_), (*up, *np.logical_not(up))) for up in signs]
        levels = super().starts(log_noise, low, high)
        return [np.where(none, low, level) for level in levels for none in without]

    def highest(self, start: Floats, low: Floats, high: Floats) -> Floats:
        """Hold mean slopes on the side of zero on which they begin, or at zero."""
        is_mean = np.isin(np.arange(len(start)), self.means(len(start)))
        return np.where(is_mean & (start <= low), low, high)

    def means(self, levels: int) -> range:
        return range(levels // 2, levels)

    def size(self, errors: ErrorModel, duration: float) -> Floats | None:
        assert errors.offset is not None
        return np.hypot(errors.offset, errors.root_mean_square_slope * duration)


class Force(_Timed):
    """A smooth random force on the highest derivatives (Matern process of smoothness 3/2)."""

    label = "a smooth random force"
    description = "an unknown force, smooth over {time}, that moves the path of a trial by {amount}"
    distinguished_by = "a measured input, or trials from the same start, would distinguish it from missing terms"
    group = "law"

    def model(self, values: Floats) -> ErrorModel:
        return ErrorModel(force=values[:-1], force_time=float(values[-1]))

    def bounds(self, scales: Scales) -> tuple[Floats, Floats]:
        return np.append(scales.least * scales.rates, 2 * scales.step), np.append(scales.rates, scales.duration)


class Walk(AbstractErrors):
    """A random walk of states and rates; its level, relative to the noise, is the model error of a fit."""

    label = "a random walk of the law"
    description = "random disturbances of states and rates that move the path of a trial by {amount}"
    distinguished_by = "trials from the same start would distinguish them from missing terms"
    group = "law"

    def model(self, values: Floats) -> ErrorModel:
        return WHITE_NOISE

    def bounds(self, scales: Scales) -> tuple[Floats, Floats]:
        return np.array([scales.least_walk]), np.array([30.0])


ERRORS: Mapping[ErrorKind, AbstractErrors] = {
    "white": White(),
    "proportional": Proportional(),
    "by-object": ByObject(),
    "by-trial": ByTrial(),
    "autocorrelated": Correlated(),
    "sensor-walk": SensorWalk(),
    "drift": Drift(),
    "random-walk": Walk(),
    "gp-forcing": Force(),
}


def groupings(trials: Iterable[Trial]) -> tuple[ErrorKind, ...]:
    """Return the kinds of noise by group that have several groups of these trials; of equal ones the first."""
    counts, result = {1}, list[ErrorKind]()
    labels = [(trial.object, trial.label) for trial in trials]
    numbers: dict[ErrorKind, int] = {"by-object": len({name for name, _ in labels}), "by-trial": len({*labels})}
    for kind, number in numbers.items():
        if number not in counts:
            result.append(kind)
        counts.add(number)
    return tuple(result)


def by_group(kind: ErrorKind) -> ByGroup:
    """Return a kind of noise that differs between groups."""
    errors = ERRORS[kind]
    assert isinstance(errors, ByGroup)
    return errors


def heteroscedastic(kind: ErrorKind) -> Heteroscedastic:
    """Return a kind of heteroscedastic noise."""
    errors = ERRORS[kind]
    assert isinstance(errors, Heteroscedastic)
    return errors
