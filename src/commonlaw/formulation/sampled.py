"""Rows for each sample: the strong form by derivatives, with their accuracy, and the discrete form."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation import AbstractDifferentiator, Rates
from commonlaw.errors import CommonlawError
from commonlaw.formulation.base import AbstractSampledForm, Segment, check_order
from commonlaw.library import Order, Terms, highest_order, order_of_each, split_derivatives
from commonlaw.trials import Trial


@dataclass(frozen=True)
class StrongForm(AbstractSampledForm):
    """Rows of ``x' = f(x)`` or ``x'' = f(x, x')``, one for each sample of a trial.

    Raises `CommonlawError` if an argument does not fit.

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
    """

    differentiation: AbstractDifferentiator
    order: Order = 1
    library_states: Literal["smoothed", "measured"] = "smoothed"
    trim: int = 0

    def __post_init__(self) -> None:
        for order in order_of_each(self.order, 1):
            check_order(order)
        if not isinstance(self.library_states, str) or self.library_states not in ("smoothed", "measured"):
            raise CommonlawError("library-states", library_states=self.library_states)
        if not isinstance(self.trim, int | np.integer) or self.trim < 0:
            raise CommonlawError("trim-not-a-number", trim=self.trim)

    @property
    def takes_missing(self) -> bool:
        return self.differentiation.takes_missing and self.library_states == "smoothed"

    def rates(self, trial: Trial) -> Rates:
        """Return smoothed states and derivatives of one trial; errors name the trial."""
        try:
            return self.differentiation.differentiate(trial.times, trial.states, highest_order(self.order))
        except CommonlawError as error:
            raise error.at(trial.label) from None

    def span(self, trial: Trial) -> tuple[int, int]:
        first, last = self.trim, len(trial) - self.trim
        if first >= last:
            raise CommonlawError("trim-too-long", where=trial.label, samples=len(trial), trim=self.trim)
        return first, last

    def segments(self, trial: Trial, cuts: list[int]) -> Iterator[Segment]:
        (first, last), rates = self.span(trial), self.rates(trial)
        states = rates.states if self.library_states == "smoothed" else trial.states
        together = 8192  # Samples whose rows are made at a time
        for start, stop in pairwise(sorted({first, last, *cuts, *range(first, last, together)})):
            lower, targets = split_derivatives([derivative[start:stop] for derivative in rates.derivatives], self.order)
            columns = [states[start:stop].T, lower.T, trial.inputs[start:stop].T, trial.times[np.newaxis, start:stop]]
            yield start, np.concatenate(columns).T, targets


@dataclass(frozen=True)
class DiscreteForm(AbstractSampledForm):
    """Rows of ``x[k+1] = f(x[k])``, or with inputs ``x[k+1] = f(x[k], u[k])``: one for each sample but the last.

    Examples
    --------
    >>> import numpy as np, commonlaw as cl
    >>> generations = np.arange(20.0)
    >>> colony = cl.Trials.from_arrays(generations, 5 * 0.8**generations, names=["n"])
    >>> cl.discover(colony, order=0, library="poly:1").equations()
    ('n[k+1] = 0.8 n',)
    """

    def span(self, trial: Trial) -> tuple[int, int]:
        if len(trial) < 2:
            raise CommonlawError("discrete-one-sample", where=trial.label)
        return 0, len(trial) - 1

    def segments(self, trial: Trial, cuts: list[int]) -> Iterator[Segment]:
        self.span(trial)
        steps = np.diff(trial.times)
        far = np.flatnonzero(np.abs(steps - np.median(steps)) > 0.01 * np.median(steps))
        if len(far):  # Not one step of the same law
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


TrialDerivatives = dict[tuple[str, str], tuple[Floats, Floats]]
"""Times and derivatives of the states, shape (n, states), by object and name of a trial."""


@dataclass(frozen=True, eq=False)
class GivenForm(AbstractSampledForm):
    """Rows of ``x' = f(x)``, one for each sample of a trial, with derivatives that are given."""

    derivatives: TrialDerivatives

    def span(self, trial: Trial) -> tuple[int, int]:
        return 0, len(trial)

    def segments(self, trial: Trial, cuts: list[int]) -> Iterator[Segment]:
        times, derivatives = self.derivatives[trial.object, trial.name]
        targets = derivatives[np.searchsorted(times, trial.times)]
        values = np.concatenate([trial.states, trial.inputs, trial.times[:, np.newaxis]], axis=1)
        for start, stop in pairwise([0, *cuts, len(trial)]):
            yield start, values[start:stop], targets[start:stop]


