"""What a law is good for: forecasts of what was held out of its fit, and their errors."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.diagnostics import OutcomeKind, marked
from commonlaw.differentiation import noise_degrees_of_freedom, noise_level, outliers_among, outliers_of_window
from commonlaw.errors import CommonlawError
from commonlaw.forecast import Forecast, fitted
from commonlaw.forecast.forecast import variation
from commonlaw.forecast.initial_state import can_fit_initial_state
from commonlaw.forecast.schemes import scheme_of
from commonlaw.law import Law
from commonlaw.law.alignment import matched
from commonlaw.law.parameters import left_hand_sides, named_parameters
from commonlaw.law.population import is_typical, with_objects_of
from commonlaw.law.verdict import NO_BETTER, SMALL_ERROR, LawVerdict, StateError, listed
from commonlaw.library import Order, highest_order
from commonlaw.runtime.progress import announced
from commonlaw.text import counted
from commonlaw.trials import Trial, Trials
from commonlaw.trials.trial import property_names


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
    return [Segment(trial, at, at, Kind.SEEN) for trial in map(Trial.measured, trials) for at in origins(trial, order)]


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
    """Return how many of the samples of a trial tell where its forecast starts, if these average the noise.

    A fifth leaves growth that has just begun to be forecast. Fewer than five samples leave rates to the noise.
    """
    return max(5 if highest_order(order) == 2 else 1, int(np.ceil(0.2 * count)))


def _held_out(trials: Trials, learned: Trials, order: Order) -> Iterator[Segment]:
    ends = {(trial.object, trial.name): trial.measured().times[-1] for trial in learned}
    for trial in trials:
        measured, end = trial.measured(), ends.get((trial.object, trial.name))
        if end is None or measured.times[0] > end:
            kind = Kind.TRIAL if end is None else Kind.LATER
            yield from (Segment(measured, origin, origin, kind) for origin in origins(measured, order))
        elif measured.times[-1] > end:
            first = int(np.searchsorted(measured.times, end, side="right"))
            early = [origin for origin in origins(measured, order) if origin < first]
            for origin in (*early, first):
                yield Segment(measured, origin, first, Kind.LATER)


def forecast_errors(law: Law, trials: Trials, segment: Segment) -> tuple[pd.DataFrame, bool]:
    """Return the errors of the forecast of a segment of the only trial, and whether it diverged.

    Each measurement has a row: the index of its ``state``, the time since the last sample before (``lead``), the
    ``row`` of its sample, the ``error`` of the forecast, infinite after a divergence, and that of ``persistence``;
    ``inside``, 1 where the 95 %
    band holds it, 0 where not; and ``noise``, the standard deviation of measurements without autocorrelated errors.

    The start is fitted to the samples before it.
    If the law was fitted to the whole trial, and one sample is before, the start is fitted to the first fifth: that
    sample alone may be below the noise. Raises `CommonlawError` if it cannot be forecast.
    """
    trial, origin, first, states = segment.trial, segment.origin, segment.first, len(law.observation.measured.states)
    fits = law.order != 0 and law.uncertainty.noise is not None
    # More samples before a forecast take long and tell little more of where it starts
    how: dict[str, Any] = {"start": 200 if fits and origin > 200 else None}
    how |= {"from_time": float(trial.times[origin])}
    if not any(map(scheme_of(law, property_names(trials.properties)).free_starts, trials)):
        how = {}
    elif fits and segment.kind is Kind.SEEN and origin == 1:
        how = {"start": max(2, samples_before(len(trial), law.order))}
    # Far below the error of any measurement
    forecast = law.predict(trials, return_std=law.uncertainty.has_std, tolerance=1e-6, **how)
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
    table = {"state": columns, "row": first + samples, "lead": leads}
    table |= {name: values[samples, columns] for name, values in cells.items()}
    return pd.DataFrame(table), bool(forecast.outcomes)


_COLUMNS = ("state", "row", "lead", "error", "persistence", "inside", "noise", "trial", "segment")


def assess(law: Law, trials: Trials, learned: Trials | None = None) -> LawVerdict:
    """Return what a law is good for, see `Law.assess`."""
    trials = matched(law, trials)
    learned = None if learned is None else matched(law, learned)
    judged, frames, diverged = list[Segment](), list[pd.DataFrame](), 0
    strange = [name for name in law.provenance.domain.strange if name not in law.objects]
    not_assessable = [f"{name}: left out of the law, as it does not follow it" for name in strange]
    numbers = dict[tuple[str, str], int]()
    whole = {(trial.object, trial.name): trial for trial in trials}
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
    once = list({(segment.trial.object, segment.trial.name): segment.trial for segment in judged}.values())
    errors = pd.concat(frames) if frames else pd.DataFrame(columns=_COLUMNS, dtype=np.float64)
    values = [_without_outliers(law, trial, errors[errors["trial"] == i]) for i, trial in enumerate(once)]
    places, count = errors[["trial", "row", "state"]].astype(int).to_numpy(), len(law.observation.measured.states)
    begins = np.cumsum([0, *map(len, values)])[places[:, 0]]
    is_far = np.isnan(np.concatenate([np.empty((0, count)), *values])[begins + places[:, 1], places[:, 2]])
    spread = _spread(values, count)
    compared = errors[np.isfinite(spread[errors["state"].astype(int)])]
    measurements = compared.groupby(["trial", "segment"]).size().groupby("trial").max().sum()
    errors = errors[~is_far]
    errors = errors[np.isfinite(spread[errors["state"].astype(int)])]
    errors = errors.assign(scaled=errors["error"] / spread[errors["state"].astype(int)])
    errors = errors.assign(still=errors["persistence"] / spread[errors["state"].astype(int)])
    by_state = {j: part for j in range(len(spread)) if len(part := errors[errors["state"] == j])}
    reach = {j: _horizon(*part[["lead", "scaled"]].to_numpy().T) for j, part in by_state.items()}
    unpredicted = [
        j
        for j, part in by_state.items()
        if not reach[j] and any(reach.values()) and _rms(part["scaled"]) > NO_BETTER * min(1, _rms(part["still"]))
    ]
    predicted = errors[~errors["state"].isin(unpredicted)]
    kinds = [segment.kind for segment in judged]
    known = {diagnostic.kind for diagnostic in law.diagnostics}
    process_noise = law.uncertainty.error_model.of_law
    is_inexact = process_noise or not known.isdisjoint({OutcomeKind.MODEL_ERROR, OutcomeKind.APPROXIMATION})
    in_sample = Kind.SEEN in kinds and law.provenance.is_learned
    horizon = _horizon(predicted["lead"].to_numpy(), predicted["scaled"].to_numpy())
    near = predicted[predicted["lead"] <= horizon]
    return LawVerdict(
        judged_on=" and ".join(dict.fromkeys(kinds)),
        in_sample=in_sample,
        segments=len(judged),
        diverged=diverged,
        measurements=int(measurements),
        horizon=horizon,
        longest=float(np.max(errors["lead"].to_numpy(), initial=0.0)),
        time_unit=trials.schema.units.get(trials.schema.time, f"units of {trials.schema.time}"),
        error=_rms(predicted["scaled"]),
        persistence=_rms(predicted["still"]),
        r_squared=_r_squared(predicted),
        r_squared_error=_r_squared_error(predicted, len(numbers)),
        error_within=_rms(near["scaled"]),
        persistence_within=_rms(near["still"]),
        outliers=len(np.unique(places[is_far], axis=0)),
        state_errors=_by_state(trials, once, values, errors, spread, OutcomeKind.APPROXIMATION in known),
        coverage=float(errors["inside"].mean()) if errors["inside"].notna().any() else None,
        poorly_known=_poorly_known(law),
        not_assessable=tuple(dict.fromkeys(not_assessable)),
        unknown_objects=tuple(dict.fromkeys(trial.object for trial in once if is_typical(law, trial.object, trials))),
        exact=not is_inexact,
        process_noise=process_noise,
        none_exact=is_inexact and bool(law.provenance.alternatives),
        few_samples=OutcomeKind.FEW_SAMPLES in known,
        without_terms=tuple(
            diagnostic.where for diagnostic in law.diagnostics if diagnostic.kind is OutcomeKind.EMPTY_SUPPORT
        ),
        unpredicted=tuple(trials.schema.states[j] for j in unpredicted),
        unknowns=_unknowns(law, trials) if in_sample else 0,
        training_measurements=sum(int(np.isfinite(trial.states).sum()) for trial in trials) if in_sample else 0,
    )


def _without_outliers(law: Law, trial: Trial, errors: pd.DataFrame) -> Floats:
    """Return the measurements of a trial, shape (n, states), NaN for outliers beyond the noise of the law's forecasts.

    By differences of the measurements, so that nothing that a law misses is one. Of a law whose fit has outliers these
    may be many, or near an end: there are also those whose errors do not fit in with the errors of their neighbours.
    None where outliers are most, and of least squares.
    """
    values, misfit = trial.states.copy(), law.uncertainty.misfit
    if law.uncertainty.huber_threshold == np.inf:
        return values
    for j in errors["state"].astype(int).unique().tolist():
        of_state, seen = errors[errors["state"] == j], np.isfinite(trial.states[:, j])
        noise, far = float(of_state["noise"].median()), np.zeros(len(seen), dtype=np.bool_)
        far[seen] = outliers_among(trial.times[seen], trial.states[seen, j], noise)
        for _, forecast in of_state.groupby("segment") if misfit is not None and misfit.outliers else ():
            rows, sizes = forecast[["row", "error"]].to_numpy().T
            far[rows.astype(int)] |= outliers_of_window(sizes, noise)
        if 2 * far.sum() < seen.sum():
            values[far, j] = np.nan
    return values


def _unknowns(law: Law, trials: Trials) -> int:
    """Return how many parameters and initial values of trials were estimated; what objects share counts once."""
    parameters = named_parameters(law)
    is_free = (parameters.errors > 0) | parameters.limited
    listed = zip(parameters.values.T, is_free.T, strict=True)
    count = sum(len(np.unique(values[free])) for values, free in listed)
    return count + sum(map(scheme_of(law, property_names(trials.properties)).free_starts, trials))


def _by_state(
    trials: Trials,
    judged: Sequence[Trial],
    measured: Sequence[Floats],
    errors: pd.DataFrame,
    spread: Floats,
    approximate: bool,
) -> tuple[StateError, ...]:
    """Return the errors of each state, with the measured range, without outliers.

    The noise of an approximation includes its lack of fit: there the difference-based estimate is taken, if less.
    """
    schema, result = trials.schema, list[StateError]()
    dense = [trial for trial in judged if approximate and trial.complete and noise_degrees_of_freedom(len(trial))]
    differences = np.array([noise_level(trial.times, trial.states) for trial in dense] or [spread * np.nan])
    for name in schema.measured:
        j = schema.states.index(name)
        of_state = errors[errors["state"] == j]
        values = np.concatenate([[np.nan], *(states[:, j] for states in measured)])
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


def _spread(measured: Sequence[Floats], states: int) -> Floats:
    """Return the standard deviation of each state within trials, shape (states,); NaN for one that does not change."""
    sums = [np.zeros((2, states)), *(np.array(variation(values)) for values in measured)]
    counts, squares = np.sum(sums, axis=0)
    return np.asarray(np.sqrt(np.where(squares > 0, squares, np.nan) / np.maximum(counts, 1)))


def _horizon(leads: Floats, scaled: Floats) -> float:
    """Return how far ahead errors, relative to the spread, stay within bounds; 0 if they do not.

    They are judged in ten parts by how far ahead they are, of three errors at least, and first those that are nearest.
    """
    order = np.argsort(leads, kind="stable")
    nearest = order[: max(3, int(np.sum(leads == np.min(leads, initial=np.inf))))]
    horizon = 0.0
    for part in (nearest, *np.array_split(order, max(1, min(10, len(order) // 3)))):
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
    """Return coefficients with errors above half of their size, the terms that they stand before, and their objects."""
    result, lefts, parameters = [], left_hand_sides(law), named_parameters(law)
    for definition, values, errors in zip(
        parameters.definitions, parameters.values.T, parameters.errors.T, strict=True
    ):
        poor = np.flatnonzero(errors > 0.5 * np.abs(values))
        if len(poor):
            where = f"{lefts[definition.equation]}, before {law.terms.factors[definition.term]}"
            some = [law.objects[i] for i in poor]
            of = "" if len(poor) == len(law.objects) else f", of {listed(some)}"
            # The equations of an explained law have parameters of their own
            result.append(
                f"{definition.name if law.uncertainty.explanation is None else 'a coefficient'} ({where}{of})"
            )
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
    failures
        Why there is no verdict or no forecast.
    """

    law: Law
    trials: Trials
    training: Trials
    verdict: LawVerdict | None = None
    fit: Forecast | None = None
    forecast: Forecast | None = None
    start: int | None = None
    failures: tuple[str, ...] = ()

    @property
    def shown(self) -> Forecast | None:
        """What is shown first: the fit, or forecasts if there is none."""
        return self.fit or self.forecast

    @property
    def curves(self) -> tuple[Forecast, ...]:
        """The fit and the forecasts, as far as there are any."""
        return tuple(curves for curves in (self.fit, self.forecast) if curves is not None)

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
        return self.failures if self.verdict is None else self.verdict.sentences

    @property
    def is_exact(self) -> bool:
        """Whether the law, with its process noise, leaves no more than errors of measurement, as far as judged."""
        return self.verdict is None or self.verdict.exact or self.verdict.process_noise


