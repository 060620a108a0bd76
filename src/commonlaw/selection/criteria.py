"""Information criteria: how well an equation fits, and what its coefficients cost.

Every object has Gaussian residuals of a variance of its own, so a criterion is a sum over objects, and each object's
coefficients are counted: one for each of its terms. The smallest value is best; only differences mean something.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import lgamma

import numpy as np

from commonlaw.array_types import Floats


@dataclass(frozen=True, eq=False)
class FitStatistics:
    """What criteria are computed from.

    Parameters
    ----------
    rows
        Effective number of rows of each object, shape (objects,).
    variances
        Mean squared residual of each object, shape (objects,), above zero.
    terms
        Number of terms of each object, shape (objects,).
    library
        Number of terms that there were to choose from.
    shared
        Whether one choice of terms was made for all objects; otherwise each object had a choice of its own.
    """

    rows: Floats
    variances: Floats
    terms: Floats
    library: int
    shared: bool

    @property
    def deviance(self) -> float:
        """Twice the negative log-likelihood, but for a constant: ``sum_o n_o log(RSS_o / N_o)``."""
        return float(self.rows @ np.log(self.variances))


def aic(fit: FitStatistics) -> float:
    """Return ``deviance + 2 sum_o k_o`` (Akaike 1974, "A new look at the statistical model identification")."""
    return fit.deviance + 2 * float(fit.terms.sum())


def aicc(fit: FitStatistics) -> float:
    """Return ``deviance + sum_o 2 (k_o + 1) n_o / (n_o - k_o - 2)``, infinite where there are too few rows.

    Hurvich and Tsai (1989), "Regression and time series model selection in small samples"; the variance is counted.
    """
    left = fit.rows - fit.terms - 2
    if np.any(left <= 0):
        return np.inf
    return fit.deviance + float(np.sum(2 * (fit.terms + 1) * fit.rows / left))


def bic(fit: FitStatistics) -> float:
    """Return ``deviance + sum_o k_o log n_o`` (Schwarz 1978, "Estimating the dimension of a model")."""
    return fit.deviance + float(fit.terms @ np.log(fit.rows))


def ebic(fit: FitStatistics) -> float:
    """Return the BIC plus ``2 log`` of the number of ways to choose so many terms from the library.

    Chen and Chen (2008), "Extended Bayesian information criteria for model selection with large model spaces", with
    their gamma of one. A support that objects share is chosen once.
    """
    choices = fit.terms[:1] if fit.shared else fit.terms
    return bic(fit) + 2 * sum(log_choices(fit.library, int(terms)) for terms in choices)


CRITERIA: Mapping[str, Callable[[FitStatistics], float]] = {"aic": aic, "aicc": aicc, "bic": bic, "ebic": ebic}


def log_choices(library: int, size: int) -> float:
    """Return the logarithm of the number of ways to choose so many terms from a library."""
    return lgamma(library + 1) - lgamma(size + 1) - lgamma(library - size + 1)
