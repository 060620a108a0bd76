"""Estimates of measurement noise before any model: given, from replicates, rounding or differences of samples."""

from collections.abc import Callable, Mapping
from numbers import Real

import numpy as np
from numpy.polynomial import Polynomial

from commonlaw.array_types import Bools, Floats
from commonlaw.differentiation import noise_level
from commonlaw.differentiation.noise import rounding_noise, within_trial_std
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.trials import Schema, Trials
from commonlaw.trials.headers import find_name
from commonlaw.trials.transformations import refuse_overwhelming_noise
from commonlaw.trials.trial import pure_error


def initial_value_scales(trials: Trials) -> Floats:
    """Return the scales of latent states, shape (states,), from the standard deviations of their initial values."""
    std = np.max([trial.noise[0] for trial in trials], axis=0)
    return np.asarray(std / np.where(trials.schema.with_free_start, settings.VAGUE, settings.ROUNDING))


def noise_floor(trials: Trials) -> Floats:
    """Return the lower bound of the noise of each state under which laws are fitted, shape (d,).

    It is `MIN_NOISE` times the within-trial standard deviation, and at least the rounding noise; of latent states it is
    the standard deviation of their initial values.
    """
    measured = np.maximum(settings.MIN_NOISE * within_trial_std(trials), rounding_noise(trials))
    return np.where(trials.schema.is_latent, settings.ROUNDING * initial_value_scales(trials), measured)


def known_noise(noise: Mapping[str, float] | None, trials: Trials) -> Floats | None:
    """Return the given noise of each state, shape (states,), NaN for latent states; None if none is given.

    Names may have a unit, ``U [V]``. For states with a column of standard deviations it is their median.

    Raises `CommonlawError` if it is given for some measured states only, or twice for one; a name is not a state, or a
    value is not positive or far larger than all measurements.
    """
    states, columns = trials.schema.states, trials.schema.noise_columns
    if noise is None and not columns:
        return None
    noise = {find_name(name, states, "state"): level for name, level in (noise or {}).items()}
    for name, level in noise.items():
        if name in trials.schema.initial_values:
            raise CommonlawError("noise-of-latent", name=name)
        if not isinstance(level, Real):
            raise CommonlawError("setting-not-a-number", name=f"noise of {name}", value=level)
        if not (np.isfinite(level) and level > 0):
            raise CommonlawError("noise-not-positive", name=name, level=level)
        if name in columns:
            raise CommonlawError("noise-given-twice", name=name, column=columns[name])
    refuse_overwhelming_noise(trials, noise)
    stds = np.concatenate([np.where(np.isfinite(trial.states), trial.noise, np.nan) for trial in trials])
    noise |= {name: float(np.nanmedian(stds[:, states.index(name)])) for name in columns}
    missing = [name for name in states if name not in noise and name not in trials.schema.initial_values]
    if missing:
        raise CommonlawError("noise-missing", states=missing)
    return np.array([noise.get(name, np.nan) for name in states], dtype=np.float64)


def by_columns(schema: Schema) -> str:
    """Return the columns that give the noise, if any, as the end of a sentence."""
    columns = ", ".join(f"{state} by {column}" for state, column in schema.noise_columns.items())
    return f" for each measurement, {columns}; their median" if columns else ""


def parabola(times: Floats, values: Floats) -> Polynomial:
    """Return the least-squares polynomial of degree 2, or of the number of samples less one."""
    return Polynomial.fit(times, values, min(2, len(times) - 1))


def _estimator(samples: int, name: str) -> tuple[int, int, Callable[[Floats, Floats], float], str]:
    """Return the variance estimator for trials of so many samples.

    It is the least number of samples it takes, the degrees of freedom it spends, the estimator itself (of times and
    values), and its description.
    """
    if samples >= settings.MIN_SAMPLES:
        by_differences = "from differences of neighbouring samples"
        return settings.MIN_SAMPLES, 0, lambda t, x: float(noise_level(t, x[:, np.newaxis])[0]) ** 2, by_differences
    remedy = f"; known noise is given by `noise={{{name!r}: ...}}`"
    if samples > 3:
        about_parabolas = f"assumed: the scatter of all trials about parabolas{remedy}"
        return 4, 3, lambda t, x: float(np.sum((x - parabola(t, x)(t)) ** 2)) / (len(t) - 3), about_parabolas
    assumed = f"assumed: {100 * settings.ASSUMED_NOISE:g} % of the standard deviation of {name}{remedy}"
    return 2, 0, lambda _, x: (settings.ASSUMED_NOISE * float(np.std(x))) ** 2, assumed


def has_replicates(trials: Trials) -> Bools:
    """Return for which states replicates have enough degrees of freedom to estimate the noise, shape (states,)."""
    freedom = pure_error([trial.repeats for trial in trials], len(trials.schema.states))[1]
    return np.asarray(freedom >= settings.MIN_FREEDOM)


def estimated_noise(trials: Trials) -> tuple[Floats, str]:
    """Return the pooled noise of each state, shape (d,), NaN for latent states, and the description of its estimator.

    From replicates it is ``sqrt(SS / nu)`` with the pure-error sum of squares SS and its degrees of freedom nu;
    otherwise variances of single trials, in which the state varies, are averaged with their degrees of freedom as
    weights.
    """
    variances, weights = np.zeros((2, len(trials), len(trials.schema.states)))
    squares, freedom = pure_error([trial.repeats for trial in trials], len(trials.schema.states))
    replicated, reasons = has_replicates(trials), list[str]()
    for j, name in enumerate(trials.schema.states):
        if name in trials.schema.initial_values:
            variances[:, j], weights[:, j] = np.nan, 1.0
            continue
        if replicated[j]:
            variances[:, j], weights[:, j] = squares[j] / freedom[j], 1.0
            reasons.append("from repeated measurements")
            continue
        pairs = [(trial.times, trial.states[:, j]) for trial in trials]
        measured = [(times[~np.isnan(values)], values[~np.isnan(values)]) for times, values in pairs]
        counts = [len(values) * (len(np.unique(values)) > 1) for _, values in measured]
        if not any(counts):
            remedy = "measure it while it changes"
            if len(trials.schema.measured) > 1:
                remedy = "take its column as a property instead"
            raise CommonlawError("state-constant", state=name, remedy=remedy)
        least, spent, variance, reason = _estimator(max(counts), name)
        for i, count in enumerate(counts):
            if count >= least:
                variances[i, j], weights[i, j] = variance(*measured[i]), count - spent
        reasons.append(reason)
    return np.sqrt(np.average(variances, axis=0, weights=weights)), "; ".join(dict.fromkeys(reasons))
