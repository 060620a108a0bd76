"""Which measured columns are the rates of others, by what was measured."""

from collections.abc import Collection, Container, Iterator
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from commonlaw.array_types import Floats
from commonlaw.differentiation import noise_level
from commonlaw.errors import CommonlawError
from commonlaw.outcomes import Outcome, note
from commonlaw.trials import Schema, Trial, Trials
from commonlaw.trials.transformations import Conversion, rates_in_words, without_rates
from commonlaw.trials.trial import with_typical

_FEWEST_WEIGHTS, _SAMPLES_A_WEIGHT = 8, 10
"""Smooth weightings of a trial: its steps from sample to sample are compared in so many sums, the fastest of which goes
up and down in 20 samples, as fast as motion is whose noise can be estimated."""

_FEWEST = 20
"""Samples of a trial that tell both its noise and its motion; a state with fewer than `_LEAST` is not measured."""
_LEAST = 5

_MOST_TRIALS, _MOST_SAMPLES = 20, 2000
"""Trials that are looked at, spread over all, and samples of each, from its start."""

_ACCURACY = 0.1
"""Standard error that the slope must have at most: it then differs from zero by ten of them."""

_CHANCE, _NOISE = 1e-3, 2.0
"""How often a rate may be taken for none, and by which factor the variance of noise may be more than estimated."""

_LAGS = (10, 5)
"""Samples to each side that a filter for rates reaches at most; fewer where trials are short."""

_MOTION = 1 / 3
"""Share of neighbouring fourth differences with the same sign above which they are no noise: of noise it is 0.2."""

_COMPUTED = 0.9
"""Share of a rate's noise that the state's explains from which the rate was computed."""


def without_measured_rates(
    trials: Trials, second: Collection[str], states: Container[str] = ()
) -> tuple[Trials, tuple[Outcome, ...]]:
    """Return the trials without columns that are the rates of states of second order, and a word on them.

    Columns of `states`, which have equations of their own, stay.
    """
    found = measured_rates(trials) if second and len(trials.schema.states) > 1 else {}
    rates = {state: rate for state, rate in found.items() if state in second and rate not in states}
    if not rates:
        return trials, ()
    return without_rates(trials, rates), (note("rate-of-column", rates=rates_in_words(rates)),)


def measured_rates(trials: Trials) -> dict[str, str]:
    """Return the columns that are the rate of another, by the name of that other.

    The increments of a state from sample to sample are regressed on the integrals of the column in question, in sums
    over each trial with smooth weights, so that little noise is left. The column is a rate if the slope is 1, the
    intercept 0, and nothing is left over, all within the errors by the noise of both and by the quadrature; and if the
    trials tell the slope at all. Units, where they are known, have to be those of a rate.

    A column that is a rate only by numbers (y = x' on a circle that is gone round in a time of 2 pi) is taken for one
    unless its unit says otherwise.
    """
    found = dict[str, str]()
    for state in _measured_everywhere(trials):
        for rate in trials.schema.states:
            taken = rate in found.values() or rate in _origins(state, found)
            if not taken and _is_rate(trials, state, rate):
                found[state] = rate
                break
    return found


def is_computed(trials: Trials, state: str, rate: str) -> bool:
    """Return whether a rate was computed from the measurements of the state, by differences or a smoothing filter.

    Its noise is then a linear function of the state's in neighbouring samples. Fourth differences, which hold noise
    rather than motion, of the rate are regressed on those of the state at up to ten samples to both sides: they explain
    all of it if it was computed, and hardly more than chance if it was measured. Where fourth differences of the state
    are no noise (their sign hardly changes), the data do not decide, and the rate counts as measured.
    """
    j, k = trials.schema.states.index(state), trials.schema.states.index(rate)
    both = [trial.states[np.isfinite(trial.states[:, [j, k]]).all(axis=1)][:, [j, k]] for trial in trials]
    fourth = [np.diff(each, 4, axis=0).T for each in both if len(each) > _LAGS[-1]]
    noisy = [each for each in fourth if (each[0, 1:] * each[0, :-1] > 0).mean() < _MOTION]
    for lags in _LAGS:
        width = 2 * lags + 1
        long = [each for each in noisy if each.shape[1] >= width]
        if sum(each.shape[1] - width + 1 for each in long) < 2 * width:
            continue
        windows = np.concatenate([sliding_window_view(each[0], width) for each in long])
        target = np.concatenate([each[1, lags : each.shape[1] - lags] for each in long])
        rest = target - windows @ np.linalg.lstsq(windows, target)[0]
        return bool(rest @ rest / (1 - width / len(target)) < (1 - _COMPUTED) * (target @ target))
    return False


