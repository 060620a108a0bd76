"""Trials: what was measured, on which object, and when."""

from commonlaw.trials.arrays import trials_from_arrays
from commonlaw.trials.clip import clip_irregular
from commonlaw.trials.stream import TrialStream
from commonlaw.trials.tables import read_trials, trials_from_frame
from commonlaw.trials.trial import Schema, Trial
from commonlaw.trials.trials import Trials

__all__ = [
    "Schema",
    "Trial",
    "TrialStream",
    "Trials",
    "clip_irregular",
    "read_trials",
    "trials_from_arrays",
    "trials_from_frame",
]
