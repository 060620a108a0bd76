"""From a law and trials to a verdict: forecasts of segments, and their errors together."""

from collections.abc import Sequence

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.diagnostics import marked
from commonlaw.differentiation import noise_degrees_of_freedom, noise_level
from commonlaw.effort import announced
from commonlaw.errors import CommonlawError
from commonlaw.law import Law
from commonlaw.law.meeting import matched
from commonlaw.law.population import is_typical, with_objects_of
from commonlaw.outcomes import OutcomeKind
from commonlaw.trials import Trial, Trials
from commonlaw.verdict.law_verdict import NEAR, LawVerdict, StateError, listed
from commonlaw.verdict.segments import Kind, Segment, SegmentErrors, forecast_errors, segments
from commonlaw.wording import counted

_PARTS, _MEASURED_IN_PART = 10, 3
"""How far ahead forecasts are good is told from the errors in so many parts, by how far ahead, of so many each."""

_POOR = 0.5
"""Coefficients with a standard error above this share of their size are poorly known."""


def judge(law: Law, trials: Trials, learned: Trials | None = None) -> LawVerdict:
    """Return what a law is good for, see `Law.verdict`."""
    trials, learned = matched(law, trials), None if learned is None else matched(law, learned)
    judged, found, unjudged = list[Segment](), list[SegmentErrors](), list[str]()
    whole = {(each.object, each.name): each for each in trials}
    parts = segments(trials, learned, law.order)
    for segment in announced(parts, f"judging the law by {counted(len(parts), 'forecast')}", "take fewer trials"):
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
    spread = _spread(once, len(law.states))
    errors = _joined(found, spread)
    horizon = _horizon(errors.leads, errors.errors / spread)
    kinds = [each.kind for each in judged]
    known, inexact = {each.kind for each in law.outcomes}, {OutcomeKind.MODEL_ERROR, OutcomeKind.APPROXIMATION}
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
        none_exact=bool(inexact & known and law.alternatives),
        few_samples=OutcomeKind.FEW_SAMPLES in known,
        without_terms=tuple(each.where for each in law.outcomes if each.kind is OutcomeKind.EMPTY_SUPPORT),
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
    """Return the errors of each state, with the range that was measured in the trials.

    The noise of an approximation has its lack of fit in it: there the noise is that of neighbouring samples, if less.
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
        if not len(part) or not _rms(scaled[rows[part], columns[part]]) <= NEAR:
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
    for each, values, errors in zip(law.named_coefficients, *(part.T for part in law.letter_values()), strict=True):
        poor = np.flatnonzero(errors > _POOR * np.abs(values))
        if len(poor):
            where = f"{law.left_hand_sides[each.equation]}, before {law.terms.factors[each.term]}"
            some = [law.objects[i] for i in poor]
            of = "" if len(poor) == len(law.objects) else f", of {listed(some)}"
            # The equations of an explained law have letters of their own
            found.append(f"{each.name if law.explanation is None else 'a coefficient'} ({where}{of})")
    return tuple(found)
