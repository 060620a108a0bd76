"""Dependence on the origin of scales: terms in units with a conventional zero, and trials that start at equilibrium."""

from collections.abc import Iterable, Iterator
from contextlib import suppress

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.diagnostics import Outcome, OutcomeKind, note
from commonlaw.errors import CommonlawError
from commonlaw.inference.settings import ROUNDING, SIGNIFICANT
from commonlaw.law.law import Law
from commonlaw.law.parameters import left_hand_sides, rate_names
from commonlaw.text import counted
from commonlaw.trials import Trial, Trials
from commonlaw.trials.headers import parse_unit, registry
from commonlaw.trials.units import Conversion


def with_origin_outcomes(outcomes: Iterable[Outcome], law: Law, trials: Trials) -> tuple[Outcome, ...]:
    """Return outcomes with those of a law and its training trials that depend on the origin of a scale."""
    others = [outcome for outcome in outcomes if outcome.kind not in (OutcomeKind.SCALE, OutcomeKind.START)]
    variables, units, lefts = law.terms.variables, law.schema.units, left_hand_sides(law)
    for name in (*law.schema.states, *variables.inputs):
        changes = _changes(law, variables.index(name)) if name in units else []
        if not any(changes):
            continue
        base = str(registry().get_base_units(parse_unit(units[name]))[1])
        with suppress(CommonlawError):
            if Conversion.between(name, units[name], base).offset:  # Its zero is conventional
                for equation, terms in ((side, terms) for side, terms in zip(lefts, changes, strict=True) if terms):
                    verb, unit = "depends" if len(terms) == 1 else "depend", units[name]
                    others.append(
                        note("scale-origin", equation, terms=terms, verb=verb, name=name, unit=unit, base=base)
                    )
    return (*others, *_equilibrium_outcomes(law, trials))


def _changes(law: Law, column: int) -> list[list[str]]:
    """Return the nonlinear terms of each equation that are not invariant to a shift of a variable.

    A term is invariant if its derivative by the variable is in the span of the other terms and of derivatives by
    nonlinear parameters: a polynomial with all lower powers, for instance, or ``1/(K + x)``.
    """
    terms = law.terms
    points = np.random.default_rng(0).uniform(1, 2, (20 + 10 * len(terms), len(terms.variables.measured)))
    with np.errstate(all="ignore"):
        points = terms.at(points, np.where(law.support, law.coefficients.mean(axis=0), 0.0))
        values, derivatives = terms.evaluate(points), terms.jacobian(points)
    slopes, by_parameters = derivatives[:, :, column], derivatives[:, :, len(terms.variables.measured) :]
    finite = np.isfinite(derivatives).all(axis=(0, 2)) & np.isfinite(values).all(axis=0)
    linear = ~finite | (np.ptp(slopes, axis=0) <= ROUNDING * np.max(np.abs(values), axis=0))
    changed = []
    for support in law.support & terms.is_factor:
        others = np.column_stack(
            [values[:, support & finite], by_parameters[:, support & finite].reshape(len(points), -1)]
        )
        suspects = np.flatnonzero(support & ~linear)
        scales = np.maximum(np.linalg.norm(others, axis=0), np.finfo(float).tiny)
        residuals = slopes[:, suspects] - others / scales @ np.linalg.lstsq(others / scales, slopes[:, suspects])[0]
        sizes = np.max(np.abs(slopes[:, suspects]), axis=0)
        changed.append([terms.names[k] for k in suspects[np.max(np.abs(residuals), axis=0) > ROUNDING * sizes]])
    return changed


def _equilibrium_outcomes(law: Law, trials: Trials) -> Iterator[Outcome]:
    """Yield that trials start at an equilibrium of the law at zero, and leave it."""
    if rate_names(law) or law.schema.logarithmic or len(law.terms.variables.states) > len(trials.schema.states):
        return  # Unmeasured rates and states may differ from zero
    noise = np.zeros(len(law.schema.states)) if law.uncertainty.noise is None else law.uncertainty.noise
    starting = []
    for trial in trials:
        sizes, std = np.abs(trial.states), trial.std(noise)
        leaves_zero = np.all(sizes[:1] <= SIGNIFICANT * std[:1]) and np.any(sizes > 5 * SIGNIFICANT * std)
        if leaves_zero and _is_equilibrium(law, trial):
            starting += [] if _starts_as_measured(law, trials.with_trials([trial]), noise) else [trial]
    if starting:
        names = " or ".join(law.schema.states)
        began = f"initial values of {counted(len(starting), 'trial')} are zero within the noise"
        yield note("starts-at-rest", began=began, names=names)


def _starts_as_measured(law: Law, trial: Trials, noise: Floats) -> bool:
    """Return whether the initial condition fitted to the whole trial agrees with its first sample.

    It does for exponential growth, for instance, from below the noise.
    """
    try:
        fitted = law.predict(trial, start="all", averaged=False).trajectories[0].states[0]
    except CommonlawError:  # No solution follows the trial
        return False
    return bool(np.all(np.abs(fitted - trial[0].states[0]) <= 3 * trial[0].std(noise)[0]))


def _is_equilibrium(law: Law, trial: Trial) -> bool:
    states = np.zeros((len(trial.times), len(law.schema.states)))
    with np.errstate(all="ignore"):
        rates = law.rhs(trial.object, np.column_stack([states, np.nan_to_num(trial.inputs), trial.times]))
    return bool(np.all(rates == 0))
