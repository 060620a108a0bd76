"""Rows for each sample: the strong form by derivatives, the discrete form by the next sample."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from commonlaw.differentiation import AbstractDifferentiator, Rates
from commonlaw.errors import CommonlawError
from commonlaw.formulation.base import AbstractSampledForm, Segment, check_order
from commonlaw.library import Order, highest_order, order_of_each, split_derivatives
from commonlaw.trials import Trial

_WHOLE = slice(None)

_SEGMENT = 8192
"""Samples that are differentiated together: few enough to stay in cache."""


@dataclass(frozen=True)
class StrongForm(AbstractSampledForm):
    """Rows of ``x' = f(x)`` or ``x'' = f(x, x')``, one for each sample of a trial.

    Parameters
    ----------
    differentiation
        How rates are estimated.
    order
        Order of the law: 1 or 2, or that of each equation.
    library_states
        Terms are evaluated on ``"smoothed"`` states, so that noise does not bias coefficients (regression dilution), or
        on ``"measured"`` ones, as in the group method of the founding paper.
    trim
        Rows left out at each end of a trial, where smoothing windows are one-sided and rates several times less
        accurate.

    Raises
    ------
    CommonlawError
        If an argument does not fit.
    """

    differentiation: AbstractDifferentiator
    order: Order = 1
    library_states: Literal["smoothed", "measured"] = "smoothed"
    trim: int = 0

    def __post_init__(self) -> None:
        for each in order_of_each(self.order, 1):
            check_order(each)
        if self.library_states not in ("smoothed", "measured"):
            raise CommonlawError("library-states", library_states=self.library_states)
        if not isinstance(self.trim, int | np.integer) or self.trim < 0:
            raise CommonlawError("trim-not-a-number", trim=self.trim)

    @property
    def takes_missing(self) -> bool:
        return self.differentiation.takes_missing and self.library_states == "smoothed"

    def rates(self, trial: Trial, segment: slice = _WHOLE) -> Rates:
        """Return smoothed states and derivatives of one trial, or of a segment of it; errors name the trial."""
        try:
            highest = highest_order(self.order)
            return self.differentiation.differentiate(trial.times[segment], trial.states[segment], highest)
        except CommonlawError as error:
            if segment != _WHOLE:
                self.rates(trial)  # Its message counts the samples of the whole trial
            raise error.at(trial.label) from None

    def span(self, trial: Trial) -> tuple[int, int]:
        first, last = self.trim, len(trial) - self.trim
        if first >= last:
            raise CommonlawError("trim-too-long", where=trial.label, samples=len(trial), trim=self.trim)
        return first, last

    def segments(self, trial: Trial, cuts: list[int]) -> Iterator[Segment]:
        first, last = self.span(trial)
        reach = self.differentiation.reach(highest_order(self.order))
        local = reach is not None and len(trial) > _SEGMENT
        edges = sorted({first, last, *cuts, *(range(first, last, _SEGMENT) if local else ())})
        # Twice the reach, so that a segment at an end of the trial is also long enough for a whole window
        halo = 2 * reach if local and reach is not None else len(trial)
        rates: Rates | None = None
        for start, stop in pairwise(edges):
            before = max(0, start - halo)
            if rates is None or local:
                rates = self.rates(trial, slice(before, stop + halo) if local else _WHOLE)
            inside = slice(start - before, stop - before)
            states = rates.states[inside] if self.library_states == "smoothed" else trial.states[start:stop]
            lower, targets = split_derivatives([each[inside] for each in rates.derivatives], self.order)
            columns = [states.T, lower.T, trial.inputs[start:stop].T, trial.times[np.newaxis, start:stop]]
            yield start, np.concatenate(columns).T, targets


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
