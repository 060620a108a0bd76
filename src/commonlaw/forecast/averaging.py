"""Forecasts averaged over what a law could be, by how probable each is."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.forecast.forecast import Forecast, Part
from commonlaw.integration import Trajectory


def averaged(parts: Sequence[Part]) -> Forecast:
    """Return the average of forecasts of the same trials, of which the first is that of the law itself.

    States are medians over laws, weighted by their probabilities; standard deviations are about these, and intervals
    hold their share of the mixture. A law that diverges in a trial does not count for it; where all do, the law stands
    alone.
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
    """Return a sentence on rival laws where the law diverges, or where they shift a forecast by more than its error."""
    if len(found.parts) < 2:
        return ()
    own, farthest = found.parts[0], 0.0
    lost = [each.label for each, share in zip(found.trials, own.weights, strict=True) if not share]
    if lost:
        return (
            f"the law diverges in {', '.join(lost)}: its forecasts there average the other plausible laws, of total "
            f"posterior probability {1 - own.probability:.2g}",
        )
    if found.std is None:
        return ()
    width = len(found.trials.schema.states)
    for i, (std, noise) in enumerate(zip(own.forecast.std or (), own.forecast.measurement_std(), strict=True)):
        middle = found.trajectories[i].states[:, :width]
        others = [(each.weights[i], each.forecast.trajectories[i].states[:, :width]) for each in found.parts]
        between = np.sqrt(sum(share * (states - middle) ** 2 for share, states in others if share))
        farthest = max(farthest, float(np.nanmax(between / np.hypot(std[:, :width], noise), initial=0.0)))
    if farthest <= 1:
        return ()
    other = found.parts[1]
    return (
        f"{other.equations} is also plausible (posterior probability {other.probability:.2g}): forecasts average "
        f"{len(found.parts)} laws, which differ by more than the standard error of one forecast",
    )


def _weights(parts: Sequence[Part], trial: int) -> Floats:
    """Return what each forecast of a trial counts, shape (parts,)."""
    shares: Floats = np.array([each.probability for each in parts])
    whole = np.zeros(len(parts), dtype=np.bool_)
    for k, (forecast, trajectory) in enumerate((each.forecast, each.forecast.trajectories[trial]) for each in parts):
        std = 0.0 if forecast.std is None else forecast.std[trial]
        whole[k] = trajectory.outcome is None and np.isfinite(trajectory.states).all() and np.isfinite(std).all()
    if not whole.any():
        return np.asarray(np.eye(len(parts))[0])
    return np.asarray(shares * whole / shares[whole].sum())


def _moments(parts: Sequence[Part], trial: int, weights: Floats) -> tuple[Trajectory, Floats]:
    """Return the median trajectory of a trial and the standard deviation about it, shape (n, width)."""
    kept = [(share, each.forecast) for share, each in zip(weights, parts, strict=True) if share]
    states = np.array([each.trajectories[trial].states for _, each in kept])
    median = _weighted_median(states, weights[weights > 0])
    variance = np.zeros_like(median)
    for (share, each), own in zip(kept, states, strict=True):
        with np.errstate(invalid="ignore"):
            variance += share * ((0.0 if each.std is None else each.std[trial]) ** 2 + (own - median) ** 2)
    return replace(kept[0][1].trajectories[trial], states=median), np.sqrt(variance)


def _weighted_median(values: Floats, weights: Floats) -> Floats:
    """Return the least of the values, shape (k, ...), up to which half of the weight lies; shape (...)."""
    order = np.argsort(values, axis=0)
    reached = np.cumsum(weights[order], axis=0) >= 0.5 * (1 - 1e-12)
    found = np.take_along_axis(order, reached.argmax(axis=0)[np.newaxis], axis=0)
    return np.asarray(np.take_along_axis(values, found, axis=0)[0])