def find(law: Law, trials: Trials, learned: Trials | None = None, bands: bool = True) -> Findings:
    """Assess a law and check it by forecasts; what fails is noted in `Findings.failures`.

    The law was fitted to `learned`, by default all trials; `bands` says whether forecasts have bands. Raises
    `CommonlawError` if the trials do not have the variables of the law.
    """
    whole = matched(law, trials)
    training = whole if learned is None or learned is trials else matched(law, learned)
    failures = list[str]()
    bands = bands and law.uncertainty.has_std
    fitting = partial(fitted, law, training, bands)
    fit = _tried("the law has no fitted curves", fitting, failures) if law.order != 0 else None
    verdict = _tried("the forecast assessment failed", partial(assess, law, whole, training), failures)
    # Held-out trials, or if there are none of the objects of the law, the training data
    learned_from = _names(training)
    others = [trial for trial in whole if (trial.object, trial.name) not in learned_from]
    held_out = [trial for trial in others if trial.object in law.objects]
    checked = whole.with_trials(held_out or [trial for trial in whole if (trial.object, trial.name) in learned_from])
    fewest = min(len(trial.measured()) for trial in checked)
    has_starts = any(map(scheme_of(law, property_names(checked.properties)).free_starts, checked))
    start = samples_before(fewest, law.order) if can_fit_initial_state(law) and has_starts else None
    checking = partial(law.predict, checked, return_std=bands, start=start)
    forecast = _tried("the law was not checked by forecasts", checking, failures)
    if verdict is not None and verdict.usable is not None:
        horizon = verdict.horizon if verdict.usable else 0.0
        domain = replace(law.provenance.domain, horizon=horizon, judged=verdict.longest)
        law = replace(law, provenance=replace(law.provenance, domain=domain))
    return Findings(law, whole, training, verdict, fit, forecast, start, tuple(failures))


def _tried(failure: str, step: Callable[[], T], failures: list[str]) -> T | None:
    """Return what a step gives; if it cannot, None, and add why."""
    try:
        return step()
    except CommonlawError as error:
        failures.append(f"{failure}: {error.sentence(marked)}")
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        failures.append(f"{failure}: {type(error).__name__}: {error}")
    return None


def _names(trials: Trials) -> set[tuple[str, str]]:
    return {(trial.object, trial.name) for trial in trials}
