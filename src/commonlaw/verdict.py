"""What a law is good for: forecasts of what was held out, their errors, and the verdict in sentences."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from math import isnan, sqrt
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.diagnostics import marked
from commonlaw.differentiation import noise_degrees_of_freedom, noise_level
from commonlaw.errors import CommonlawError
from commonlaw.forecast import Forecast, fitted
from commonlaw.forecast.initial_state import can_fit_initial_state
from commonlaw.forecast.population import is_typical, with_objects_of
from commonlaw.law import Law
from commonlaw.law.alignment import has_bands, matched, measured_noise, measured_schema
from commonlaw.law.parameters import left_hand_sides, named_parameters
from commonlaw.library import Order, highest_order
from commonlaw.outcomes import OutcomeKind
from commonlaw.runtime.notebooks import ShownInNotebooks
from commonlaw.runtime.progress import announced
from commonlaw.text import counted
from commonlaw.trials import Trial, Trials

SMALL_ERROR = 0.5
"""Forecasts are good as far ahead as their errors stay within this share of the states' spread: three quarters of the
variance are then explained."""

NO_BETTER = 0.9
"""Forecasts whose error is above this share of that of persistence are no better: of few trials, a tenth is chance."""

_MIN_MEASUREMENTS = 5
"""Fewer measurements are too few to judge by: their mean error is known to no better than half of it."""

_LOW_COVERAGE, _FAILED_COVERAGE, _MIN_FOR_COVERAGE = 0.85, 0.5, 10
"""Bands are too narrow if they hold a smaller share of measurements, and fail below the other; of so many at least.
Of ten measurements bands of 95 % hold fewer than nine by chance in nine of a hundred cases, and half never."""


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
    forecasts the last measured values.

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

    @property
    def usable(self) -> bool | None:
        """Whether the law can be used for forecasts; None if that could not be assessed."""
        return None if self.lacking else not self.against

    @property
    def lacking(self) -> str:
        """Why the law could not be assessed; empty if it was."""
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
        if not self.horizon and not self.diverged:
            result.append(
                f"even at the shortest horizon the error exceeds half of the states' standard deviation{self._spreads}"
            )
        if self._is_no_better and not self.diverged:
            result.append("the error is not below that of a constant forecast")
        if self.horizon and not self.diverged and (self.r_squared < 0 or self.r_squared < self.r_squared_error):
            error = "" if isnan(self.r_squared_error) else f" ± {self.r_squared_error:.2g}"
            whole = f"R^2 over all tested forecasts is {self.r_squared:.3g}{error}"
            ahead = _number(self.horizon, self.time_unit)
            result.append(f"beyond {ahead} ahead they are no better than the mean of the states: {whole}")
        if self.coverage is not None and self.coverage < _FAILED_COVERAGE and self.measurements >= _MIN_FOR_COVERAGE:
            result.append(f"only {_percent(self.coverage)} of the measurements lie within the 95 % bands")
        return tuple(result)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The verdict in words, what matters most first."""
        return tuple(self._sentences())

    def __str__(self) -> str:
        return "\n".join(self.sentences)

    @property
    def _is_no_better(self) -> bool:
        return self.error > NO_BETTER * self.persistence

    def _sentences(self) -> Iterator[str]:
        if self.usable is None:
            yield f"Forecast accuracy could not be assessed: {self.lacking}."
        elif self.usable:
            beyond = f"; beyond, the error exceeds half of the states' standard deviation{self._spreads}"
            end = " (longest horizon tested)" if self.horizon == self.longest else beyond
            can = "Forecasts its training data well" if self.in_sample else "This law can be used for forecasts"
            only = "" if self.exact else "; it is an approximation"
            new = " Not tested on new data." if self.in_sample else ""
            yield f"{can} up to {_number(self.horizon, self.time_unit)} ahead{end}{only}.{new}"
        else:
            yield f"Do not use this law for forecasts: {'; '.join(self.against)}."
        if self.without_terms:
            names = " and ".join(self.without_terms)
            yield f"No candidate term was selected for {names}, which the law sets to zero."
        if not self.exact:
            which = "no law in the library fits" if self.none_exact else "this law does not fit"
            yield f"Lack of fit: {which} the data within the noise."
        if self.few_samples:
            yield "An equation has the maximum number of terms that so few samples can identify."
        if self.measurements:
            if not self.diverged:
                yield from self._accuracy()
            yield from self._bands()
            compared = f"{counted(self.measurements, 'measurement')} in {counted(self.segments, 'forecast')}"
            yield f"Tested on {self.judged_on}: {compared}, each from the first samples of a trial."
            if self.unknown_objects:
                yield f"Forecasts of {listed(self.unknown_objects)} use the mean coefficients of the other objects."
        if self.poorly_known:
            yield f"Poorly identified (standard error above 50 % of the estimate): {listed(self.poorly_known)}."
        if self.not_assessable:
            yield f"Not assessed: {listed(self.not_assessable, '; ')}."
        if advice := "; ".join(self._advice()):
            yield f"Suggestions: {advice}."

    def _advice(self) -> Iterator[str]:
        if not self.exact:
            yield "add terms, or give a larger noise if it is known"
        elif self.without_terms or self.usable is False:
            yield "offer other terms, or collect more or more precise data"
        if self.few_samples or 0 < self.measurements < _MIN_MEASUREMENTS:
            yield "measure more samples or more trials"
        if self.in_sample and self.usable:
            yield "test the law on held-out or new trials"

    def _accuracy(self) -> Iterator[str]:
        known = [state_error for state_error in self.state_errors if state_error.high > state_error.low]
        own = " and ".join(each.share(each.law) for each in known)
        last = " and ".join(each.share(each.persistence, ends=False) for each in known)
        yield f"RMS forecast error: {own}; of a constant forecast: {last}."
        worse = [each.state for each in known if each.law > NO_BETTER * each.persistence]
        if worse and not self._is_no_better:
            yield f"For {' and '.join(worse)} the law is no better than a constant forecast."
        if not self.exact and all(each.noise > 0 for each in known):
            names = " and ".join(each.state for each in known)
            noise = " and ".join(_number(each.noise, each.unit) for each in known)
            rest = " and ".join(_number(each.unexplained, each.unit) for each in known)
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
    def _spreads(self) -> str:
        known = [each for each in self.state_errors if each.spread > 0]
        spreads = [f"{_number(each.spread, each.unit)} in {each.state}" for each in known]
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


