"""How noisy measurements are before any law is known: as given, or by the samples alone."""

from collections.abc import Callable, Mapping
from numbers import Real

import numpy as np
from numpy.polynomial import Polynomial

from commonlaw.array_types import Bools, Floats
from commonlaw.differentiation import noise_level
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.trials import Schema, Trials
from commonlaw.trials.headers import find_name
from commonlaw.trials.repeats import pure_error


def spread_within(trials: Trials) -> Floats:
    """Return the standard deviation of each state within the trials in which it was measured, shape (states,)."""
    spread = np.zeros(len(trials.schema.states))
    for j in range(len(spread)):
        columns = [trial.states[np.isfinite(trial.states[:, j]), j] for trial in trials]
        spread[j] = np.sqrt(np.mean([np.var(each) for each in columns if len(each)]))
    return spread


def scales_of_starts(trials: Trials) -> Floats:
    """Return the scale of each state, shape (states,), by the standard deviations of unmeasured initial values."""
    of_starts = np.max([trial.noise[0] for trial in trials], axis=0)
    return np.asarray(of_starts / np.where(trials.schema.with_free_start, settings.VAGUE, settings.ROUNDING))


def noise_floor(trials: Trials) -> Floats:
    """Return what noise a law is fitted under at least, shape (d,): a small share of each state, or that of its digits.

    Of a latent state it is that of its starts.
    """
    return noise_told(trials, 1.0)[0]


def noise_told(trials: Trials, share: float) -> tuple[Floats, Floats]:
    """Return the `noise_floor`, and what exact measurements tell: a share of it, but no less than their digits."""
    digits = noise_of_digits(trials)
    measured = np.maximum(settings.MIN_NOISE * spread_within(trials), digits)
    floor = np.where(trials.schema.unmeasured, settings.ROUNDING * scales_of_starts(trials), measured)
    return floor, np.maximum(share * floor, digits)


def noise_of_digits(trials: Trials) -> Floats:
    """Return the noise of each state by the step to which its values were rounded, shape (d,), zero if there is none.

    Values that are all multiples of one step from each other err by up to half of it, evenly: step / sqrt(12).
    """
    columns = np.concatenate([trial.states for trial in trials]).T
    steps = np.zeros(len(columns))
    for j, column in enumerate(columns):
        different = np.unique(column[np.isfinite(column)])
        if len(different) < 3:
            continue
        step = float(np.diff(different).min())
        multiples = (different - different[0]) / step
        if np.all(np.abs(multiples - np.round(multiples)) < settings.MAX_FROM_MULTIPLE):
            steps[j] = step
        else:  # Few values seldom are neighbours on their scale: the last decimal that any has is the step
            decimals = (n for n in range(np.finfo(float).precision) if np.array_equal(different.round(n), different))
            steps[j] = next((10.0**-n for n in decimals), 0.0)
    return np.asarray(steps / np.sqrt(12))


def known_noise(noise: Mapping[str, float] | None, trials: Trials) -> Floats | None:
    """Return the noise of every state, shape (states,), whose name may be given with its unit: ``U [V]``.

    Of states whose measurements have standard deviations of their own it is the median of these, and NaN of latent
    states; None if nothing is known of any state.

    Raises `CommonlawError` if a state has none while others have, or two; a name is not a state, or a value is not
    positive.
    """
    states, columns = trials.schema.states, trials.schema.noise_columns
    if noise is None and not columns:
        return None
    noise = {find_name(name, states, "state"): level for name, level in (noise or {}).items()}
    for name, level in noise.items():
        if name in trials.schema.starts:
            raise CommonlawError("noise-of-latent", name=name)
        if not isinstance(level, Real):
            raise CommonlawError("setting-not-a-number", name=f"noise of {name}", value=level)
        if not (np.isfinite(level) and level > 0):
            raise CommonlawError("noise-not-positive", name=name, level=level)
        if name in columns:
            raise CommonlawError("noise-given-twice", name=name, column=columns[name])
    each = np.concatenate([np.where(np.isfinite(trial.states), trial.noise, np.nan) for trial in trials])
    noise |= {name: float(np.nanmedian(each[:, states.index(name)])) for name in columns}
    missing = [name for name in states if name not in noise and name not in trials.schema.starts]
    if missing:
        raise CommonlawError("noise-missing", states=missing)
    return np.array([noise.get(name, np.nan) for name in states], dtype=np.float64)