def _measured_everywhere(trials: Trials) -> list[str]:
    counts = np.array([np.isfinite(trial.states).sum(axis=0) for trial in trials]).min(axis=0)
    return [name for name, count in zip(trials.schema.states, counts, strict=True) if count >= _LEAST]


def _origins(state: str, found: dict[str, str]) -> set[str]:
    """Return a state and what it is a rate of, and that of, as no law is left if states are rates in a circle."""
    origins, states = {state}, {rate: name for name, rate in found.items()}
    while state in states:
        state = states[state]
        origins.add(state)
    return origins


class _Sums(NamedTuple):
    """Weighted sums over one trial, shape (weights,), in which their errors are independent and of unit variance."""

    increments: Floats
    integrals: Floats
    steps: Floats


def _is_rate(trials: Trials, state: str, rate: str) -> bool:
    factor = _factor(trials.schema, state, rate)
    if factor is None:
        return False
    j, k = trials.schema.states.index(state), trials.schema.states.index(rate)
    both = [each for each in trials if np.isfinite(each.states[:, [j, k]]).all(axis=1).sum() >= _FEWEST]
    chosen = both[:: max(1, -(-len(both) // _MOST_TRIALS))]
    sums = list[_Sums]()
    for each in _sums(chosen, j, k, factor):
        if not _agrees(each):
            return False
        sums.append(each)
    whole = _Sums(*map(np.concatenate, zip(*sums, strict=True))) if sums else None
    return whole is not None and _tells(whole) and _agrees(whole)


def _factor(schema: Schema, state: str, rate: str) -> float | None:
    """Return what a column is multiplied by to have the unit of a rate; None if it cannot have it."""
    units = [schema.units.get(name) for name in (state, schema.time, rate)]
    if None in units:
        return 1.0
    of_state, of_time, own = units
    try:
        turn = Conversion.between(rate, own, f"({of_state}) / ({of_time})")
    except CommonlawError:
        return None
    return None if turn.offset else turn.scale


def _agrees(sums: _Sums) -> bool:
    """Whether slope and intercept are 1 and 0, and the rest is no more than noise."""
    from scipy.special import chdtri

    left = sums.increments - sums.integrals
    design = np.column_stack([sums.integrals, sums.steps])
    fitted = design @ np.linalg.lstsq(design, left)[0]
    rest = left - fitted
    sizes = np.array([fitted @ fitted, rest @ rest])
    return bool((sizes <= _NOISE * chdtri(np.array([2, len(left) - 2]), _CHANCE)).all())


def _tells(sums: _Sums) -> bool:
    """Whether the slope is accurate enough, not counting what noise adds to the integrals."""
    own, steps = sums.integrals, sums.steps
    return bool(own @ own - (own @ steps) ** 2 / (steps @ steps) - len(own) >= 1 / _ACCURACY**2)


def _sums(trials: list[Trial], state: int, rate: int, factor: float) -> Iterator[_Sums]:
    from scipy.interpolate import CubicSpline
    from scipy.linalg import solve_triangular

    for trial in trials:
        rows = np.flatnonzero(np.isfinite(trial.states[:, [state, rate]]).all(axis=1))[:_MOST_SAMPLES]
        times, scale = trial.times[rows], np.array([1.0, factor])
        values = trial.states[rows][:, [state, rate]] * scale
        noise = with_typical(trial.noise[rows][:, [state, rate]] * abs(scale), noise_level(times, values))
        noise = np.maximum(noise, np.finfo(np.float64).eps * abs(values).max(axis=0))
        steps, middles = np.diff(times), (times[1:] + times[:-1]) / 2
        count = max(_FEWEST_WEIGHTS, len(times) // _SAMPLES_A_WEIGHT)
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