_BEFORE = 0.2
"""Share of a trial, its beginning, that tells where a forecast starts: so much averages the noise of a start, and
leaves growth that has just begun to be forecast."""

_RATES = 5
"""Samples that tell the first rates at least: fewer leave them to the noise."""


class Kind(StrEnum):
    """Where a segment comes from."""

    TRIAL = "held-out trials"
    LATER = "held-out later samples"
    SEEN = "whole trials"


@dataclass(frozen=True, eq=False)
class Segment:
    """A forecast of a trial, from sample `origin` on, compared from sample `first` on; `kind` is its source."""

    trial: Trial
    origin: int
    first: int
    kind: Kind


def segments(trials: Trials, learned: Trials | None, order: Order) -> list[Segment]:
    """Return the forecasts that assess a law: from the first samples of trials, over all that follows.

    Of held-out trials or later samples, or if there are none of all trials; later samples are also forecast from the
    end of the training data.
    """
    if learned is not None:
        held_out = list(_held_out(trials, learned, order))
        if held_out:
            return held_out
    return [Segment(each, at, at, Kind.SEEN) for each in map(Trial.measured, trials) for at in origins(each, order)]


def origins(trial: Trial, order: Order) -> tuple[int, ...]:
    """Return where forecasts of a trial begin: after its first sample, if that determines a start, and its first fifth.

    A law with rates begins after the first fifth, of five samples at least.
    """
    fifth = samples_before(len(trial), order)
    if highest_order(order) == 2:
        return (fifth,)
    seen = np.isfinite(trial.states)
    whole = np.flatnonzero((seen | ~seen.any(axis=0)).all(axis=1))
    first = int(whole[0]) + 1 if len(whole) else fifth
    return tuple(sorted({first, max(first, fifth)}))


def samples_before(count: int, order: Order) -> int:
    """Return how many of the samples of a trial tell where its forecast starts, if these average the noise."""
    return max(_RATES if highest_order(order) == 2 else 1, int(np.ceil(_BEFORE * count)))