def by_columns(schema: Schema) -> str:
    """Return what columns noise is given by, if by any, as the end of a sentence."""
    columns = ", ".join(f"{state} by {column}" for state, column in schema.noise_columns.items())
    return f" for each measurement, {columns}; their median" if columns else ""


def parabola(times: Floats, values: Floats) -> Polynomial:
    return Polynomial.fit(times, values, min(2, len(times) - 1))


def _estimator(samples: int, name: str) -> tuple[int, int, Callable[[Floats, Floats], float], str]:
    """Return samples that the best estimator of a variance takes and spends, if there are so many; it; and its name."""
    if samples >= settings.MIN_SAMPLES:
        by_differences = "from differences of neighbouring samples"
        return settings.MIN_SAMPLES, 0, lambda t, x: float(noise_level(t, x[:, np.newaxis])[0]) ** 2, by_differences
    remedy = f"; known noise is given by `noise={{{name!r}: ...}}`"
    if samples > 3:
        about_parabolas = f"assumed: the scatter of all trials about parabolas{remedy}"
        return 4, 3, lambda t, x: float(np.sum((x - parabola(t, x)(t)) ** 2)) / (len(t) - 3), about_parabolas
    assumed = f"assumed: {100 * settings.ASSUMED_NOISE:g} % of the standard deviation of {name}{remedy}"
    return 2, 0, lambda _, x: (settings.ASSUMED_NOISE * float(np.std(x))) ** 2, assumed


def told_by_repeats(trials: Trials) -> Bools:
    """Return of which states repeated measurements estimate the noise, shape (states,)."""
    freedom = pure_error([trial.repeats for trial in trials], len(trials.schema.states))[1]
    return np.asarray(freedom >= settings.MIN_FREEDOM)


def estimated_noise(trials: Trials) -> tuple[Floats, str]:
    """Return the noise of each state, of all trials in which it changes, shape (d,), and what it was taken from.

    Of latent states it is NaN.
    """
    squares, weights = np.zeros((2, len(trials), len(trials.schema.states)))
    repeated, freedom = pure_error([trial.repeats for trial in trials], len(trials.schema.states))
    by_repeats, reasons = told_by_repeats(trials), list[str]()
    for j, name in enumerate(trials.schema.states):
        if name in trials.schema.starts:
            squares[:, j], weights[:, j] = np.nan, 1.0
            continue
        if by_repeats[j]:
            squares[:, j], weights[:, j] = repeated[j] / freedom[j], 1.0
            reasons.append("from repeated measurements")
            continue
        pairs = [(trial.times, trial.states[:, j]) for trial in trials]
        measured = [(times[~np.isnan(values)], values[~np.isnan(values)]) for times, values in pairs]
        counts = [len(values) * (len(np.unique(values)) > 1) for _, values in measured]
        if not any(counts):
            others = len(trials.schema.measured) > 1
            remedy = "take its column as a property instead" if others else "measure it while it changes"
            raise CommonlawError("state-constant", state=name, remedy=remedy)
        least, spent, variance, reason = _estimator(max(counts), name)
        for i, count in enumerate(counts):
            if count >= least:
                squares[i, j], weights[i, j] = variance(*measured[i]), count - spent
        reasons.append(reason)
    return np.sqrt(np.average(squares, axis=0, weights=weights)), "; ".join(dict.fromkeys(reasons))
