"""What forecasts ask of a scheme: where trials start by their samples, and the solutions of a law from there."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.integration import Inputs, Trajectory
from commonlaw.law import Law
from commonlaw.trials import Trial, Trials


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


WITHOUT_DRAWS = "this law, which draws no noise"


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