def _held_out(trials: Trials, learned: Trials, order: Order) -> Iterator[Segment]:
    ends = {(each.object, each.name): each.measured().times[-1] for each in learned}
    for trial in trials:
        measured, end = trial.measured(), ends.get((trial.object, trial.name))
        if end is None:
            for origin in origins(measured, order):
                yield Segment(measured, origin, origin, Kind.TRIAL)
        elif measured.times[-1] > end:
            first = int(np.searchsorted(measured.times, end, side="right"))
            early = [each for each in origins(measured, order) if each < first]
            for origin in (*early, first):
                yield Segment(measured, origin, first, Kind.LATER)


def forecast_errors(law: Law, trials: Trials, segment: Segment) -> tuple[pd.DataFrame, bool]:
    """Return the errors of the forecast of a segment of the only trial, and whether it diverged.

    Each measurement has a row: the index of its ``state``, the time since the last sample before (``lead``), the
    ``error`` of the forecast, infinite after a divergence, and that of ``persistence``; ``inside``, 1 where the 95 %
    band holds it, 0 where not; and ``noise``, the standard deviation of measurements without autocorrelated errors.

    The start is fitted to the samples before it.
    If the law was fitted to the whole trial, and one sample is before, the start is fitted to the first fifth: that
    sample alone may be below the noise. Raises `CommonlawError` if it cannot be forecast.
    """
    trial, origin, first, states = segment.trial, segment.origin, segment.first, len(measured_schema(law).states)
    fits = law.order != 0 and measured_noise(law) is not None
    # More samples before a forecast take long and tell little more of where it starts
    how: dict[str, Any] = {"start": 200 if fits and origin > 200 else None}
    how |= {"from_time": float(trial.times[origin])}
    if fits and segment.kind is Kind.SEEN and origin == 1:
        how = {"start": max(2, samples_before(len(trial), law.order))}
    # Far below the error of any measurement
    forecast = law.predict(trials, return_std=has_bands(law), tolerance=1e-6, **how)
    rows = np.flatnonzero(np.isfinite(forecast.trials[0].states).any(axis=1))
    compared, measured = rows[first - len(trial) :], trial.states[first:]
    errors = forecast.trajectories[0].states[compared, :states] - measured
    errors[np.isnan(errors)] = np.inf
    inside, noise = np.full((2, *errors.shape), np.nan)
    if forecast.std is not None:
        noise = forecast.measurement_std(white=True)[0][compared]
        low, high = (end[compared] for end in forecast.bands(measured=True)[0])
        held = (low <= measured) & (measured <= high)
        inside = np.where(np.isfinite(high - low) & np.isfinite(errors), held, np.nan)
    before = [column[np.isfinite(column)] for column in trial.states[:origin].T]
    last = np.array([column[-1] if len(column) else np.nan for column in before])
    cells = {"error": errors, "persistence": last - measured, "inside": inside, "noise": noise}
    samples, columns = np.nonzero(np.isfinite(measured))
    leads = (trial.times[first:] - trial.times[origin - 1])[samples]
    found = {"state": columns, "lead": leads} | {name: values[samples, columns] for name, values in cells.items()}
    return pd.DataFrame(found), bool(forecast.outcomes)


_COLUMNS = ("state", "lead", "error", "persistence", "inside", "noise", "trial", "segment")
_PARTS, _MEASURED_IN_PART = 10, 3
"""Parts of the errors, by how far ahead they are, that determine the horizon, and errors in each part at least."""

_POOR = 0.5
"""Coefficients with a standard error above this share of their size are poorly known."""


