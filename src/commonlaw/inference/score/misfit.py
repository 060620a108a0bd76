"""Lack of fit of compared laws, by noise that does not come from the misfit of the law itself.

Squares of residuals z with nu degrees of freedom have the mean ``F = (sum z^2 / nu) / v``, near 1 for a law that fits.
The variance v is that of repeated measurements (Draper and Smith 1998, section 2.2), that of known noise, or of
residuals of another law of the same measurements. Residuals of a law that misses a curve are autocorrelated as well.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.inference.settings import EXACT, MISFIT_LEVEL
from commonlaw.likelihood.levels import Whitened, autocorrelation
from commonlaw.trials import Trial
from commonlaw.trials.trial import pure_error


@dataclass(frozen=True, eq=False)
class FittedResiduals:
    """Whitened residuals of trials about a fit, NaN for outliers.

    Degrees of freedom, repeats included, and which noise is known have shape (quantities,).
    """

    trials: Sequence[Trial]
    whitened: Sequence[Whitened]
    freedom: Floats
    known_noise: Bools

    def mean_square(self, k: int, by: "FittedResiduals") -> float:
        """Return the mean square of the residuals of a quantity over the noise `by` a fit; NaN without freedom."""
        scaled = [part.z * part.std / noise.std for part, noise in zip(self.whitened, by.whitened, strict=True)]
        freedom = self.freedom_of_means(k)
        return float(np.nansum(np.concatenate(scaled)[:, k] ** 2)) / freedom if freedom > 0 else np.nan

    def freedom_of_means(self, k: int) -> float:
        """Return the degrees of freedom of a quantity without those of repeats."""
        count = sum(int(np.isfinite(part.z[:, k]).sum()) for part in self.whitened)
        repeated = pure_error([trial.repeats for trial in self.trials], len(self.freedom))[1]
        return min(float(self.freedom[k] - repeated[k]), float(count))

    def lacks_fit(self, reference: "FittedResiduals") -> bool:
        """Say whether residuals of a quantity are autocorrelated, or too large for the noise by F-tests.

        The reference is the fit of another law to the same measurements, or this one.
        """
        from scipy.special import fdtrc

        single = [  # Squared deviations of repeats over variances of single measurements
            trial.repeats.squares / (part.white**2 * trial.repeats.counts)
            for trial, part in zip(self.trials, self.whitened, strict=True)
            if trial.repeats is not None
        ]
        repeated = pure_error([trial.repeats for trial in self.trials], len(self.freedom))[1]
        for k in range(len(self.freedom)):
            size, freedom = self.mean_square(k, self), self.freedom_of_means(k)
            if not size > EXACT:
                continue
            of_reference = max(reference.mean_square(k, reference), EXACT)
            tests = [(self.mean_square(k, reference) / of_reference, reference.freedom_of_means(k))]
            if self.known_noise[k]:
                tests.append((size, np.inf))
            if repeated[k] > 0:
                variance = float(np.nansum(np.concatenate(single)[:, k])) / repeated[k]
                tests.append((size / variance, repeated[k]))
            columns = [part.z[np.isfinite(part.z[:, k]), k] for part in self.whitened]
            products = np.concatenate([column[1:] * column[:-1] for column in columns])
            if any(fdtrc(freedom, below, statistic) < MISFIT_LEVEL for statistic, below in tests):
                return True
            if autocorrelation(np.concatenate(columns) ** 2, products):
                return True
        return False
