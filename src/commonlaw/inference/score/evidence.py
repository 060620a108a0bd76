"""The evidence for terms that objects share: what their coefficients cost, given how alike they are.

A coefficient that every object has is seen as drawn from a normal distribution over objects, whose mean and standard
deviation are estimated with it, see `commonlaw.hierarchy`. Terms whose coefficients are all alike, such as gravity,
then cost little more than one number; terms whose coefficients scatter cost one number for each object. For a single
object the evidence is the BIC.

What scatters over objects independently may be the coefficients, or may be mixtures of them: of a rate k (a - x), with
x counted from elsewhere, height and slope scatter together. Mixtures that are orthogonal, each to those before it, do
not depend on where variables are counted from. Both are as probable beforehand.
"""

from ctypes import CDLL
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Floats, Indices
from commonlaw.formulation import explained
from commonlaw.hierarchy import LIKELIEST_SWEEPS, WORST_CONDITION, RandomEffects, marginal_deviance, relative_variances
from commonlaw.inference.settings import COLLINEAR, MIN_SINGULAR_VALUE
from commonlaw.kernel import CONSTANTS, MeasuredStructure, address, kernel

(_MIN_COLUMN,) = CONSTANTS["MIN_COLUMN"]


@dataclass(frozen=True)
class Measured:
    """How many numbers were measured on all objects, and how surely they tell the scale of all noise.

    Parameters
    ----------
    count
        Numbers that were measured.
    freedom
        Degrees of freedom of the sum of squares that a law without coefficients leaves, with those that the noise
        estimated first is worth; infinite if the noise is known.
    prior
        The sum of squares that the first estimate of the noise is worth, in units of the noise that there is.
    outliers
        What outliers add to sums of squares, which says nothing of the noise.
    least
        The least variance that the noise can have, in units of that which there is.
    """

    count: int
    freedom: float = np.inf
    prior: float = 0.0
    outliers: float = 0.0
    least: float = 0.0

    def without(self, coefficients: int) -> "Measured":
        """Return the same when so many coefficients are fitted besides."""
        return replace(self, freedom=self.freedom - coefficients)

    def with_outliers(self, outliers: float, count: int) -> "Measured":
        """Return the same where so many outliers add this to sums of squares."""
        return replace(self, outliers=outliers, freedom=self.freedom - count)

    def variance(self, squares: float, coefficients: int) -> float:
        """Return the variance of the noise, in units of that which there is, by the squares that are left."""
        if np.isinf(self.freedom):
            return 1.0
        return float(self._variance(squares, max(self.freedom - coefficients, 1.0)))

    def deviance(self, squares: Floats | float, coefficients: int) -> Floats | float:
        """Return minus twice the log-likelihood of squares that are left, with the scale of the noise integrated out.

        That is by the t distribution, at the variance that is unbiased, and by the normal one at the least that the
        noise can have; for noise that is known these are the squares.
        """
        if np.isinf(self.freedom):
            return squares
        left = max(self.freedom - coefficients, 1.0)
        variance = self._variance(squares, left)
        return self.freedom * np.log(variance) + self._of_noise(squares) / variance

    def _variance(self, squares: Floats | float, left: float) -> Floats:
        return np.maximum(self._of_noise(squares) / left, self.least)

    def _of_noise(self, squares: Floats | float) -> Floats:
        return np.maximum(squares - self.outliers, 0.0) + self.prior


