"""The verdict on a law: its numbers, and what they mean in sentences."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isnan, nan, sqrt
from typing import NamedTuple

from commonlaw.runtime.notebooks import ShownInNotebooks
from commonlaw.text import counted

SMALL_ERROR = 0.5
"""Forecasts are good as far ahead as their errors stay within this share of the states' spread: three quarters of the
variance are then explained."""

NO_BETTER = 0.9
"""Forecasts whose error is above this share of that of persistence, or of the spread of the states without a horizon,
are no better than the last value, or the mean: of few trials, a tenth is chance."""

_MIN_MEASUREMENTS = 5
"""Fewer measurements are too few to judge by: their mean error is known to no better than half of it."""

_LOW_COVERAGE, _MIN_FOR_COVERAGE = 0.85, 10
"""Bands are too narrow if they hold a smaller share of measurements, of so many at least. Of ten measurements bands of
95 % hold fewer than nine by chance in nine of a hundred cases."""


class StateError(NamedTuple):
    """RMS forecast errors of a state by the law and by persistence, in its unit, empty if unknown.

    `noise` is that of the measurements and `spread` the standard deviation within the assessed trials, NaN if unknown
    or constant; they were measured between `low` and `high`.
    """

    state: str
    law: float
    persistence: float
    unit: str
    noise: float
    spread: float
    low: float
    high: float

    @property
    def unexplained(self) -> float:
        """The error of the law's forecasts beyond the noise."""
        return sqrt(max(self.law**2 - self.noise**2, 0.0))

    def share(self, error: float, ends: bool = True) -> str:
        """Return an error with its unit, and as a share of the measured range, whose ends are given if wanted."""
        share = _percent(error / (self.high - self.low))
        if not ends:
            return f"{_number(error, self.unit)} ({share})"
        ends_of = f"{_number(self.low)} to {_number(self.high, self.unit)}"
        return f"{_number(error, self.unit)} in {self.state} ({share} of its range, {ends_of})"


