"""Rates that come with trials: measured columns that are the rates of others, and given derivatives."""

from collections.abc import Collection, Container, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.diagnostics import Outcome, note
from commonlaw.differentiation import noise_level
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.formulation import TrialDerivatives
from commonlaw.runtime.arguments import numbers_of
from commonlaw.trials import Schema, Trial, Trials
from commonlaw.trials.transformations import rates_in_words, without_rates
from commonlaw.trials.trial import with_typical
from commonlaw.trials.units import Conversion

GivenDerivatives = ArrayLike | Sequence[ArrayLike] | Mapping[str, Any]
"""An array for each trial, shape (n, states); or by state the name of a column, or an array for each trial, (n,)."""


def without_measured_rates(
    trials: Trials, second: Collection[str], states: Container[str] = ()
) -> tuple[Trials, tuple[Outcome, ...]]:
    """Return the trials without columns that are the rates of states of second order, and a note on them.

    Columns of `states`, which have separate equations, are kept.
    """
    measured = measured_rates(trials) if second and len(trials.schema.states) > 1 else {}
    rates = {state: rate for state, rate in measured.items() if state in second and rate not in states}
    if not rates:
        return trials, ()
    return without_rates(trials, rates), (note("rate-of-column", rates=rates_in_words(rates)),)


def measured_rates(trials: Trials) -> dict[str, str]:
    """Return the column that is its rate, by state.

    The increments of a state are regressed on integrals of the column over the sampling intervals, in sums over each
    trial with smooth weights, which average the noise. The column is a rate if the slope is 1, the intercept 0, and
    there is no lack of fit, within the errors by noise and quadrature (chi-squared tests at 0.1 %, with at most twice
    the estimated noise variance), and if the slope differs from zero by ten standard errors. Units, if known, must be
    those of a rate.

    A column that is a rate only numerically (y = x' on a circle with a period of 2 pi) is taken for one unless its unit
    is another.
    """
    result = dict[str, str]()
    counts = np.array([np.isfinite(trial.states).sum(axis=0) for trial in trials]).min(axis=0)
    for state in (name for name, count in zip(trials.schema.states, counts, strict=True) if count >= 5):
        for rate in trials.schema.states:
            origins, states = [state], {known: name for name, known in result.items()}
            while origins[-1] in states:  # The state that it is the rate of, and so on, to exclude rates in a circle
                origins.append(states[origins[-1]])
            taken = rate in result.values() or rate in origins
            if not taken and _is_rate(trials, state, rate):
                result[state] = rate
                break
    return result


def is_computed(trials: Trials, state: str, rate: str) -> bool:
    """Return whether a rate was computed from the measurements of the state, by differences or a smoothing filter.

    Its noise is then a linear function of the state's in neighbouring samples. Fourth differences, which hold noise
    rather than motion, of the rate are regressed on those of the state at up to ten samples to both sides, or five
    where trials are short: they explain all of it (90 %) if it was computed, and hardly more than chance if it was
    measured. Where fourth differences of the state are no noise (more than a third of neighbouring ones have the same
    sign; of noise a fifth), the data do not decide, and the rate counts as measured.
    """
    j, k = trials.schema.states.index(state), trials.schema.states.index(rate)
    both = [trial.states[np.isfinite(trial.states[:, [j, k]]).all(axis=1)][:, [j, k]] for trial in trials]
    fourth = [np.diff(pair, 4, axis=0).T for pair in both if len(pair) > 5]
    noisy = [pair for pair in fourth if (pair[0, 1:] * pair[0, :-1] > 0).mean() < 1 / 3]
    for lags in (10, 5):
        width = 2 * lags + 1
        long = [pair for pair in noisy if pair.shape[1] >= width]
        if sum(pair.shape[1] - width + 1 for pair in long) < 2 * width:
            continue
        windows = np.concatenate([sliding_window_view(pair[0], width) for pair in long])
        target = np.concatenate([pair[1, lags : pair.shape[1] - lags] for pair in long])
        rest = target - windows @ np.linalg.lstsq(windows, target)[0]
        return bool(rest @ rest / (1 - width / len(target)) < (1 - 0.9) * (target @ target))
    return False


class _Sums(NamedTuple):
    """Weighted sums over one trial, shape (weights,), with independent errors of unit variance."""

    increments: Floats
    integrals: Floats
    steps: Floats


