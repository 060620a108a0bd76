"""What was held out of a fit, forecast from the first samples of trials, and judged."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.diagnostics import marked
from commonlaw.differentiation import noise_degrees_of_freedom, noise_level
from commonlaw.errors import CommonlawError
from commonlaw.forecast.population import is_typical, with_objects_of
from commonlaw.law import Law
from commonlaw.law.alignment import has_bands, matched, measured_noise, measured_schema
from commonlaw.law.parameters import left_hand_sides, named_parameters
from commonlaw.library import Order, highest_order
from commonlaw.outcomes import OutcomeKind
from commonlaw.runtime.progress import announced
from commonlaw.text import counted
from commonlaw.trials import Trial, Trials
from commonlaw.verdict.law_verdict import SMALL_ERROR, LawVerdict, StateError, listed

_BEFORE = 0.2
"""Share of a trial, its beginning, that tells where a forecast starts: so much averages the noise of a start, and
leaves growth that has just begun to be forecast."""

_RATES = 5
"""Samples that tell the first rates at least: fewer leave them to the noise."""

_MAX_SAMPLES_BEFORE = 200
"""So many samples before a forecast tell where it starts, as more take long and add little."""

_TOLERANCE = 1e-6
"""Relative error of a step, far below that of any measurement."""


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


@dataclass(frozen=True, eq=False)
class SegmentErrors:
    """The errors of the forecast of a segment.

    `leads` are times since the last sample before, shape (n,). Errors of the forecast and of persistence have shape (n,
    states), infinite after a divergence, NaN where nothing was measured; so has `inside`, 1 where the 95 % band holds
    the measurement, 0 where not, and `noise`, the standard deviation of measurements without autocorrelated errors.
    """

    leads: Floats
    errors: Floats
    persistence: Floats
    inside: Floats
    noise: Floats
    diverged: bool


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


def forecast_errors(law: Law, trials: Trials, segment: Segment) -> SegmentErrors:
    """Return the errors of the forecast of a segment of the only trial, its start fitted to the samples before.

    If the law was fitted to the whole trial, and one sample is before, the start is fitted to the first fifth: that
    sample alone may be below the noise. Raises `CommonlawError` if it cannot be forecast.
    """
    trial, origin, first, states = segment.trial, segment.origin, segment.first, len(measured_schema(law).states)
    fits = law.order != 0 and measured_noise(law) is not None
    how: dict[str, Any] = {"start": _MAX_SAMPLES_BEFORE if fits and origin > _MAX_SAMPLES_BEFORE else None}
    how |= {"from_time": float(trial.times[origin])}
    if fits and segment.kind is Kind.SEEN and origin == 1:
        how = {"start": max(2, samples_before(len(trial), law.order))}
    forecast = law.predict(trials, return_std=has_bands(law), tolerance=_TOLERANCE, **how)
    rows = np.flatnonzero(np.isfinite(forecast.trials[0].states).any(axis=1))
    compared, measured = rows[first - len(trial) :], trial.states[first:]
    errors = forecast.trajectories[0].states[compared, :states] - measured
    diverged = bool(forecast.outcomes)
    errors[np.isnan(errors) & np.isfinite(measured)] = np.inf
    inside, noise = np.full((2, *errors.shape), np.nan)
    if forecast.std is not None:
        noise = np.where(np.isfinite(measured), forecast.measurement_std(white=True)[0][compared], np.nan)
        low, high = (end[compared] for end in forecast.bands(measured=True)[0])
        held = (low <= measured) & (measured <= high)
        inside = np.where(np.isfinite(high - low) & np.isfinite(errors), held, np.nan)
    leads = trial.times[first:] - trial.times[origin - 1]
    return SegmentErrors(leads, errors, _last(trial.states[:origin]) - measured, inside, noise, diverged)


def _last(states: Floats) -> Floats:
    """Return the last measured value of each state, shape (states,); NaN where there is none."""
    found = [column[np.isfinite(column)] for column in states.T]
    return np.array([column[-1] if len(column) else np.nan for column in found])


_PARTS, _MEASURED_IN_PART = 10, 3
"""Parts of the errors, by how far ahead they are, that determine the horizon, and errors in each part at least."""

_POOR = 0.5
"""Coefficients with a standard error above this share of their size are poorly known."""


def judge(law: Law, trials: Trials, learned: Trials | None = None) -> LawVerdict:
    """Return what a law is good for, see `Law.assess`."""
    trials = matched(law, trials, observed=True)
    learned = None if learned is None else matched(law, learned, observed=True)
    judged, found, unjudged = list[Segment](), list[SegmentErrors](), list[str]()
    whole = {(each.object, each.name): each for each in trials}
    parts = segments(trials, learned, law.order)
    for segment in announced(parts, f"assessing {counted(len(parts), 'forecast')}", "take fewer trials"):
        trial = segment.trial
        if segment.first >= len(trial):
            unjudged.append(f"{trial.label}: too short, with {counted(len(trial), 'sample')}")
            continue
        # Doses are given in moments in which nothing is measured
        single = trials.with_trials([whole[trial.object, trial.name] if law.schema.doses else trial])
        try:
            found.append(forecast_errors(with_objects_of(law, single)[0], single, segment))
        except CommonlawError as error:
            unjudged.append(error.sentence(marked))
            continue
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            unjudged.append(str(error))
            continue
        judged.append(segment)
    once = list({(each.trial.object, each.trial.name): each.trial for each in judged}.values())
    spread = _spread(once, len(measured_schema(law).states))
    errors = _joined(found, spread)
    horizon = _horizon(errors.leads, errors.errors / spread)
    kinds = [each.kind for each in judged]
    known, inexact = {each.kind for each in law.diagnostics}, {OutcomeKind.MODEL_ERROR, OutcomeKind.APPROXIMATION}
    return LawVerdict(
        judged_on=" and ".join(dict.fromkeys(kinds)),
        in_sample=Kind.SEEN in kinds and law.provenance.is_learned,
        segments=len(found),
        diverged=sum(each.diverged for each in found),
        measurements=_compared(judged, np.isfinite(spread)),
        horizon=horizon,
        longest=float(np.max(errors.leads[~np.isnan(errors.errors).all(axis=1)], initial=0.0)),
        time_unit=trials.schema.units.get(trials.schema.time, f"units of {trials.schema.time}"),
        error=_rms(errors.errors / spread),
        persistence=_rms(errors.persistence / spread),
        r_squared=_r_squared(found, spread),
        r_squared_error=_r_squared_error(judged, found, spread),
        state_errors=_by_state(trials, once, errors, spread, OutcomeKind.APPROXIMATION in known),
        coverage=float(np.nanmean(errors.inside)) if np.isfinite(errors.inside).any() else None,
        poorly_known=_poorly_known(law),
        unjudged=tuple(dict.fromkeys(unjudged)),
        unknown_objects=tuple(dict.fromkeys(each.object for each in once if is_typical(law, each.object, trials))),
        exact=not (inexact & known or law.uncertainty.error_model.of_law),
        none_exact=bool(inexact & known and law.provenance.alternatives),
        few_samples=OutcomeKind.FEW_SAMPLES in known,
        without_terms=tuple(each.where for each in law.diagnostics if each.kind is OutcomeKind.EMPTY_SUPPORT),
    )


def _compared(judged: Sequence[Segment], states: Bools) -> int:
    """Return how many measurements of these states are compared with forecasts, each of them once."""
    seen = {(each.trial.object, each.trial.name): 0 for each in judged}
    for each in judged:
        key = each.trial.object, each.trial.name
        seen[key] = max(seen[key], int(np.isfinite(each.trial.states[each.first :, states]).sum()))
    return sum(seen.values())


def _by_state(
    trials: Trials, judged: Sequence[Trial], errors: SegmentErrors, spread: Floats, approximate: bool
) -> tuple[StateError, ...]:
    """Return the errors of each state, with the measured range.

    The noise of an approximation includes its lack of fit: there the difference-based estimate is taken, if less.
    """
    schema, found = trials.schema, list[StateError]()
    dense = [each for each in judged if approximate and each.complete and noise_degrees_of_freedom(len(each))]
    differences = np.array([noise_level(each.times, each.states) for each in dense] or [spread * np.nan])
    for name in schema.measured:
        j = schema.states.index(name)
        values = np.concatenate([[np.nan], *(each.states[:, j] for each in judged)])
        values = values[np.isfinite(values)]
        found.append(
            StateError(
                name,
                _rms(errors.errors[:, j]),
                _rms(errors.persistence[:, j]),
                schema.units.get(name, ""),
                float(np.fmin(_rms(errors.noise[:, j]), _rms(differences[:, j]))),
                float(spread[j]),
                float(np.min(values, initial=np.inf)),
                float(np.max(values, initial=-np.inf)),
            )
        )
    return tuple(found)


def _spread(trials: Sequence[Trial], states: int) -> Floats:
    """Return the standard deviation of each state within trials, shape (states,); NaN for one that does not change."""
    squares, counts = np.zeros(states), np.zeros(states)
    for each in trials:
        seen = np.isfinite(each.states)
        means = np.nansum(each.states, axis=0) / np.maximum(seen.sum(axis=0), 1)
        squares, counts = squares + np.nansum((each.states - means) ** 2, axis=0), counts + seen.sum(axis=0)
    return np.sqrt(np.where(squares > 0, squares, np.nan) / np.maximum(counts, 1))


def _joined(found: Sequence[SegmentErrors], spread: Floats) -> SegmentErrors:
    """Return the errors of all segments, those of states without a spread left out."""
    kept, none = np.where(np.isnan(spread), np.nan, 1.0), np.empty((0, len(spread)))
    return SegmentErrors(
        np.concatenate([np.empty(0), *(each.leads for each in found)]),
        kept * np.concatenate([none, *(each.errors for each in found)]),
        kept * np.concatenate([none, *(each.persistence for each in found)]),
        kept * np.concatenate([none, *(each.inside for each in found)]),
        kept * np.concatenate([none, *(each.noise for each in found)]),
        any(each.diverged for each in found),
    )


def _horizon(leads: Floats, scaled: Floats) -> float:
    """Return how far ahead errors, relative to the spread, shape (n, states), stay within bounds; 0 if they do not."""
    rows, columns = np.nonzero(~np.isnan(scaled))
    order = np.argsort(leads[rows], kind="stable")
    nearest = order[leads[rows[order]] == np.min(leads[rows], initial=np.inf)]
    horizon = 0.0
    for part in (nearest, *np.array_split(order, max(1, min(_PARTS, len(order) // _MEASURED_IN_PART)))):
        if not len(part) or not _rms(scaled[rows[part], columns[part]]) <= SMALL_ERROR:
            break
        horizon = float(leads[rows[part[-1]]])
    return horizon


def _rms(values: Floats) -> float:
    known = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def _r_squared(found: Sequence[SegmentErrors], spread: Floats) -> float:
    """Return the mean of R^2 over states of all forecasts; NaN if there are none."""
    known = [_rms(column) for column in (_joined(found, spread).errors / spread).T if not np.isnan(column).all()]
    return float(np.mean([1 - each**2 for each in known])) if known else float("nan")


def _r_squared_error(judged: Sequence[Segment], found: Sequence[SegmentErrors], spread: Floats) -> float:
    """Return the standard error of R^2 by leaving out each trial in turn (jackknife); NaN of a single trial."""
    names = [(each.trial.object, each.trial.name) for each in judged]
    trials = list(dict.fromkeys(names))
    if len(trials) < 2:
        return float("nan")
    pairs = list(zip(names, found, strict=True))
    left = np.array([_r_squared([each for name, each in pairs if name != out], spread) for out in trials])
    with np.errstate(invalid="ignore"):  # Of forecasts that diverge
        return float(np.sqrt((len(trials) - 1) * np.mean((left - np.mean(left)) ** 2)))


def _poorly_known(law: Law) -> tuple[str, ...]:
    """Return the coefficients with large errors, with the terms that they stand before and the objects they are of."""
    found = []
    lefts = left_hand_sides(law)
    parameters = named_parameters(law)
    for each, values, errors in zip(
        parameters.definitions, *(part.T for part in (parameters.values, parameters.errors)), strict=True
    ):
        poor = np.flatnonzero(errors > _POOR * np.abs(values))
        if len(poor):
            where = f"{lefts[each.equation]}, before {law.terms.factors[each.term]}"
            some = [law.objects[i] for i in poor]
            of = "" if len(poor) == len(law.objects) else f", of {listed(some)}"
            # The equations of an explained law have letters of their own
            found.append(f"{each.name if law.uncertainty.explanation is None else 'a coefficient'} ({where}{of})")
    return tuple(found)
