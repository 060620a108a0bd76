"""Segments of trials, which are fitted as trials of their own: between jumps of inputs, or of long ones."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.inference import settings
from commonlaw.integration import jumps
from commonlaw.text import counted
from commonlaw.trials import Trial, Trials


def segment(trial: Trial, first: int, stop: int) -> Trial:
    """Return the samples from `first` to before `stop` of a trial, named after them."""
    return replace(trial.rows(slice(first, stop)), name=f"{trial.name}, samples {first + 1} to {stop}")


def between_jumps(trials: Trials) -> tuple[Trials, str]:
    """Return the trials in segments between jumps of inputs, see `jumps`, and where these are, empty if there is none.

    When an input jumps between two samples is not known, so that interval says nothing of the law: states begin anew
    after it. Latent states that begin at given values cannot.
    """
    schema = trials.schema
    if schema.input_interpolation != "jumps" or schema.initial_values:
        return trials, ""
    parts, counts = list[Trial](), np.zeros(len(schema.inputs), dtype=np.intp)
    for trial in trials:
        jump = jumps(trial.times, trial.inputs)
        cuts = _cuts(np.asarray(jump.any(axis=1)), np.isfinite(trial.states))
        counts += jump[[cut - 1 for cut in cuts[1:-1]]].sum(axis=0)
        parts += [trial] if len(cuts) == 2 else [segment(trial, *pair) for pair in pairwise(cuts)]
    if not counts.any():
        return trials, ""
    named = [f"{name} in {counted(int(n), 'interval')}" for name, n in zip(schema.inputs, counts, strict=True) if n]
    return trials.with_trials(parts), ", ".join(named)


def _cuts(jump: Bools, seen: Bools) -> list[int]:
    """Return the first samples of segments, and the number of samples, from which intervals have jumps, shape (n - 1,).

    Measured samples, shape (n, states), are at least as many in each segment as curves are smoothed from.
    """
    seen = seen[:, seen.any(axis=0)]
    before, cuts = np.cumsum(np.vstack([np.zeros(seen.shape[1], dtype=np.intp), seen]), axis=0), [0]
    for cut in (np.flatnonzero(jump) + 1).tolist():
        sizes = np.array([before[cut] - before[cuts[-1]], before[-1] - before[cut]])
        if (sizes >= settings.MIN_SMOOTHED).all():
            cuts.append(cut)
    return [*cuts, len(seen)]
