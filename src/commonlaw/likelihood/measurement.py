"""What measurements are worth: the noise of each state, and what counts as an outlier."""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats


@dataclass(frozen=True, eq=False)
class Measurement:
    """White noise of each measured state.

    Parameters
    ----------
    noise
        Standard deviations, shape (d,), above zero.
    bound
        Deviations of more than so many standard deviations count linearly instead of squared (Huber 1964), so that
        outliers pull no harder than that; infinite for plain least squares.
    """

    noise: Floats
    bound: float = np.inf

    def misfit(self, gaps: Floats) -> float:
        """Return twice the negative log-likelihood of gaps between measured and sought states, but for a constant.

        NaN where nothing was measured.
        """
        sizes = np.abs(gaps / self.noise)
        sizes = sizes[~np.isnan(sizes)]
        far = sizes > self.bound
        return float(
            np.sum(sizes[~far] ** 2) + np.sum(2 * self.bound * sizes[far] - self.bound**2 if far.any() else 0.0)
        )

    def weights(self, gaps: Floats) -> Floats:
        """Return what each squared gap counts, shape (n, d); zero where nothing was measured."""
        sizes = np.abs(gaps / self.noise)
        with np.errstate(invalid="ignore"):
            return np.where(np.isnan(sizes), 0.0, 1 / np.maximum(sizes / self.bound, 1.0)) / self.noise**2
