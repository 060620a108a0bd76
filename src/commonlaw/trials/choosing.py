"""What is kept of single trials: of those with some names, of samples up to a time."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.trials.identifiers import label
from commonlaw.trials.trial import Schema, Trial


@dataclass(frozen=True)
class Named:
    """Keeps trials that have one of some names, for each role (``object``, ``trial``), or all others.

    Parameters
    ----------
    names
        The labels by role.
    others
        Whether the others are kept.
    """

    names: dict[str, frozenset[str]]
    others: bool = False

    def __call__(self, trial: Trial) -> Trial | None:
        return trial if self.fits(trial) != self.others else None

    def fits(self, trial: Trial) -> bool:
        """Return whether a trial has these names."""
        return all(name_of(trial, role) in own for role, own in self.names.items())


@dataclass(frozen=True)
class Until:
    """Keeps the samples up to a time, and nothing of trials that begin later."""

    time: float

    def __call__(self, trial: Trial) -> Trial | None:
        stop = int(np.searchsorted(trial.times, self.time, side="right"))
        return trial.cut(stop) if stop else None


def name_of(trial: Trial, role: str) -> str:
    """Return the name of a trial, or of its object."""
    return trial.object if role == "object" else trial.name


def labels(wanted: object) -> list[str]:
    """Return the labels of a name, or of several."""
    return [label(each) for each in listed(wanted)]


def listed(value: object) -> list[Any]:
    """Return a list of values, or one of a single value, which may be a text."""
    return list(value) if isinstance(value, Iterable) and not isinstance(value, str) else [value]


def all_begin_later(schema: Schema, time: float) -> CommonlawError:
    """Return the error for a time before which no trial begins."""
    return CommonlawError("trials-begin-later", time_name=schema.time, time=time)


def all_fit() -> CommonlawError:
    """Return the error for conditions that all trials fit where there have to be others."""
    return CommonlawError("split-one-sided")