def _is_rate(trials: Trials, state: str, rate: str) -> bool:
    factor = _factor(trials.schema, state, rate)
    if factor is None:
        return False
    j, k = trials.schema.states.index(state), trials.schema.states.index(rate)
    # Fewer samples do not tell both noise and motion
    both = [trial for trial in trials if np.isfinite(trial.states[:, [j, k]]).all(axis=1).sum() >= 20]
    chosen = both[:: max(1, -(-len(both) // 20))]
    sums = list[_Sums]()
    for part in _sums(chosen, j, k, factor):
        if not _agrees(part):
            return False
        sums.append(part)
    if not sums:
        return False
    whole = _Sums(*map(np.concatenate, zip(*sums, strict=True)))
    integrals, steps = whole.integrals, whole.steps
    # Not counting what noise adds to the integrals
    is_told = integrals @ integrals - (integrals @ steps) ** 2 / (steps @ steps) - len(integrals) >= 10**2
    return bool(is_told) and _agrees(whole)


def _factor(schema: Schema, state: str, rate: str) -> float | None:
    """Return the factor that converts a column to the unit of a rate; None if their dimensions differ."""
    units = [schema.units.get(name) for name in (state, schema.time, rate)]
    if None in units:
        return 1.0
    of_state, of_time, of_rate = units
    try:
        turn = Conversion.between(rate, of_rate, f"({of_state}) / ({of_time})")
    except CommonlawError:
        return None
    return None if turn.offset else turn.scale


def _agrees(sums: _Sums) -> bool:
    """Whether slope and intercept are 1 and 0, and the residuals are within the noise."""
    from scipy.special import chdtri

    differences = sums.increments - sums.integrals
    design = np.column_stack([sums.integrals, sums.steps])
    fitted = design @ np.linalg.lstsq(design, differences)[0]
    rest = differences - fitted
    sizes = np.array([fitted @ fitted, rest @ rest])
    return bool((sizes <= 2 * chdtri(np.array([2, len(differences) - 2]), 1e-3)).all())


def _sums(trials: list[Trial], state: int, rate: int, factor: float) -> Iterator[_Sums]:
    from scipy.interpolate import CubicSpline
    from scipy.linalg import solve_triangular

    for trial in trials:
        rows = np.flatnonzero(np.isfinite(trial.states[:, [state, rate]]).all(axis=1))[:2000]
        times, scale = trial.times[rows], np.array([1.0, factor])
        values = trial.states[rows][:, [state, rate]] * scale
        noise = with_typical(trial.noise[rows][:, [state, rate]] * abs(scale), noise_level(times, values))
        noise = np.maximum(noise, np.finfo(np.float64).eps * abs(values).max(axis=0))
        steps, middles = np.diff(times), (times[1:] + times[:-1]) / 2
        count = max(8, len(times) // 10)  # The fastest goes up and down in 20 samples, as motion may at most
        weights = np.cos(np.outer(np.arange(count), np.pi * (middles - times[0]) / (times[-1] - times[0])))
        integrals = np.diff(CubicSpline(times, values[:, 1]).antiderivative()(times))
        trapezoids = steps * (values[1:, 1] + values[:-1, 1]) / 2
        # What each measurement adds to the sums: to increments by both its steps, to integrals by half of both
        around, shares = np.pad(weights, ((0, 0), (1, 1))), np.pad(weights * steps, ((0, 0), (1, 1)))
        of_state = (around[:, :-1] - around[:, 1:]) * noise[:, 0]
        of_rate = (shares[:, :-1] + shares[:, 1:]) / 2 * noise[:, 1]
        # The lower rule's error stands for that of the higher one, as in step size control
        quadrature = np.diag((weights @ (integrals - trapezoids)) ** 2)
        covariance = of_state @ of_state.T + of_rate @ of_rate.T + quadrature
        if covariance.any() and np.isfinite(covariance).all():
            columns = np.column_stack([np.diff(values[:, 0]), integrals, steps])
            yield _Sums(*solve_triangular(np.linalg.cholesky(covariance), weights @ columns, lower=True).T)


def with_derivatives(trials: Trials, given: GivenDerivatives) -> tuple[Trials, TrialDerivatives]:
    """Return trials without columns of derivatives, and the derivatives of each trial.

    Raises `CommonlawError` if a state has no derivatives, or these have another shape or are not finite.
    """
    by_state: Mapping[str, Any] = given if isinstance(given, Mapping) else {}
    columns = {state: name for state, name in by_state.items() if isinstance(name, str)}
    for name in columns.values():
        check_choice("column", name, trials.schema.states)
    states = [name for name in trials.schema.states if name not in columns.values()]
    for name in by_state:
        check_choice("state", name, states)
    if isinstance(given, Mapping):
        if missing := [name for name in states if name not in by_state]:
            raise CommonlawError("derivatives-missing", states=missing)
        listed = [
            np.column_stack(arrays)
            for arrays in zip(*(_of_each(by_state[name], trials) for name in states), strict=True)
        ]
    else:
        listed = _of_each(given, trials)
    result = TrialDerivatives()
    for trial, array in zip(trials, listed, strict=True):
        values = array.reshape(len(array), -1)
        if values.shape != (len(trial), len(states)):
            raise CommonlawError(
                "derivatives-shape", trial.label, shape=array.shape, expected=(len(trial), len(states))
            )
        used = np.isfinite(values).all(axis=1)
        if not used.all():
            raise CommonlawError("derivatives-not-finite", trial.label, sample=int(np.argmin(used)) + 1)
        result[trial.object, trial.name] = trial.times, values
    return without_rates(trials, columns), result


def _of_each(given: Any, trials: Trials) -> list[Floats]:
    """Return an array for each trial: of a list of them, of one array if there is one trial, or of a column."""
    if isinstance(given, str):
        check_choice("column", given, trials.schema.states)
        return [trial.states[:, trials.schema.states.index(given)] for trial in trials]
    listed = list(given) if isinstance(given, list | tuple) else [given]
    if len(listed) != len(trials):
        raise CommonlawError("derivatives-of-trials", count=len(listed), trials=len(trials))
    return [np.atleast_1d(numbers_of("x_dot", array)) for array in listed]
