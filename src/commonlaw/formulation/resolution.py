"""How far the targets are off because samples are a step apart."""

import numpy as np
from numpy.typing import NDArray

from commonlaw.errors import CommonlawError
from commonlaw.formulation.strong import StrongForm
from commonlaw.trials import Trial

Floats = NDArray[np.float64]

_SAMPLES = 4096
"""Samples of a trial that are looked at, at most."""


def resolution(form: StrongForm, trial: Trial) -> Floats:
    """Return the mean squared error of a trial's targets that comes from its step, shape (equations,).

    The targets are estimated again from every second and from every fourth sample. With differences d1 between steps
    of one and two, d2 between steps of two and four, and r = d2 / d1, the error at a step of one is ``d1 / (r - 1)``
    (Richardson 1911; r is 2 to the power of the method's order), here at most ``d1 / 2``. Where r is below 1,
    coarser steps agree better than finer ones: the differences are noise, and zero is returned, as for a trial
    too short to tell.
    """
    middle = slice(max(0, (len(trial) - _SAMPLES) // 2), (len(trial) + _SAMPLES) // 2)
    times, states = trial.times[middle], trial.states[middle]
    try:
        fine, double, fourfold = (
            form.differentiation.differentiate(times[::step], states[::step], form.order).derivatives[-1]
            for step in (1, 2, 4)
        )
    except CommonlawError:
        return np.zeros(states.shape[1])
    inside = slice(form.trim, len(fourfold) - form.trim)
    small = np.mean((fine[::4] - double[::2])[inside] ** 2, axis=0)
    large = np.mean((double[::2] - fourfold)[inside] ** 2, axis=0)
    ratio = np.sqrt(large / np.maximum(small, np.finfo(float).tiny))
    return np.where(ratio > 1, small / (np.maximum(ratio, 3) - 1) ** 2, 0.0)
