"""Whether measurements have outliers, of either scheme: fits by least squares and by the Huber loss compared.

An outlier counts linearly by the Huber loss (Huber 1964), and is as likely as a measurement at its threshold. As the
noise is that of the measurements within it, there may be several fixed points; fits begin from noise of median
residuals (Hampel et al. 1986, Robust Statistics, section 2.5).
"""

from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation.noise import MEDIAN_SIZE
from commonlaw.likelihood.observation_model import VERY_STRONG

F = TypeVar("F")


def likelier_loss(squares: F, robust: Iterable[F], deviance: Callable[[F], float]) -> F:
    """Return the fit by the Huber loss of least deviance if the evidence for outliers is very strong.

    Otherwise it is that of least squares. The deviance is minus twice the log-likelihood, see `capped`.
    """
    best, least = squares, deviance(squares) - VERY_STRONG
    for fit in robust:
        if (value := deviance(fit)) < least:
            best, least = fit, value
    return best


def capped(sizes: Floats, threshold: float) -> Floats:
    """Return the squares of standardized residuals, those of outliers as at the threshold; it is infinite for none."""
    return np.asarray(np.minimum(np.abs(sizes), threshold) ** 2)


def median_noise(residuals: Floats) -> Floats:
    """Return the standard deviations of normal noise by median sizes of residuals, from shape (n, m) to (m,).

    It is zero of what was never measured.
    """
    columns = [column[np.isfinite(column)] for column in np.abs(residuals).T]
    return np.array([np.median(column) if len(column) else 0.0 for column in columns]) / MEDIAN_SIZE