def judge(law: Law, trials: Trials, learned: Trials | None = None) -> LawVerdict:
    """Return what a law is good for, see `Law.assess`."""
    trials = matched(law, trials, observed=True)
    learned = None if learned is None else matched(law, learned, observed=True)
    judged, frames, diverged, not_assessable = list[Segment](), list[pd.DataFrame](), 0, list[str]()
    numbers = dict[tuple[str, str], int]()
    whole = {(each.object, each.name): each for each in trials}
    parts = segments(trials, learned, law.order)
    for segment in announced(parts, f"assessing {counted(len(parts), 'forecast')}", "take fewer trials"):
        trial = segment.trial
        if segment.first >= len(trial):
            not_assessable.append(f"{trial.label}: too short, with {counted(len(trial), 'sample')}")
            continue
        # Doses are given in moments in which nothing is measured
        single = trials.with_trials([whole[trial.object, trial.name] if law.schema.doses else trial])
        try:
            frame, has_diverged = forecast_errors(with_objects_of(law, single)[0], single, segment)
        except CommonlawError as error:
            not_assessable.append(error.sentence(marked))
            continue
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            not_assessable.append(str(error))
            continue
        number = numbers.setdefault((trial.object, trial.name), len(numbers))
        frames.append(frame.assign(trial=number, segment=len(judged)))
        judged.append(segment)
        diverged += has_diverged
    once = list({(each.trial.object, each.trial.name): each.trial for each in judged}.values())
    spread = _spread(once, len(measured_schema(law).states))
    errors = pd.concat(frames) if frames else pd.DataFrame(columns=_COLUMNS, dtype=np.float64)
    errors = errors[np.isfinite(spread[errors["state"].astype(int)])]
    scales = spread[errors["state"].astype(int)]
    errors = errors.assign(scaled=errors["error"] / scales)
    kinds = [each.kind for each in judged]
    known = {diagnostic.kind for diagnostic in law.diagnostics}
    is_inexact = not known.isdisjoint({OutcomeKind.MODEL_ERROR, OutcomeKind.APPROXIMATION})
    measurements = errors.groupby(["trial", "segment"]).size().groupby("trial").max().sum()
    return LawVerdict(
        judged_on=" and ".join(dict.fromkeys(kinds)),
        in_sample=Kind.SEEN in kinds and law.provenance.is_learned,
        segments=len(judged),
        diverged=diverged,
        measurements=int(measurements),
        horizon=_horizon(errors["lead"].to_numpy(), errors["scaled"].to_numpy()),
        longest=float(np.max(errors["lead"].to_numpy(), initial=0.0)),
        time_unit=trials.schema.units.get(trials.schema.time, f"units of {trials.schema.time}"),
        error=_rms(errors["scaled"]),
        persistence=_rms(errors["persistence"] / scales),
        r_squared=_r_squared(errors),
        r_squared_error=_r_squared_error(errors, len(numbers)),
        state_errors=_by_state(trials, once, errors, spread, OutcomeKind.APPROXIMATION in known),
        coverage=float(errors["inside"].mean()) if errors["inside"].notna().any() else None,
        poorly_known=_poorly_known(law),
        not_assessable=tuple(dict.fromkeys(not_assessable)),
        unknown_objects=tuple(dict.fromkeys(each.object for each in once if is_typical(law, each.object, trials))),
        exact=not (is_inexact or law.uncertainty.error_model.of_law),
        none_exact=is_inexact and bool(law.provenance.alternatives),
        few_samples=OutcomeKind.FEW_SAMPLES in known,
        without_terms=tuple(
            diagnostic.where for diagnostic in law.diagnostics if diagnostic.kind is OutcomeKind.EMPTY_SUPPORT
        ),
    )


def _by_state(
    trials: Trials, judged: Sequence[Trial], errors: pd.DataFrame, spread: Floats, approximate: bool
) -> tuple[StateError, ...]:
    """Return the errors of each state, with the measured range.

    The noise of an approximation includes its lack of fit: there the difference-based estimate is taken, if less.
    """
    schema, result = trials.schema, list[StateError]()
    dense = [each for each in judged if approximate and each.complete and noise_degrees_of_freedom(len(each))]
    differences = np.array([noise_level(each.times, each.states) for each in dense] or [spread * np.nan])
    for name in schema.measured:
        j = schema.states.index(name)
        of_state = errors[errors["state"] == j]
        values = np.concatenate([[np.nan], *(each.states[:, j] for each in judged)])
        values = values[np.isfinite(values)]
        result.append(
            StateError(
                name,
                _rms(of_state["error"]),
                _rms(of_state["persistence"]),
                schema.units.get(name, ""),
                float(np.fmin(_rms(of_state["noise"]), _rms(differences[:, j]))),
                float(spread[j]),
                float(np.min(values, initial=np.inf)),
                float(np.max(values, initial=-np.inf)),
            )
        )
    return tuple(result)


