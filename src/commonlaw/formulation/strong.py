"""The strong form: the highest derivative, estimated from the samples, against the terms at the same samples."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from commonlaw.differentiation import AbstractDifferentiator, Rates
from commonlaw.errors import CommonlawError
from commonlaw.formulation.system import System
from commonlaw.library import Terms, Variables
from commonlaw.trials import Schema, Trial

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class StrongForm:
    """Rows of ``x' = f(x)`` or ``x'' = f(x, x')``, one for each sample of a trial.

    Parameters
    ----------
    differentiation
        How rates are estimated.
    order
        Order of the law: 1 or 2.
    library_states
        Which states the terms are evaluated on. ``"smoothed"`` takes the differentiator's smoothed states, so that
        states and rates come from one curve and noise does not bias the coefficients of terms in the states
        (regression dilution). ``"measured"`` takes them as measured, as the group method of the founding paper did.
    trim
        Rows left out at each end of a trial. A smoothing window is one-sided there, and its rates are several
        times less accurate than inside.
    """

    differentiation: AbstractDifferentiator
    order: int = 1
    library_states: Literal["smoothed", "measured"] = "smoothed"
    trim: int = 0

    def __post_init__(self) -> None:
        if self.order not in (1, 2):
            raise CommonlawError(
                f"order {self.order} is not supported: a law is of order 1 (x' = ...) or 2 (x'' = ...)"
            )
        if self.library_states not in ("smoothed", "measured"):
            raise CommonlawError(
                f"library states {self.library_states!r} are not known: choose 'smoothed' or 'measured'"
            )
        if self.trim < 0:
            raise CommonlawError(f"trim {self.trim} is negative: give the number of rows to leave out at each end")

    def variables(self, schema: Schema) -> Variables:
        """Return the variables of a law over trials of this schema: states, their rates if of order 2, inputs, time."""
        rates = rate_names(schema) if self.order == 2 else ()
        return Variables((*schema.states, *rates), schema.inputs, schema.time)

    def rates(self, trial: Trial) -> Rates:
        """Return smoothed states and derivatives of one trial; errors name the trial."""
        try:
            return self.differentiation.differentiate(trial.times, trial.states, self.order)
        except CommonlawError as error:
            raise CommonlawError(f"{trial.label}: {error}") from None

    def rows(self, trial: Trial, terms: Terms) -> tuple[Floats, Floats]:
        """Return the library rows, shape (n, terms), and the target rows, shape (n, equations), of one trial.

        Raises
        ------
        CommonlawError
            If the trial is too short or a term is not finite on it; the message names the trial and the sample.
        """
        values, targets = self.samples(trial)
        library = terms.evaluate(values)
        terms.check_finite(library, values, trial.label)
        return library, targets

    def samples(self, trial: Trial) -> tuple[Floats, Floats]:
        """Return the variables' values, shape (n, variables), and the highest derivatives, shape (n, states)."""
        inner = slice(self.trim, len(trial) - self.trim)
        if len(trial) <= 2 * self.trim:
            raise CommonlawError(
                f"{trial.label}: no row is left of {len(trial)} samples after trimming {self.trim} at each end; "
                "trim less"
            )
        rates = self.rates(trial)
        states = rates.states if self.library_states == "smoothed" else trial.states
        columns = [states, *rates.derivatives[: self.order - 1], trial.inputs, trial.times[:, np.newaxis]]
        return np.concatenate(columns, axis=1)[inner], rates.derivatives[self.order - 1][inner]

    def system(self, trials: Sequence[Trial], terms: Terms) -> System:
        """Return the rows of all `trials` of one object, compressed."""
        return reduce(add, (System.of(*self.rows(trial, terms)) for trial in trials))


def rate_names(schema: Schema) -> tuple[str, ...]:
    """Return the names of the states' rates: ``v`` for a single state, ``v_x`` and ``v_y`` for several."""
    plain = ["v"] if len(schema.states) == 1 else [f"v_{state}" for state in schema.states]
    taken = {*schema.states, *schema.inputs, schema.time}
    return tuple(f"{state}_rate" if name in taken else name for name, state in zip(plain, schema.states, strict=True))
