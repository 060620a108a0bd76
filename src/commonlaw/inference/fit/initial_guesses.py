"""Coefficients that are tried for the equations of states that nobody measured, and the scales of these states."""

from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.inference import settings
from commonlaw.inference.fit.parameter_grid import values_to_try
from commonlaw.library import Terms, order_of_each, with_rates
from commonlaw.trials import Trials
from commonlaw.trials.logarithms import natural


class Drawn(NamedTuple):
    """Coefficients, shape (equations, terms), and starts of states, shape (states,), that a fit may begin at."""

    coefficients: Floats
    starts: Floats


def scales_of_states(trials: Trials, terms: Terms, known: Floats) -> Floats:
    """Return the scale of each state, shape (states,), by measurements and starts, or else by the equations.

    By these, and by constants that are factors of terms, states change by about their scales within a trial.
    Coefficients that are known have the shape (equations, terms), NaN where they are to be found.
    """
    columns = np.concatenate([natural(trial.states, trials.schema) for trial in trials])
    largest = np.asarray(np.nanmax(np.abs(np.vstack([columns, np.zeros(columns.shape[1])])), axis=0))
    is_told = ~(trials.schema.unmeasured & (largest == 0))
    scales = np.where(is_told, largest, np.median(largest[is_told]))
    numbers = ~np.isnan(known) & (known != 0)
    constants = np.full(len(terms.constants), 1 / _duration(trials))
    where, times = np.nonzero(numbers), _times(trials, terms, len(known))
    if is_told.all() or not len(where[0]):
        return scales

    def left(logarithms: Floats) -> Floats:
        """Return by what factors, as logarithms, rates are off."""
        own = scales.copy()
        own[~is_told], inside = np.exp(logarithms[: (~is_told).sum()]), np.exp(logarithms[(~is_told).sum() :])
        sizes = _sizes(trials, terms, own, inside)[where[1]] * np.abs(known[where])
        found = np.log(times[where[0]] * sizes / own[where[0]])
        return np.where(np.isfinite(found), found, 0.0)

    logarithms = np.log(np.concatenate([scales[~is_told], constants]))
    for _ in range(settings.MAX_ITERATIONS):
        now = left(logarithms)
        steps = np.eye(len(logarithms)) * settings.ROUNDING
        slopes = np.array([(left(logarithms + each) - now) / settings.ROUNDING for each in steps]).T
        logarithms = logarithms - np.clip(np.linalg.lstsq(slopes, now, rcond=settings.ROUNDING)[0], -1.0, 1.0)
    scales[~is_told] = np.exp(logarithms[: (~is_told).sum()])
    return scales


def tried(terms: Terms, known: Floats, started: Bools) -> Bools:
    """Return which coefficients are tried: constants inside of terms, and those in equations of unmeasured states.

    Shape (equations, terms), by the coefficients that are known and the states that nobody measured, shape (states,).
    """
    return np.asarray(np.isnan(known) & (started[:, np.newaxis] | ~terms.is_factor))


def relative_speed(trials: Trials, terms: Terms, known: Floats, coefficients: Floats) -> float:
    """Return how fast unmeasured states change by what is tried, beside changes by their scales within a trial."""
    started, scales = trials.schema.unmeasured, scales_of_states(trials, terms, known)
    constants = coefficients[:, list(terms.constants)].sum(axis=0)
    rates = np.abs(coefficients) * _sizes(trials, terms, scales, constants) / scales[:, np.newaxis]
    return _duration(trials) * float(np.sum(rates[started]))


