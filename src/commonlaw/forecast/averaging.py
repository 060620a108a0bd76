"""Forecasts averaged over what a law could be, by how probable each is."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.integration import Trajectory
from commonlaw.law.forecast import Forecast, Part


def averaged(parts: Sequence[Part]) -> Forecast:
    """Return the average of forecasts of the same trials, of which the first is that of the law itself.

    States are the mean, weighted with the probabilities, and intervals hold their share of the mixture of all. Where
    the law forecasts a trial whole, others that diverge in it do not count for it; where it diverges, it stands alone.
    """
    if len(parts) == 1:
        return parts[0].forecast
    first = parts[0].forecast
    weights = [_weights(parts, i) for i in range(len(first.trajectories))]
    moments = [_moments(parts, i, own) for i, own in enumerate(weights)]
    return replace(
        first,
        trajectories=tuple(own for own, _ in moments),
        std=None if first.std is None else tuple(std for _, std in moments),
        at_more_times=None if first.at_more_times is None else partial(_averaged_at, tuple(parts)),
        parts=tuple(each._replace(weights=tuple(own[k] for own in weights)) for k, each in enumerate(parts)),
    )


def _averaged_at(parts: Sequence[Part], times: Sequence[Floats]) -> Forecast:
    """Return the average of the forecasts at more times; a function of a module, as processes hand it to each other."""
    pairs = [(each, each.forecast.at_more_times) for each in parts]
    return averaged([each._replace(forecast=more(times)) for each, more in pairs if more])


def remarks_on(found: Forecast) -> tuple[str, ...]:
    """Return what else the law could be, in a sentence, where that moves a forecast by more than its own error.

    Nothing without standard deviations, or if there is no other law.
    """
    if found.std is None or len(found.parts) < 2:
        return ()
    own, farthest = found.parts[0].forecast, 0.0
    width = len(found.trials.schema.states)
    for i, (std, noise) in enumerate(zip(own.std or (), own.measurement_std(), strict=True)):
        middle = found.trajectories[i].states[:, :width]
        off = [(each.weights[i], each.forecast.trajectories[i].states[:, :width]) for each in found.parts]
        between = np.sqrt(sum(share * (states - middle) ** 2 for share, states in off if share))
        farthest = max(farthest, float(np.nanmax(between / np.hypot(std[:, :width], noise), initial=0.0)))
    if farthest <= 1:
        return ()
    other = found.parts[1]
    return (
        f"the law could also be {other.equations} (probability {other.probability:.2g}): forecasts are averaged over "
        f"{len(found.parts)} laws, and these differ by more than the forecast of one of them errs",
    )


def _weights(parts: Sequence[Part], trial: int) -> Floats:
    """Return what each forecast of a trial counts, shape (parts,)."""
    shares: Floats = np.array([each.probability for each in parts])
    whole = [_is_whole(each.forecast, trial) for each in parts]
    if not whole[0]:
        return np.asarray(np.eye(len(parts))[0])
    shares = shares * whole
    return np.asarray(shares / shares.sum())


def _is_whole(forecast: Forecast, trial: int) -> bool:
    std = None if forecast.std is None else forecast.std[trial]
    found = forecast.trajectories[trial]
    return found.outcome is None and bool(np.isfinite(found.states).all() and (std is None or np.isfinite(std).all()))


def _moments(parts: Sequence[Part], trial: int, weights: Floats) -> tuple[Trajectory, Floats]:
    """Return the mean trajectory of a trial and the standard deviation about it, shape (n, width)."""
    first = parts[0].forecast.trajectories[trial]
    kept = [(share, each.forecast) for share, each in zip(weights, parts, strict=True) if share]
    mean = np.sum([share * each.trajectories[trial].states for share, each in kept], axis=0)
    variance = np.zeros_like(mean)
    for share, each in kept:
        off = each.trajectories[trial].states - mean
        with np.errstate(invalid="ignore"):
            variance += share * ((0.0 if each.std is None else each.std[trial]) ** 2 + off**2)
    return replace(first, states=mean), np.sqrt(variance)
