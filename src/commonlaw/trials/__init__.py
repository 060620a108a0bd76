"""Trials: what was measured, on which object, and when."""

from commonlaw.trials.stream import TrialStream
from commonlaw.trials.trial import Schema, Trial
from commonlaw.trials.trials import Trials

__all__ = ["Schema", "Trial", "TrialStream", "Trials"]