def draws(trials: Trials, terms: Terms, known: Floats, guess: Floats) -> list[Drawn]:
    """Return coefficients that are known, shape (equations, terms), with those that are tried; and starts.

    By them a state changes by its scale within a trial at the slowest, and within the shortest step at the fastest.
    Constants that are no factors, such as K in ``s/(K + s)``, are about the size of what they stand beside. Signs are
    those of a guess.
    """
    started, scales = trials.schema.unmeasured, scales_of_states(trials, terms, known)
    own, random, found = tried(terms, known, started), np.random.default_rng(0), list[Drawn]()
    powers = _powers(terms)
    is_rate = own & (terms.is_factor | _of_terms(terms, np.asarray(np.isfinite(powers).all(axis=0))))
    rows, matrix = _rates(terms, known, is_rate, powers)
    bank = _bank(trials, terms, scales, own & ~is_rate)
    times = _times(trials, terms, len(known))
    signs, factors = np.sign(guess[is_rate]), np.nan_to_num(np.abs(known[rows]), nan=1.0)
    steps = _duration(trials) / min(np.diff(trial.measured().times).min() for trial in trials)
    free = trials.schema.with_free_start
    count = int(own.sum() + free.sum())
    draws_of_two = settings.MIN_DRAWS[int(free.any())]
    for _ in range(draws_of_two * max(1, (count + 1) // 2) if count else 1):
        drawn = known.copy()
        either = np.where(signs == 0, random.choice([-1, 1], len(signs)), signs)
        drawn[own & ~is_rate] = bank[random.integers(len(bank))]
        constants = np.nan_to_num(np.where(is_rate, 1.0, drawn)[:, list(terms.constants)]).sum(axis=0)
        sizes = _sizes(trials, terms, scales, constants)[rows[1]] * factors
        typical = scales[rows[0]] / (times[rows[0]] * sizes)
        targets = np.log(typical * steps ** random.uniform(0, 1, len(typical)))
        drawn[is_rate] = either * np.exp(np.linalg.lstsq(matrix, targets)[0])
        found.append(Drawn(drawn, _starts(scales, random) if free.any() else scales))
    return found


def _starts(scales: Floats, random: np.random.Generator) -> Floats:
    """Return starts of states, shape (states,), about their scales."""
    signs = np.where(random.uniform(size=len(scales)) < settings.NEGATIVE, -1.0, 1.0)
    return np.asarray(signs * scales * 10 ** random.uniform(*settings.INITIAL_VALUE_DECADES, len(scales)))


def _rates(terms: Terms, known: Floats, is_rate: Bools, powers: Floats) -> tuple[tuple[Floats, Floats], Floats]:
    """Return where rates stand, by equation and term, and the powers of what is tried in each, shape (rates, tried).

    Those are coefficients that are tried, and numbers before terms with constants that are.
    """
    columns = np.argwhere(is_rate).tolist()
    constants = {k: c for c, k in enumerate(terms.constants)}
    is_one = (is_rate & terms.is_factor) | (~np.isnan(known) & (known != 0))
    rows, matrix = [], list[list[float]]()
    for j, k in np.argwhere(is_one).tolist():
        row = [powers[k, constants[b]] if b in constants else float((j, k) == (a, b)) for a, b in columns]
        if any(row):
            rows.append((j, k))
            matrix.append(row)
    indices = np.array(rows, dtype=int).reshape(-1, 2)
    return (indices[:, 0], indices[:, 1]), np.array(matrix).reshape(len(rows), len(columns))


def _powers(terms: Terms) -> Floats:
    """Return the power of each constant in each term, shape (terms, constants), NaN where it is no factor of it."""
    names = terms.variables.names
    first = len(terms.variables.measured)
    points = np.random.default_rng(0).uniform(0.5, 1.5, (settings.GENERIC_POINTS, len(names)))
    values = terms.evaluate(points)[:, :, np.newaxis]
    slopes = terms.jacobian(points)[:, :, first:] * points[:, np.newaxis, first:]
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.where(slopes == 0, 0.0, slopes / values)
    power = np.rint(found[0])
    return np.asarray(np.where((np.abs(found - power) < settings.ROUNDING).all(axis=0), power, np.nan))


def _of_terms(terms: Terms, of_constants: Bools) -> Bools:
    """Return for each term whether it is the place of a constant of which something holds, shape (terms,)."""
    found = np.zeros(len(terms), dtype=np.bool_)
    found[list(terms.constants)] = of_constants
    return found


def _bank(trials: Trials, terms: Terms, scales: Floats, inside: Bools) -> Floats:
    """Return values to try of constants that are no factors, shape (values, constants)."""
    first = len(terms.variables.measured)
    columns = [first + terms.constants.index(k) for k in np.argwhere(inside)[:, 1].tolist()]
    if not columns:
        return np.empty((1, 0))
    return values_to_try(terms, _whole(trials, terms, scales)[np.newaxis], columns)


def _duration(trials: Trials) -> float:
    return float(np.mean([np.ptp(trial.times) for trial in trials]))


def _times(trials: Trials, terms: Terms, equations: int) -> Floats:
    """Return by what each equation is multiplied to give a change within a trial, shape (equations,)."""
    return _duration(trials) ** np.array(order_of_each(terms.variables.order_of(equations), equations), dtype=float)


def _whole(trials: Trials, terms: Terms, scales: Floats) -> Floats:
    """Return sizes of all variables without constants, shape (variables,)."""
    rates = scales[with_rates(terms.variables.order_of(len(scales)), len(scales))] / _duration(trials)
    inputs = np.sqrt(np.mean(np.concatenate([trial.inputs for trial in trials]) ** 2, axis=0))
    return np.concatenate([scales, rates, inputs, [_duration(trials)]])


def _sizes(trials: Trials, terms: Terms, scales: Floats, constants: Floats) -> Floats:
    """Return the size of each term where states are of the size of their scales, or less, shape (terms,)."""
    whole = _whole(trials, terms, scales)
    # Shares of their own, so that what is written as a difference is no smaller than its parts
    values = whole * np.random.default_rng(0).uniform(size=(settings.GENERIC_POINTS, len(whole)))
    values = np.column_stack([values, np.broadcast_to(constants, (len(values), len(constants)))])
    with np.errstate(all="ignore"):
        return np.asarray(np.mean(np.abs(terms.evaluate(values)), axis=0))
