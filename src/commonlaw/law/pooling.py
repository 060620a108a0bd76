"""Coefficients of several objects, drawn to their mean as far as they are alike (parametric empirical Bayes).

An object's own estimate is seen as its true coefficients plus an error of known covariance, and the true coefficients
as drawn from a normal distribution over objects, whose means and variances the objects tell together (Efron and Morris
1975). How alike a coefficient is stays uncertain with few objects; its shrinkage is averaged over what is plausible,
and what that leaves open is added to the covariance (Morris 1983).
"""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats

_SWEEPS = 3
"""How often each variance is found again, given the others."""

_STEP = np.sqrt(10)
"""Ratio of neighbouring variances that are tried: what is between them matters little."""

_BEYOND = 30.0
"""The largest and smallest variances that are tried are so far beyond those that can be told from larger and
smaller."""

_OWN = 1e6
"""Times the largest variance that is tried: infinite."""

_JITTER = 1e-12
"""Of unit variances, for covariances that are singular to rounding."""


@dataclass(frozen=True, eq=False)
class Pooled:
    """Coefficients drawn to their means.

    Parameters
    ----------
    estimates
        Shape (objects, parameters).
    covariances
        Shape (objects, parameters, parameters).
    common
        What errors have in common through the means: the covariance of the estimates of two objects is the product of
        one's matrix with the other's transposed. Shape (objects, parameters, parameters).
    shrinkage
        How far, from 0 (each object's own) to 1 (all alike), mean over objects, shape (parameters,).
    """

    estimates: Floats
    covariances: Floats
    common: Floats
    shrinkage: Floats


def pool(estimates: Floats, covariances: Floats, variances: Floats) -> Pooled:
    """Draw estimates to their means.

    Parameters
    ----------
    estimates
        Each object's own, shape (objects, parameters).
    covariances
        Of their errors, positive definite, shape (objects, parameters, parameters).
    variances
        Of each parameter over objects, shape (parameters,): zero for one that all have in common, infinite for one that
        is each object's own, NaN where the objects are to tell.
    """
    units = np.sqrt(np.mean(np.diagonal(covariances, axis1=1, axis2=2), axis=0))
    own = estimates / units
    errors = covariances / np.outer(units, units) + _JITTER * np.eye(len(units))
    grids = _grids(own, errors)
    asked = [int(index) for index in np.flatnonzero(np.isnan(variances))]
    variances = np.where(variances == 0, 0.0, np.where(np.isinf(variances), _OWN, 1.0) * [grid[-1] for grid in grids])
    doubts = np.zeros_like(errors)
    for _ in range(_SWEEPS):
        doubts[:] = 0.0
        for j in asked:
            grid = grids[j]
            tried = np.tile(variances, (len(grid), 1))
            tried[:, j] = grid
            models = _Model.of(own, errors, tried)
            weights = models.weights(j)
            gaps = models.estimates - np.einsum("m,mok->ok", weights, models.estimates)
            doubts += np.einsum("m,moj,mok->ojk", weights, gaps, gaps)
            variances[j] = _at(float(weights @ models.shrinkage[:, j]), models.shrinkage[:, j], grid)
    final = _Model.of(own, errors, variances[np.newaxis])
    return Pooled(
        final.estimates[0] * units,
        (final.covariances[0] + doubts) * np.outer(units, units),
        final.common[0] * units[:, np.newaxis],
        final.shrinkage[0],
    )


def _grids(own: Floats, errors: Floats) -> list[Floats]:
    """Return the variances over objects that are tried for each parameter, the first of them zero."""
    between = np.var(own, axis=0)
    # What is left of an error where all other coefficients are known, and all of it
    alone = 1 / np.mean(np.diagonal(np.linalg.inv(errors), axis1=1, axis2=2), axis=0)
    low, high = alone / _BEYOND, (1 + between) * _BEYOND
    counts = np.ceil(np.log(high / low) / np.log(_STEP)).astype(int)
    return [np.concatenate([[0.0], a * _STEP ** np.arange(n + 1)]) for a, n in zip(low, counts, strict=True)]


def _at(wanted: float, shrinkage: Floats, grid: Floats) -> float:
    """Return the variance of this shrinkage, between those of a grid that begins with zero."""
    order = np.argsort(shrinkage)
    logarithms = np.log(np.maximum(grid, grid[1] / _BEYOND))
    found = float(np.exp(np.interp(wanted, shrinkage[order], logarithms[order])))
    return found if found > grid[1] / _BEYOND else 0.0


@dataclass(frozen=True, eq=False)
class _Model:
    """What follows from variances over objects, for several sets of them at once.

    Parameters
    ----------
    lost
        Minus twice the logarithm of their restricted likelihood, but for a constant, shape (models,).
    estimates
        Shape (models, objects, parameters).
    covariances, common
        Shape (models, objects, parameters, parameters).
    shrinkage
        Mean over objects, shape (models, parameters).
    """

    lost: Floats
    estimates: Floats
    covariances: Floats
    common: Floats
    shrinkage: Floats

    def weights(self, parameter: int) -> Floats:
        """Return how probable each model is if all shrinkages of a parameter are equally so before, shape (models,).

        This prior is proper, and fair for few objects too (Daniels 1999).
        """
        prior = abs(np.gradient(self.shrinkage[:, parameter]))
        weights = prior * np.exp((self.lost.min() - self.lost) / 2)
        return np.asarray(weights / weights.sum())

    @classmethod
    def of(cls, own: Floats, errors: Floats, variances: Floats) -> "_Model":
        """Return what follows from variances of shape (models, parameters)."""
        spread = variances[:, np.newaxis, :, np.newaxis] * np.eye(own.shape[1])
        weights = np.linalg.inv(errors + spread)
        total = np.linalg.inv(weights.sum(axis=1))
        pulled = np.einsum("moij,oj->moi", weights, own)
        means = np.einsum("mij,moj->mi", total, pulled)
        gaps = own - means[:, np.newaxis]
        back = np.matmul(errors, weights)
        lost = np.einsum("moi,moij,moj->m", gaps, weights, gaps)
        lost -= np.linalg.slogdet(weights)[1].sum(axis=1) + np.linalg.slogdet(total)[1]
        common = np.matmul(back, np.linalg.cholesky(total)[:, np.newaxis])
        covariances = errors - np.matmul(back, errors) + np.matmul(common, common.swapaxes(-1, -2))
        return cls(
            lost,
            own - np.einsum("moij,moj->moi", back, gaps),
            covariances,
            common,
            np.diagonal(back, axis1=2, axis2=3).mean(axis=1),
        )
