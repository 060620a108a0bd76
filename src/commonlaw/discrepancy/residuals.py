"""From a law and trials to what the measurements are off its trajectories."""

from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation import noise_level
from commonlaw.discrepancy.patterns import Residuals
from commonlaw.discrepancy.residual_tests import patterns
from commonlaw.errors import CommonlawError
from commonlaw.law import Law
from commonlaw.law.meeting import matched
from commonlaw.likelihood import NO_ERRORS
from commonlaw.trials import Trials
from commonlaw.trials.trial import with_typical


def residuals(law: Law, trials: Trials) -> Residuals:
    """Return what measurements are off the trajectories of a law, see `Law.residuals`."""
    if law.order == 0:
        raise CommonlawError("a law in discrete time has no trajectories that are fitted: score its forecasts instead")
    if not law.schema.doses:  # Which may be given where nothing was measured
        trials = trials.with_trials([each.measured() for each in trials])
    trials = matched(law, trials)
    noise = _noise(trials) if law.noise is None else law.noise
    known = replace(law.uncertainty, noise=noise, error_model=NO_ERRORS)
    longest = max(map(len, trials))
    forecast = replace(law, uncertainty=known).predict(trials, start=longest, averaged=False)
    forecast = forecast.followed or forecast
    fitted = tuple(each.states for each in forecast.trajectories)
    states, errors = len(law.states), law.uncertainty.error_model
    standardized = []
    for trial, own in zip(forecast.trials, fitted, strict=True):
        std = errors.measurement_std(own[:, :states], with_typical(trial.noise, noise))
        standardized.append((trial.states - own[:, :states]) / std)
    found = Residuals(forecast.trials, fitted, tuple(standardized), law.rates, ())
    spent = np.array(law.order) * len(trials) + _spent(law, trials)
    return replace(found, patterns=patterns(law.states, standardized, found.columns, law.schema.time, spent.tolist()))


def _spent(law: Law, trials: Trials) -> Floats:
    """Return how many coefficients of each equation were fitted to these trials, shape (states,).

    Those that learned from other objects count as far as they follow the object's own trials: by the trace of their
    covariance times the information that these alone hold.
    """
    there = [law.objects.index(name) for name in trials.objects if name in law.objects]
    found, known, unpooled = np.zeros(law.support.shape), law.uncertainty.covariance, law.uncertainty.unpooled
    shares = np.ones((len(law.objects), int(law.support.sum())))
    if known is not None:
        own = known if unpooled is None else unpooled.covariance
        scales = np.sqrt(np.diagonal(own, axis1=1, axis2=2))[:, :, np.newaxis]
        scales = np.where(scales > 0, scales, np.inf)
        alike = scales * scales.transpose(0, 2, 1)
        information = np.linalg.pinv(own / alike, hermitian=True)
        shares = np.clip(np.einsum("nij,nji->ni", known / alike, information), 0.0, 1.0)
    found[law.support] = shares[there].sum(axis=0)
    return np.asarray(found.sum(axis=1))


def _noise(trials: Trials) -> Floats:
    """Return the noise of each state from differences of neighbouring samples, shape (states,)."""
    squares = [noise_level(each.times, each.states) ** 2 for each in trials if each.complete]
    if not squares:
        raise CommonlawError("this law does not know its noise, and no trial is complete to tell it: refine the law")
    return np.asarray(np.sqrt(np.mean(squares, axis=0)))
