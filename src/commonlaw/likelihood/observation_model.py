"""What measurements are worth: the noise of each state, and what counts as an outlier."""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError

HUBER_THRESHOLD = 4.0
"""Standard deviations from which a measurement is an outlier: of normal noise, one in 16 000 is."""


@dataclass(frozen=True, eq=False)
class ObservationModel:
    """White noise of each measured state.

    Parameters
    ----------
    noise
        Standard deviations, shape (d,), above zero.
    huber_threshold
        Deviations of more than so many standard deviations count linearly instead of squared (Huber 1964), so that
        outliers pull no harder than that; infinite for plain least squares.

    Raises
    ------
    CommonlawError
        If the threshold is not above zero.
    """

    noise: Floats
    huber_threshold: float = np.inf

    def __post_init__(self) -> None:
        if not isinstance(self.huber_threshold, int | float | np.number) or not self.huber_threshold > 0:
            raise CommonlawError("huber-threshold", value=self.huber_threshold)

    def deviance(self, residuals: Floats, scale: Floats | float = 1.0) -> float:
        """Return twice the negative log-likelihood but for a constant; residuals that are NaN were not measured.

        The standard deviation of each is the noise times the scale, of a shape that fits that of the residuals.
        """
        sizes = np.abs(residuals / (self.noise * scale))
        sizes = sizes[~np.isnan(sizes)]
        bound = self.huber_threshold
        far = sizes > bound
        return float(np.sum(sizes[~far] ** 2) + np.sum(2 * bound * sizes[far] - bound**2 if far.any() else 0.0))

    def weights(self, residuals: Floats, scale: Floats | float = 1.0) -> Floats:
        """Return the precision of each measurement, shape (n, d); zero where nothing was measured."""
        noise = self.noise * scale
        sizes = np.abs(residuals / noise)
        with np.errstate(invalid="ignore"):
            return np.where(np.isnan(sizes), 0.0, 1 / np.maximum(sizes / self.huber_threshold, 1.0)) / noise**2
