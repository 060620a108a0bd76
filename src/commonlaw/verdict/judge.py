"""From a law and trials to a verdict: forecasts of segments, and what they are off together."""

from collections.abc import Sequence

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.effort import announced
from commonlaw.errors import CommonlawError
from commonlaw.law import Law
from commonlaw.law.meeting import matched
from commonlaw.law.population import is_typical, law_of
from commonlaw.law.verdict import LawVerdict, StateError, listed
from commonlaw.outcomes import OutcomeKind
from commonlaw.trials import Trial, Trials
from commonlaw.verdict.segments import Kind, SegmentErrors, forecast_errors, segments

_WITHIN = 0.5
"""Errors within this share of the states' spread count as forecasts."""

_PARTS, _MEASURED_IN_PART = 10, 3
"""How far ahead forecasts are good is told from the errors in so many parts, by how far ahead, of so many each."""

_POOR = 0.5
"""Coefficients with a standard error above this share of their size are poorly known."""


def judge(law: Law, trials: Trials, learned: Trials | None = None) -> LawVerdict:
    """Return what a law is good for, see `Law.verdict`."""
    trials, learned = matched(law, trials), None if learned is None else matched(law, learned)
    kinds, judged, found, unjudged = [], [], [], []
    parts = segments(trials, learned)
    for segment in announced(parts, f"judging the law by forecasts of {len(parts)} trials", "take fewer trials"):
        trial = segment.trial
        if segment.first >= len(trial):
            unjudged.append(f"{trial.label}: its {len(trial)} samples are too few")
            continue
        single = trials.with_trials([trial])
        try:
            found.append(forecast_errors(law_of(law, single)[0], single, segment))
        except (CommonlawError, ArithmeticError, np.linalg.LinAlgError) as error:
            unjudged.append(str(error))
            continue
        kinds.append(segment.kind)
        judged.append(trial)
    spread = _spread(judged, len(law.states))
    errors = _joined(found, spread)
    horizon = _horizon(errors.leads, errors.errors / spread)
    near = errors.leads <= (horizon or np.inf)
    own, last, noise = errors.errors[near], errors.persistence[near], errors.noise[near]
    units = [trials.schema.units.get(name, "") for name in law.states]
    told = {each.kind for each in law.outcomes}
    counted = ~np.isnan(errors.errors)
    return LawVerdict(
        judged_on=" and ".join(dict.fromkeys(kinds)),
        in_sample=Kind.SEEN in kinds and law.provenance.is_learned,
        segments=len(found),
        diverged=sum(each.diverged for each in found),
        measurements=int(counted.sum()),
        horizon=horizon,
        longest=float(np.max(errors.leads[counted.any(axis=1)], initial=0.0)),
        time_unit=trials.schema.units.get(trials.schema.time, f"units of {trials.schema.time}"),
        error=_rms(own / spread),
        persistence=_rms(last / spread),
        r_squared=_r_squared(errors.errors / spread),
        state_errors=tuple(map(StateError, law.states, map(_rms, own.T), map(_rms, last.T), units, map(_rms, noise.T))),
        coverage=float(np.nanmean(errors.inside)) if np.isfinite(errors.inside).any() else None,
        poorly_known=_poorly_known(law),
        unjudged=tuple(unjudged),
        unknown_objects=tuple(dict.fromkeys(each.object for each in judged if is_typical(law, each.object, trials))),
        exact=OutcomeKind.MODEL_ERROR not in told and not law.uncertainty.error_model.of_law,
        none_exact=OutcomeKind.MODEL_ERROR in told,
        few_samples=OutcomeKind.FEW_SAMPLES in told,
        without_terms=tuple(each.where for each in law.outcomes if each.kind is OutcomeKind.EMPTY_SUPPORT),
    )


def _spread(trials: Sequence[Trial], states: int) -> Floats:
    """Return the standard deviation of each state within trials, shape (states,); NaN for one that does not change."""
    variances = [np.nanvar(each.states, axis=0) for each in trials if np.isfinite(each.states).any(axis=0).all()]
    spread = np.sqrt(np.mean(variances, axis=0)) if variances else np.full(states, np.nan)
    return np.where(spread > 0, spread, np.nan)


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
    horizon = 0.0
    for part in np.array_split(order, max(1, min(_PARTS, len(order) // _MEASURED_IN_PART))):
        if not len(part) or not _rms(scaled[rows[part], columns[part]]) <= _WITHIN:
            break
        horizon = float(leads[rows[part[-1]]])
    return horizon


def _rms(values: Floats) -> float:
    known = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def _r_squared(scaled: Floats) -> float:
    """Return the mean of R^2 over states of errors relative to the spread, shape (n, states); NaN if there are none."""
    known = [_rms(column) for column in scaled.T if not np.isnan(column).all()]
    return float(np.mean([1 - each**2 for each in known])) if known else float("nan")


def _poorly_known(law: Law) -> tuple[str, ...]:
    """Return the coefficients with large errors, with the terms that they stand before and the objects they are of."""
    found = []
    for each, values, errors in zip(law.named_coefficients, *(part.T for part in law.letter_values()), strict=True):
        poor = np.flatnonzero(errors > _POOR * np.abs(values))
        if len(poor):
            where = f"{law.left_hand_sides[each.equation]}, before {law.terms.factors[each.term]}"
            some = [law.objects[i] for i in poor]
            of = "" if len(poor) == len(law.objects) else f", of {listed(some)}"
            # The equations of an explained law have letters of their own
            found.append(f"{each.name if law.explanation is None else 'a coefficient'} ({where}{of})")
    return tuple(found)