@dataclass(frozen=True)
class LawVerdict(ShownInNotebooks):
    """The forecast assessment of a law; it prints as sentences.

    Errors are root mean squares relative to the states' standard deviations within trials (spread). Persistence
    forecasts the last measured values. Where some states are predicted and others are not, horizon, error, persistence
    and R^2 are those of the former.

    Parameters
    ----------
    judged_on
        What was forecast, in words.
    in_sample
        Whether the law was fitted to it.
    segments, diverged, measurements
        How many forecasts were assessed, how many diverged, and how many measurements were compared.
    horizon, longest, time_unit
        How far ahead the error stays within half of the spread, the longest tested horizon, and their unit.
    error, persistence
        Of the law's forecasts and of persistence.
    r_squared, r_squared_error
        Mean over states, see `Forecast.score`, and its standard error over trials; NaN of a single trial.
    state_errors
        Of each state, in its unit.
    coverage
        Share of the measurements within 95 % bands; None without bands.
    poorly_known
        Coefficients with a standard error above half of their size.
    not_assessable
        What could not be assessed, and why.
    unknown_objects
        Objects that were forecast with the mean coefficients of the others.
    exact, none_exact
        Whether the law has no lack of fit, and whether all laws that it was chosen from have one.
    few_samples
        Whether an equation has as many terms as its samples can identify.
    without_terms
        Left-hand sides of equations without a term.
    unpredicted
        States whose forecasts are no better than their mean or last value, with errors above half of the spread at the
        shortest horizon already, other than all.
    unknowns, training_measurements
        Of an assessment on the training data: how many parameters and initial values were estimated, and from how many
        measurements; zero of one on other data.
    error_within, persistence_within
        As `error` and `persistence`, up to the horizon.
    process_noise
        Whether the law includes process noise, which its bands contain.
    outliers
        Measurements that do not count, each far from those around it.
    """

    judged_on: str
    in_sample: bool
    segments: int
    diverged: int
    measurements: int
    horizon: float
    longest: float
    time_unit: str
    error: float
    persistence: float
    r_squared: float
    r_squared_error: float
    state_errors: tuple[StateError, ...]
    coverage: float | None
    poorly_known: tuple[str, ...]
    not_assessable: tuple[str, ...] = ()
    unknown_objects: tuple[str, ...] = ()
    exact: bool = True
    none_exact: bool = False
    few_samples: bool = False
    without_terms: tuple[str, ...] = ()
    unpredicted: tuple[str, ...] = ()
    unknowns: int = 0
    training_measurements: int = 0
    error_within: float = nan
    persistence_within: float = nan
    process_noise: bool = False
    outliers: int = 0

    @property
    def usable(self) -> bool | None:
        """Whether the law can be used for forecasts; None if that could not be assessed."""
        return None if self.lacking else not self.against

    @property
    def lacking(self) -> str:
        """Why the law could not be assessed; empty if it was."""
        if self.training_measurements and self.unknowns >= self.training_measurements:
            count = counted(self.training_measurements, "measurement")
            return f"{self.unknowns} estimated parameters and initial values reproduce any {count}"
        if self.diverged:
            return ""
        if self.measurements < _MIN_MEASUREMENTS:
            few = f"there are too few measurements to compare with ({self.measurements})"
            return few if self.measurements else "the forecast trials hold no measurement"
        still = self.persistence <= SMALL_ERROR and self.horizon == self.longest and self._is_no_better
        return "the states hardly change, and a constant forecast is equally accurate" if still else ""

    @property
    def against(self) -> tuple[str, ...]:
        """What speaks against using the law for forecasts."""
        result = []
        if self.diverged:
            result.append(f"its forecasts diverge in {self.diverged} of {counted(self.segments, 'forecast')}")
        elif self._is_calibrated_within_horizon:
            return ()
        elif self._is_no_better:
            result.append("the error is not below that of a constant forecast")
        if not self.diverged and self._is_no_better_than_the_mean:
            result.append(self._no_better_than_the_mean)
        return tuple(result)

    @property
    def caution(self) -> str:
        """What limits the use of the law for forecasts where nothing speaks against it, empty if nothing does."""
        if self.usable is not True:
            return ""
        if not self.horizon:
            near = "even at the shortest horizon the error exceeds half of the states' standard deviation"
            return f"{near}{self._spreads}, though it is below those of their mean and of a constant forecast"
        if self._is_no_better_than_the_mean:
            return self._no_better_than_the_mean
        return "beyond, they are no better than a constant forecast" if self._is_no_better else ""

    @property
    def sentences(self) -> tuple[str, ...]:
        """The verdict in words, what matters most first."""
        return tuple(self._sentences())

    def __str__(self) -> str:
        return "\n".join(self.sentences)

    @property
    def _is_no_better(self) -> bool:
        return self.error > NO_BETTER * self.persistence

    @property
    def _is_no_better_than_the_mean(self) -> bool:
        """Whether R^2 is below zero, or by chance above, as of few trials; of one without a horizon by its error."""
        by_chance = self.error > NO_BETTER and not self.horizon if isnan(self.r_squared_error) else False
        return self.r_squared < 0 or self.r_squared < self.r_squared_error or by_chance

    @property
    def _is_calibrated_within_horizon(self) -> bool:
        """Whether forecasts are better than the last value up to the horizon, and bands hold beyond, as of chaos.

        Bands with process noise hold for any law.
        """
        if self.process_noise:
            return False
        holds = self.coverage is not None and self.coverage >= _LOW_COVERAGE and self.measurements >= _MIN_FOR_COVERAGE
        return holds and self.horizon > 0 and self.error_within <= NO_BETTER * self.persistence_within

    @property
    def _no_better_than_the_mean(self) -> str:
        error = "" if isnan(self.r_squared_error) else f" ± {self.r_squared_error:.2g}"
        whole = f"R^2 over all tested forecasts is {round(self.r_squared, 12) + 0.0:.3g}{error}"
        beyond = f"beyond {_number(self.horizon, self.time_unit)} ahead they" if self.horizon else "they"
        return f"{beyond} are no better than the mean of the states: {whole}"

    def _sentences(self) -> Iterator[str]:
        if self.usable is None:
            yield f"Forecast accuracy could not be assessed: {self.lacking}."
        elif self.usable:
            can = "Forecasts its training data well" if self.in_sample else "This law can be used for forecasts"
            if self.unpredicted:
                states = " and ".join(state_error.state for state_error in self._predicted)
                can = f"Forecasts {states} of its training data well" if self.in_sample else f"{can} of {states}"
            exceeds = f"beyond, the error exceeds half of the states' standard deviation{self._spreads}"
            end = " (longest horizon tested)" if self.horizon == self.longest else f"; {self.caution or exceeds}"
            only = "" if self.exact or self.process_noise else "; it is an approximation"
            new = " Not tested on new data." if self.in_sample else ""
            if self.horizon:
                yield f"{can} up to {_number(self.horizon, self.time_unit)} ahead{end}{only}.{new}"
            else:
                yield f"{can.removesuffix(' well')} with caution: {self.caution}{only}.{new}"
        else:
            yield f"Do not use this law for forecasts: {'; '.join(self.against)}."
        for state_error in self.state_errors:
            if state_error.state in self.unpredicted:
                deviation = _number(state_error.spread, state_error.unit)
                yield (
                    f"{state_error.state} is not predicted: even at the shortest horizon the error exceeds half of its "
                    f"standard deviation, {deviation}."
                )
        if self.without_terms:
            names = " and ".join(self.without_terms)
            steady = (
                ": rates are constant in each trial" if all(name.endswith("''") for name in self.without_terms) else ""
            )
            yield f"No candidate term was selected for {names}, which the law sets to zero{steady}."
        if not self.exact:
            which = "no law in the library fits" if self.none_exact else "this law does not fit"
            bands = "; the bands include process noise" if self.process_noise else ""
            yield f"Lack of fit: {which} the data within the noise{bands}."
        if self.few_samples:
            yield "An equation has the maximum number of terms that so few samples can identify."
        if self.measurements:
            if not self.diverged:
                yield from self._accuracy()
            yield from self._bands()
            compared = f"{counted(self.measurements, 'measurement')} in {counted(self.segments, 'forecast')}"
            yield f"Tested on {self.judged_on}: {compared}, each from the first samples of a trial."
            if self.outliers:
                verb = "does" if self.outliers == 1 else "do"
                yield f"{counted(self.outliers, 'outlier')} among them {verb} not count."
            if self.unknown_objects:
                yield f"Forecasts of {listed(self.unknown_objects)} use the mean coefficients of the other objects."
        if self.poorly_known:
            yield f"Poorly identified (standard error above 50 % of the estimate): {listed(self.poorly_known)}."
        if self.not_assessable:
            yield f"Not assessed: {listed(self.not_assessable, '; ')}."
        if advice := "; ".join(self._advice()):
            yield f"Suggestions: {advice}."

    def _advice(self) -> Iterator[str]:
        if not (self.exact or self.process_noise):
            yield "add terms, or give a larger noise if it is known"
        elif self.without_terms or self.usable is False:
            yield "offer other terms, or collect more or more precise data"
        if self.few_samples or 0 < self.measurements < _MIN_MEASUREMENTS:
            yield "measure more samples or more trials"
        if self.in_sample and self.usable:
            yield "test the law on held-out or new trials"

    def _accuracy(self) -> Iterator[str]:
        known = [state_error for state_error in self.state_errors if state_error.high > state_error.low]
        errors = " and ".join(state_error.share(state_error.law) for state_error in known)
        last = " and ".join(state_error.share(state_error.persistence, ends=False) for state_error in known)
        yield f"RMS forecast error: {errors}; of a constant forecast: {last}."
        worse = [state_error.state for state_error in known if state_error.law > NO_BETTER * state_error.persistence]
        if worse and not self._is_no_better:
            yield f"For {' and '.join(worse)} the law is no better than a constant forecast."
        if not (self.exact or self.process_noise) and all(state_error.noise > 0 for state_error in known):
            names = " and ".join(state_error.state for state_error in known)
            noise = " and ".join(_number(state_error.noise, state_error.unit) for state_error in known)
            rest = " and ".join(_number(state_error.unexplained, state_error.unit) for state_error in known)
            yield f"Measurement noise of {names}: {noise}; unexplained: {rest}."

    def _bands(self) -> Iterator[str]:
        if self.coverage is None:
            yield "No bands: the law has no standard errors."
            return
        inside = f"{_percent(self.coverage)} of the measurements lie within the 95 % bands (about 95 % expected)"
        if self.coverage < _LOW_COVERAGE and self.measurements >= _MIN_FOR_COVERAGE:
            yield f"{inside}: the bands are too narrow."
        elif self.measurements >= _MIN_MEASUREMENTS:
            yield f"{inside}."

    @property
    def _predicted(self) -> list[StateError]:
        return [state_error for state_error in self.state_errors if state_error.state not in self.unpredicted]

    @property
    def _spreads(self) -> str:
        known = [state_error for state_error in self._predicted if state_error.spread > 0]
        spreads = [f"{_number(state_error.spread, state_error.unit)} in {state_error.state}" for state_error in known]
        return f" ({' and '.join(spreads)})" if spreads else ""


def _number(value: float, unit: str = "") -> str:
    return f"{value:.3g} {unit}".rstrip() if abs(value) < 1000 else f"{value:.0f} {unit}".rstrip()


def _percent(share: float) -> str:
    if 0 < share < 0.0001:
        return "less than 0.01 %"
    return f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.2g} %"


def listed(parts: Sequence[str], separator: str = ", ") -> str:
    """Return the first few, and how many more there are."""
    more = f"{separator}and {len(parts) - 3} more" if len(parts) > 3 else ""
    return separator.join(parts[:3]) + more
