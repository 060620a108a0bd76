"""The discrete form: the next sample against the terms at this one."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.formulation.base import AbstractSampledForm, Segment
from commonlaw.trials import Trial

_UNEVEN = 0.01
"""Steps further than this share from the median step are not one step of the same law."""


@dataclass(frozen=True)
class DiscreteForm(AbstractSampledForm):
    """Rows of ``x[k+1] = f(x[k])``, or with inputs ``x[k+1] = f(x[k], u[k])``: one for each sample but the last."""

    @property
    def takes_missing(self) -> bool:
        return False

    def span(self, trial: Trial) -> tuple[int, int]:
        if len(trial) < 2:
            raise CommonlawError("discrete-one-sample", where=trial.label)
        return 0, len(trial) - 1

    def segments(self, trial: Trial, cuts: list[int]) -> Iterator[Segment]:
        steps = np.diff(trial.times)
        far = np.flatnonzero(np.abs(steps - np.median(steps)) > _UNEVEN * np.median(steps))
        if len(far):
            raise CommonlawError(
                "discrete-uneven",
                where=trial.label,
                sample=far[0] + 1,
                next_sample=far[0] + 2,
                step=steps[far[0]],
                median=np.median(steps),
            )
        values = np.concatenate([trial.states, trial.inputs, trial.times[:, np.newaxis]], axis=1)
        for start, stop in pairwise([0, *cuts, len(trial) - 1]):
            yield start, values[start:stop], trial.states[start + 1 : stop + 1]