SAMPLES = 4096
"""Samples of a trial that are looked at, at most."""


def effective_share(form: StrongForm, trial: Trial) -> float:
    """Return the share of a trial's rows that count as independent, above 0 and at most 1.

    White noise on the states makes noise on the targets with the autocorrelation of the derivative's impulse response
    d: ``rho_k = sum_i d_i d_(i+k) / sum_i d_i^2``. The residual variance of n rows is as certain as that of ``n / sum_k
    rho_k^2`` independent ones (Bayley and Hammersley 1946, "The effective number of independent observations in an
    autocorrelated time series"). The response is measured on the trial, around its states, by an impulse in the middle;
    a method that does not respond to it, such as a median, counts one row a window.

    Raises `CommonlawError` if the trial cannot be differentiated.
    """
    middle = slice(max(0, (len(trial) - SAMPLES) // 2), (len(trial) + SAMPLES) // 2)
    times, states = trial.times[middle], trial.states[middle]
    pushed, highest = states.copy(), highest_order(form.order)
    pushed[len(states) // 2] += 1e-3 * states.std(axis=0)  # Methods may be linear only locally
    try:
        before, after = (
            split_derivatives(form.differentiation.differentiate(times, values, highest).derivatives, form.order)[1]
            for values in (states, pushed)
        )
    except CommonlawError as error:
        raise error.at(trial.label) from None
    response = after - before
    response = response[:, np.any(response != 0, axis=0)]
    if not response.size:
        reach = form.differentiation.reach(highest)
        return 1 / len(states) if reach is None else 1 / (2 * reach + 1)
    response /= np.abs(response).max(axis=0)  # Fourth powers of it neither overflow nor vanish
    # The transform of a response's autocorrelation is its power; twice the length keeps the ends apart
    power = np.abs(np.fft.fft(response, 2 * len(response), axis=0)) ** 2
    return float(np.mean(power.mean(axis=0) ** 2 / np.mean(power**2, axis=0)))


def differentiation_bias(
    form: StrongForm, terms: Terms, trials: Sequence[Trial], target: int, coefficients: Floats
) -> float:
    """Return the mean squared error of the differentiator itself in the targets of one equation.

    Long steps and wide windows leave an error that is a function of the state, which further terms fit, on held-out
    data too. A round trip measures it: rates by the equation along trials of an object are integrated and
    differentiated again. The coefficients, shape (terms,), should follow the rates but not their noise: those of least
    error on held-out data.

    Raises `CommonlawError` if a trial cannot be differentiated.
    """
    from scipy.interpolate import CubicSpline

    whole, errors = replace(form, trim=0), list[Floats]()
    for trial in trials:
        order = order_of_each(form.order, trial.states.shape[1])[target]
        values, _ = whole.samples(trial)
        rates = terms.evaluate(values) @ coefficients
        state = CubicSpline(trial.times, rates).antiderivative(order)(trial.times)
        # Constants and straight lines are lost on the way; the trial's own ends give them back
        measured = trial.states[:, target]
        missing = np.where(np.isnan(measured), values[:, target], measured) - state
        elapsed = (trial.times - trial.times[0]) / (trial.times[-1] - trial.times[0])
        state += missing[0] + (missing[-1] - missing[0]) * elapsed * (order > 1)
        again = form.differentiation.differentiate(trial.times, state[:, np.newaxis], order).derivatives[-1][:, 0]
        errors.append((again - rates)[form.trim : len(trial) - form.trim])
    return float(np.mean(np.concatenate(errors) ** 2))