def minus_twice_log_evidence(
    factors: Floats, indices: Indices, measured: Measured, needed: float = np.inf, common: int = 0
) -> float:
    """Return minus twice the logarithm of the evidence for a support of one equation that all objects share.

    A mean costs the logarithm of the number of measurements on all objects, and a variance the logarithm of the number
    of objects (the BIC of the hierarchy); the scale of the noise is integrated out. Supports that do not come below
    what is needed get a lower bound of theirs, which takes less time.

    Parameters
    ----------
    factors
        The triangular factor of each object's least-squares problem, which has one target and residuals of unit
        variance, shape (objects, terms + 1, terms + 1).
    indices
        Of the terms. The coefficients of the last so many as are `common` do not differ between objects.
    """
    library = kernel()
    if library is not None:
        return _compiled(library, factors, indices, measured, needed, common)
    size = len(indices)
    reduced = np.asarray(np.linalg.qr(factors[:, :, [*indices, -1]], mode="r"))
    squares, own = float(np.sum(reduced[:, size:, size] ** 2)), size * len(factors)
    floor = float(measured.deviance(squares, own)) + cost_of_coefficients(size, len(factors), measured)
    if not size or floor >= needed:
        return floor
    norms = np.sqrt(np.mean(np.sum(reduced[:, :size, :size] ** 2, axis=1), axis=0))
    columns = reduced[:, :size, :size] / np.where(norms > 0, norms, 1.0)
    try:
        bases = [columns]
        if (
            size > 1 and len(factors) > 1
        ):  # The columns of all together so mixed that each is orthogonal to those before
            mixed = np.linalg.qr(columns.reshape(-1, size), mode="r")
            bases.append(np.asarray(np.matmul(columns, np.linalg.inv(mixed))))
        variance = measured.variance(squares, own)
        costs = np.array([_scatter_cost(basis, reduced[:, :size, size:], variance, common) for basis in bases])
    except np.linalg.LinAlgError:
        return np.inf
    costs = np.where(np.isnan(costs), np.inf, costs)
    found = floor - 2 * float(np.logaddexp.reduce(-costs / 2) - np.log(len(costs)))
    return found if np.isfinite(found) else np.inf


def _compiled(
    library: CDLL, factors: Floats, indices: Indices, measured: Measured, needed: float, common: int
) -> float:
    """Return the same by the kernel, to rounding."""
    worst = _worst_condition(len(factors))
    factors, chosen = np.ascontiguousarray(factors), np.ascontiguousarray(indices, dtype=np.int64)
    of_measured = MeasuredStructure(measured.count, measured.freedom, measured.prior, measured.outliers, measured.least)
    tried, result = relative_variances(), np.empty(1)
    failed = library.commonlaw_evidence(
        *(len(factors), factors.shape[2] - 1, address(factors), len(chosen), address(chosen), common),
        *(of_measured, needed, worst, len(tried), address(tried), LIKELIEST_SWEEPS, address(result)),
    )
    if failed:
        raise MemoryError
    return float(result[0])


def noise_variance(factors: Floats, indices: Indices, measured: Measured) -> float:
    """Return the variance of the noise that a support leaves, in units of that which there is, see `Measured`."""
    return measured.variance(residual_squares(factors, indices), len(indices) * len(factors))


def residual_squares(factors: Floats, indices: Indices) -> float:
    """Return the sum of squares that a support leaves on all objects."""
    left = np.asarray(np.linalg.qr(factors[:, :, [*indices, -1]], mode="r"))[:, -1, -1]
    return float(left @ left)


def _scatter_cost(columns: Floats, targets: Floats, variance: float, common: int) -> float:
    """Return what coefficients cost by their scatter, at a variance of the noise; infinite if not identifiable."""
    information = np.asarray(np.matmul(columns.transpose(0, 2, 1), columns))
    if not np.linalg.cond(information.sum(axis=0)) < _worst_condition(len(columns)):
        return np.inf
    determined = np.abs(np.diagonal(columns, axis1=1, axis2=2)).min(axis=1) > _MIN_COLUMN
    estimates = np.empty(columns.shape[:2])
    estimates[determined] = np.linalg.solve(columns[determined], targets[determined])[..., 0]
    ridge = _MIN_COLUMN**2 * np.eye(columns.shape[1])
    projected = np.matmul(columns[~determined].transpose(0, 2, 1), targets[~determined])
    estimates[~determined] = np.linalg.solve(information[~determined] + ridge, projected)[..., 0]
    return marginal_deviance(RandomEffects(estimates, information / max(variance, np.finfo(float).tiny)), common)


def _worst_condition(objects: int) -> float:
    """Return the worst condition of the information on identifiable coefficients."""
    return WORST_CONDITION if objects > 1 else MIN_SINGULAR_VALUE**-2


def cost_of_coefficients(size: int, objects: int, measured: Measured) -> float:
    """Return what the means and variances of so many coefficients cost, see `minus_twice_log_evidence`."""
    return float(size * (np.log(measured.count) + np.log(objects)))


def rss_with_each(factors: Floats, indices: Indices) -> Floats:
    """Return the residual sums of squares of a support with each one of the other terms, and last with none.

    Shape (terms + 1,). Where a term is inside, or so near to those inside that the sum would not be exact, this is
    zero, a lower bound.
    """
    found = explained(factors, indices, COLLINEAR, bound=True)
    return np.append(np.maximum(found[-1] - found[:-1], 0.0), found[-1])
