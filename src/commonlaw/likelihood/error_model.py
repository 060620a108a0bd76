"""How measurements and laws err beside white noise: the levels of every kind of error, together."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.likelihood.latent import LatentProcesses

ErrorKind = Literal["white", "proportional", "correlated", "walk", "force"]
"""White noise; white noise that also grows with the state; autocorrelated errors of the measurements; a law with a
random walk, or with a smooth force."""


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """The standard deviations of all errors beside white noise, in the units of the states and of time.

    Each is None if there is none of its kind.

    Parameters
    ----------
    proportional
        White noise of a measurement in proportion to the state: its share of each, shape (d,).
    correlated, memory
        An error of the measurement with a memory, see `LatentProcesses`, shape (d,), and a time.
    force, force_time
        A smooth force on each equation, see `LatentProcesses`, shape (d,), and a time.
    walk
        A random walk of the states (and their rates) that the law is added to, for a unit of time, shape (D,).
    """

    proportional: Floats | None = None
    correlated: Floats | None = None
    memory: float = np.inf
    force: Floats | None = None
    force_time: float = np.inf
    walk: Floats | None = None

    @property
    def kind(self) -> ErrorKind:
        """Of which kind these errors are."""
        kinds: tuple[ErrorKind, ...] = ("force", "correlated", "proportional", "walk")
        return next((kind for kind in kinds if getattr(self, kind) is not None), "white")

    @property
    def latent(self) -> LatentProcesses:
        """What is eliminated with the states."""
        return LatentProcesses(self.correlated, self.memory, self.force, self.force_time)

    @property
    def hyperparameters(self) -> int:
        """How many numbers there are, but for the random walk."""
        return self.latent.hyperparameters + (0 if self.proportional is None else len(self.proportional))

    def __bool__(self) -> bool:
        return any(each is not None for each in (self.proportional, self.correlated, self.force, self.walk))

    @property
    def of_law(self) -> bool:
        """Whether the law itself errs, and not the measurements alone."""
        return self.force is not None or self.walk is not None

    @property
    def rounds(self) -> int:
        """How often noise at the states, and the states, are found in turn: noise in proportion is so to fitted ones.

        Where states cross zero, those of a curve through the measurements would be far off.
        """
        return 1 if self.proportional is None else 2

    def white_std(self, states: Floats, noise: Floats) -> Floats:
        """Return the white noise at states, shape (n, d), from that at zero, shape (n, d) or (d,)."""
        return noise if self.proportional is None else noise * np.hypot(1.0, self.proportional / noise * states)

    def measurement_std(self, states: Floats, noise: Floats) -> Floats:
        """Return the standard deviation of a measurement about states, shape (n, d), see `white_std`."""
        correlated = 0.0 if self.correlated is None else self.correlated
        return np.hypot(self.white_std(states, noise), correlated) + np.zeros_like(states)


NO_ERRORS = ErrorModel()
"""White noise alone."""
