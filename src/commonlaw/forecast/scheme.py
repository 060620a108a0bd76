"""What forecasts ask of a scheme: where trials start by their samples, and the solutions of a law from there."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.integration import Inputs, Trajectory
from commonlaw.law import Law
from commonlaw.likelihood import ErrorModel
from commonlaw.trials import Trial, Trials
from commonlaw.trials.trial import Property


@dataclass(frozen=True, eq=False)
class ForecastOptions:
    """How trials are forecast, see `Law.predict`; a state larger than the `limit` is not followed on."""

    start: int | Literal["all"] | None = None
    from_time: float | None = None
    return_std: bool = False
    method: str = "auto"
    tolerance: float = 1e-8
    seed: int | None = None
    input_interpolation: str | None = None
    limit: float | None = None


class Extended(NamedTuple):
    """A trial, the same with samples at all times that are forecast, and its inputs, known at any time."""

    trial: Trial
    whole: Trial
    inputs: Inputs


class Solved(NamedTuple):
    """A trajectory of what is measured, of n times, and its standard deviations, shape (n, m), if they were asked for.

    `latent` are states and rates, shape (n, D), unless the trajectory has them.
    """

    trajectory: Trajectory
    std: Floats | None
    latent: Floats | None


class PlannedTrial(NamedTuple):
    """A trial of an object that was not made: times, shape (n,), coefficients, shape (equations, terms), and inputs.

    What it has of its own is its `beginning`, see `AbstractScheme.beginning`.
    """

    object: str
    times: Floats
    coefficients: Floats
    beginning: Floats
    properties: Mapping[str, Property]
    inputs: Inputs | None


class Followed(NamedTuple):
    """The solution in a planned trial at n times: states and rates, shape (n, D), and what is `AbstractScheme.shown`.

    The latter, shape (n, m), and its derivatives by the coefficients in the support of the law, and then by the
    beginning of the trial, shape (n, m, p + q), are None without slopes and where the law diverges.
    """

    times: Floats
    states: Floats
    values: Floats | None = None
    slopes: Floats | None = None


class Measured(NamedTuple):
    """What is measured of a solution at n times, shape (n, m), with derivatives by coefficients and by the beginning.

    Errors are variances of white noise, shape (n m,), and the covariance of others.
    """

    values: Floats
    by_coefficients: Floats
    by_start: Floats
    white: Floats
    coloured: Floats | None


class AbstractStarted(ABC):
    """Trials of a law, log-scaled states by their logarithms, whose forecasts start somewhere."""

    law: Law
    trials: Trials

    @property
    @abstractmethod
    def inputs(self) -> list[Inputs]:
        """Those of each trial."""

    @property
    @abstractmethod
    def known_until(self) -> list[float]:
        """The time of the last sample of each trial that its initial state is estimated from."""

    @abstractmethod
    def solved(self, trials: Sequence[Trial]) -> list[Solved]:
        """Return the solutions at the samples of trials, which are those that started or these with more samples."""


class AbstractScheme(ABC):
    """How the solutions of a law are computed."""

    law: Law

    @abstractmethod
    def free_starts(self, trial: Trial) -> int:
        """Return how many unknowns a trial determines: initial values, and parameters that differ between trials."""

    @abstractmethod
    def check(self, options: ForecastOptions) -> None:
        """Refuse options that have no effect."""

    @abstractmethod
    def taken(self, trials: Trials) -> Trials:
        """Return trials as the scheme takes them, log-scaled states by their logarithms."""

    @abstractmethod
    def begin(self, trials: Trials, extended: Sequence[Extended], options: ForecastOptions) -> AbstractStarted:
        """Return where trials start by their first samples, or those before a time.

        Raises `CommonlawError` if the samples of a trial do not determine that.
        """

    @abstractmethod
    def beginning(self, start: Floats, std: Floats) -> tuple[Floats, Floats]:
        """Return what a trial has of its own, with standard deviations, infinite where it is estimated, shape (q,).

        They are initial states and rates on the scale on which these are followed, shape (D,), of which NaN follow from
        the law; and what is added to the parameters that differ between trials.
        """

    @property
    @abstractmethod
    def shown(self) -> tuple[str, ...]:
        """The names of what solutions show."""

    @abstractmethod
    def followed(self, trials: Sequence[PlannedTrial], slopes: bool, limit: float | None = None) -> list[Followed]:
        """Return the solutions in planned trials; a state larger than the limit is a divergence."""

    @abstractmethod
    def measured(self, name: str, followed: Followed) -> Measured | None:
        """Return what is measured of a solution of an object; None where the law diverges."""


WITHOUT_DRAWS = "this law, which draws no noise"


PLANNED_TOLERANCE = 1e-5
"""Relative error of a step of solutions in planned trials, where noise and errors of coefficients exceed it."""


def measurement_errors(
    errors: ErrorModel, noise: Floats, times: Floats, values: Floats, measured: Bools | slice = slice(None)
) -> tuple[Floats, Floats | None]:
    """Return the variances of white noise about values, shape (n, d), and the covariance of other errors.

    They are those of the m measured columns, shape (n m,) and (n m, n m).
    """
    white = np.broadcast_to(errors.white_std(values, noise), values.shape)[:, measured]
    variances, elapsed = white.ravel() ** 2, times - times[0]
    if errors.correlated is not None:
        kernel = np.exp(-np.abs(times[:, np.newaxis] - times) / errors.memory)
        return variances, np.kron(kernel, np.diag(np.square(errors.correlated[measured])))
    if errors.sensor_walk is not None:
        return variances, np.kron(np.minimum.outer(elapsed, elapsed), np.diag(np.square(errors.sensor_walk[measured])))
    if errors.offset is None:
        return variances, None
    levels = errors.offset, errors.root_mean_square_slope
    of_offset, of_slope = (np.diag(np.square(level[measured])) for level in levels)
    return variances, np.kron(np.ones((len(times),) * 2), of_offset) + np.kron(np.outer(elapsed, elapsed), of_slope)


def refuse_method(method: str, kind: str) -> None:
    """Refuse a method of integration for laws of a kind that have one of their own."""
    if method != "auto":
        raise CommonlawError("option-without-effect", option=f"method={method!r}", kind=kind)


def with_times(trial: Trial, inputs: Inputs, wanted: Floats) -> Trial:
    """Return a trial with samples at more times after its first, with linearly interpolated standard deviations."""
    index = np.interp(wanted, trial.times, np.arange(len(trial)))
    between = (wanted > trial.times[-1]) | (abs(index - np.round(index)) > 1e-9)
    if not between.any():
        return trial
    grid = np.concatenate([trial.times, wanted[between]])
    order = np.argsort(grid)
    more = (0, between.sum()), (0, 0)
    states, below = (np.pad(values, more, constant_values=np.nan)[order] for values in (trial.states, trial.below))
    noise = [np.interp(grid[order], trial.times, column, right=np.nan) for column in trial.noise.T]
    return replace(
        trial,
        times=grid[order],
        states=states,
        below=below,
        inputs=inputs.at(grid[order]),
        noise=np.stack(noise, axis=1),
        repeats=trial.repeats and trial.repeats.placed(np.flatnonzero(order < len(trial)), len(grid)),
    )
