"""What hangs on where zero is: terms on scales whose zero was agreed upon, trials that start where no term acts."""

from collections.abc import Iterable, Iterator
from contextlib import suppress

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.law.law import Law
from commonlaw.law.parameters import left_hand_sides, rate_names
from commonlaw.outcomes import Outcome, OutcomeKind, note
from commonlaw.text import counted
from commonlaw.trials import Trial, Trials
from commonlaw.trials.headers import parse_unit, registry
from commonlaw.trials.transformations import Conversion

_NOISES = 2
"""Standard deviations of the noise within which a state counts as zero."""
_MAX_MISFIT = 3
"""Standard deviations of the noise between a measured and a fitted initial value that agree."""
_ROUNDING = 1e-8


def with_origin_outcomes(outcomes: Iterable[Outcome], law: Law, trials: Trials) -> tuple[Outcome, ...]:
    """Return outcomes with those of where zero is as a law and the trials that it was learned from have it."""
    others = (outcome for outcome in outcomes if outcome.kind not in (OutcomeKind.SCALE, OutcomeKind.START))
    return (*others, *_of_scales(law), *_of_starts(law, trials))


def _of_scales(law: Law) -> Iterator[Outcome]:
    """Yield the terms of each equation that would be others if a variable had its zero elsewhere."""
    variables, units = law.terms.variables, law.schema.units
    lefts = left_hand_sides(law)
    for name in (*law.schema.states, *variables.inputs):
        changes = _changes(law, variables.index(name)) if name in units else []
        base = _absolute(name, units[name]) if any(changes) else None
        for equation, terms in zip(lefts, changes, strict=True) if base else ():
            if terms:
                verb = "depends" if len(terms) == 1 else "depend"
                yield note("scale-origin", equation, terms=terms, verb=verb, name=name, unit=units[name], base=base)


def _changes(law: Law, column: int) -> list[list[str]]:
    """Return the terms of each equation that are not linear in a variable, and that no others make up for if it shifts.

    A sum of powers with all lower powers, for instance, is such a sum whatever the zero. Parameters inside terms
    make up for it where their derivatives do, as K in ``1/(K + x)``.
    """
    terms = law.terms
    points = np.random.default_rng(0).uniform(1, 2, (20 + 10 * len(terms), len(terms.variables.measured)))
    with np.errstate(all="ignore"):
        points = terms.at(points, np.where(law.support, law.coefficients.mean(axis=0), 0.0))
        values, derivatives = terms.evaluate(points), terms.jacobian(points)
    slopes, by_parameters = derivatives[:, :, column], derivatives[:, :, len(terms.variables.measured) :]
    finite = np.isfinite(derivatives).all(axis=(0, 2)) & np.isfinite(values).all(axis=0)
    linear = ~finite | (np.ptp(slopes, axis=0) <= _ROUNDING * np.max(np.abs(values), axis=0))
    changed = []
    for support in law.support & terms.is_factor:
        others = np.column_stack(
            [values[:, support & finite], by_parameters[:, support & finite].reshape(len(points), -1)]
        )
        suspects = np.flatnonzero(support & ~linear)
        scales = np.maximum(np.linalg.norm(others, axis=0), np.finfo(float).tiny)
        residuals = slopes[:, suspects] - others / scales @ np.linalg.lstsq(others / scales, slopes[:, suspects])[0]
        sizes = np.max(np.abs(slopes[:, suspects]), axis=0)
        changed.append([terms.names[k] for k in suspects[np.max(np.abs(residuals), axis=0) > 1e2 * _ROUNDING * sizes]])
    return changed


def _absolute(name: str, unit: str) -> str | None:
    """Return the unit that a variable has its true zero in, if that is not the zero of its own unit."""
    base = str(registry().get_base_units(parse_unit(unit))[1])
    with suppress(CommonlawError):
        return base if Conversion.between(name, unit, base).offset else None
    return None


def _of_starts(law: Law, trials: Trials) -> Iterator[Outcome]:
    """Yield that trials start where the law says that nothing ever happens, and that something did."""
    if rate_names(law) or law.schema.logarithmic or len(law.terms.variables.states) > len(trials.schema.states):
        return  # Rates and states that are not measured may set it going
    noise = np.zeros(len(law.schema.states)) if law.uncertainty.noise is None else law.uncertainty.noise
    starting = [trial for trial in trials if _leaves_zero(trial, noise) and _rests(law, trial)]
    starting = [trial for trial in starting if not _starts_as_measured(law, trials.with_trials([trial]), noise)]
    if starting:
        names = " or ".join(law.schema.states)
        began = f"initial values of {counted(len(starting), 'trial')} are zero within the noise"
        yield note("starts-at-rest", began=began, names=names)


def _leaves_zero(trial: Trial, noise: Floats) -> bool:
    """Return whether all states are zero at first, and later some state is not."""
    begins = np.abs(trial.states[:1]) <= _NOISES * trial.std(noise)[:1]
    return bool(begins.all() and np.any(np.abs(trial.states) > 5 * _NOISES * trial.std(noise)))


def _starts_as_measured(law: Law, trial: Trials, noise: Floats) -> bool:
    """Return whether the initial condition that is fitted to the whole trial agrees with its first sample.

    Exponential growth, for instance, is near the noise at first, and leaves it by the law.
    """
    if law.order == 0:
        return False
    with suppress(CommonlawError):
        begins = law.predict(trial, start="all", averaged=False).trajectories[0].states[0]
        return bool(np.all(np.abs(begins - trial[0].states[0]) <= _MAX_MISFIT * trial[0].std(noise)[0]))
    return False


def _rests(law: Law, trial: Trial) -> bool:
    """Return whether no term acts on states at zero, whatever the inputs of a trial are."""
    inputs = np.nan_to_num(trial.inputs)
    values = np.column_stack([np.zeros((len(trial.times), len(law.schema.states))), inputs, trial.times])
    with np.errstate(all="ignore"):
        return bool(np.all(law.rhs(trial.object, values) == 0))