def _spread(trials: Sequence[Trial], states: int) -> Floats:
    """Return the standard deviation of each state within trials, shape (states,); NaN for one that does not change."""
    squares, counts = np.zeros(states), np.zeros(states)
    for trial in trials:
        seen = np.isfinite(trial.states)
        means = np.nansum(trial.states, axis=0) / np.maximum(seen.sum(axis=0), 1)
        squares, counts = squares + np.nansum((trial.states - means) ** 2, axis=0), counts + seen.sum(axis=0)
    return np.sqrt(np.where(squares > 0, squares, np.nan) / np.maximum(counts, 1))


def _horizon(leads: Floats, scaled: Floats) -> float:
    """Return how far ahead errors, relative to the spread, stay within bounds; 0 if they do not."""
    order = np.argsort(leads, kind="stable")
    nearest = order[leads[order] == np.min(leads, initial=np.inf)]
    horizon = 0.0
    for part in (nearest, *np.array_split(order, max(1, min(_PARTS, len(order) // _MEASURED_IN_PART)))):
        if not len(part) or not _rms(scaled[part]) <= SMALL_ERROR:
            break
        horizon = float(leads[part[-1]])
    return horizon


def _rms(values: ArrayLike) -> float:
    known = np.asarray(values, dtype=np.float64)
    known = known[~np.isnan(known)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def _r_squared(errors: pd.DataFrame) -> float:
    """Return the mean of R^2 over states of all forecasts; NaN if there are none."""
    by_state = [1 - _rms(scaled) ** 2 for _, scaled in errors.groupby("state")["scaled"]]
    return float(np.mean(by_state)) if by_state else float("nan")


def _r_squared_error(errors: pd.DataFrame, trials: int) -> float:
    """Return the standard error of R^2 by leaving out each trial in turn (jackknife); NaN of a single trial."""
    if trials < 2:
        return float("nan")
    without = np.array([_r_squared(errors[errors["trial"] != number]) for number in range(trials)])
    with np.errstate(invalid="ignore"):  # Of forecasts that diverge
        return float(np.sqrt((trials - 1) * np.mean((without - np.mean(without)) ** 2)))


def _poorly_known(law: Law) -> tuple[str, ...]:
    """Return the coefficients with large errors, with the terms that they stand before and the objects they are of."""
    result, lefts, parameters = [], left_hand_sides(law), named_parameters(law)
    for each, values, errors in zip(parameters.definitions, parameters.values.T, parameters.errors.T, strict=True):
        poor = np.flatnonzero(errors > _POOR * np.abs(values))
        if len(poor):
            where = f"{lefts[each.equation]}, before {law.terms.factors[each.term]}"
            some = [law.objects[i] for i in poor]
            of = "" if len(poor) == len(law.objects) else f", of {listed(some)}"
            # The equations of an explained law have parameters of their own
            result.append(f"{each.name if law.uncertainty.explanation is None else 'a coefficient'} ({where}{of})")
    return tuple(result)


T = TypeVar("T")


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
    fitting = partial(fitted, law, training, bands)
    fit = _tried("the law has no fitted curves", fitting, lacking) if law.order != 0 else None
    verdict = _tried("the forecast assessment failed", partial(judge, law, whole, training), lacking)
    # Held-out trials, or if there are none of the objects of the law, the training data
    learned_from = _names(training)
    others = [each for each in whole if (each.object, each.name) not in learned_from]
    held_out = [each for each in others if each.object in law.objects]
    checked = whole.with_trials(held_out or [each for each in whole if (each.object, each.name) in learned_from])
    start = samples_before(min(map(len, checked)), law.order) if can_fit_initial_state(law) or law.observation else None
    checking = partial(law.predict, checked, return_std=bands, start=start)
    forecast = _tried("the law was not checked by forecasts", checking, lacking)
    if verdict is not None and verdict.usable is not None:
        horizon = verdict.horizon if verdict.usable else 0.0
        domain = replace(law.provenance.domain, horizon=horizon, judged=verdict.longest)
        law = replace(law, provenance=replace(law.provenance, domain=domain))
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
    return {(trial.object, trial.name) for trial in trials}
