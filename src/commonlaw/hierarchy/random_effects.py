"""The random-effects model of coefficients over objects.

An object's own estimate is its true coefficients plus an error of known covariance, and the true coefficients are drawn
from a normal distribution over objects, whose means and variances the objects tell together (parametric empirical
Bayes; Efron and Morris 1973, 1975):

    estimate_o ~ N(true_o, covariance_o),    true_o ~ N(mean, diag(variances)),

for the coefficients or for mixtures of them, see `shrink`.

The marginal likelihood at the best variances penalizes coefficients: similar ones cost little more than one number. The
posterior shrinks each object's coefficients to their means; as variances are uncertain with few objects, shrinkage is
averaged over plausible ones, and its uncertainty is added to the covariance (Morris 1983).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.kernel import CONSTANTS

(_RIDGE,) = CONSTANTS["RIDGE"]

LIKELIEST_SWEEPS = 2
"""How often each variance is chosen again, given the others, where the best is sought."""

_BEYOND = 30.0
"""Variances are averaged over up to this factor beyond those that are distinguishable from zero and infinity."""

WORST_CONDITION = 1e10
"""Covariances of coefficients, and information on them, whose condition is worse have too few digits."""

JITTER = 1 / WORST_CONDITION
"""Share of variances that is added to them, for covariances that are singular to rounding."""

_Result = TypeVar("_Result")


@dataclass(frozen=True, eq=False)
class RandomEffects:
    """Object-specific estimates of coefficients, shape (objects, k), with their information, (objects, k, k)."""

    estimates: Floats
    information: Floats

    def marginal(self, variances: Floats) -> "Marginal":
        """Return the distribution of the estimates for several sets of variances over objects, shape (models, k)."""
        size = self.estimates.shape[1]
        # With information A and variances T the precision of an estimate is (A^-1 + T)^-1 = (I + A T)^-1 A
        added = np.eye(size) + self.information * variances[:, np.newaxis, np.newaxis, :]
        precisions = np.linalg.solve(added, self.information)
        weighted = np.matmul(precisions, self.estimates[..., np.newaxis])
        total = _symmetric(precisions.sum(axis=1))
        total[:, range(size), range(size)] *= 1 + _RIDGE
        means = np.linalg.solve(total, weighted.sum(axis=1))[..., 0]
        deviations = self.estimates - means[:, np.newaxis]
        squares = np.einsum("moi,moij,moj->mo", deviations, precisions, deviations)
        # Neither is negative; for nearly collinear coefficients rounding may make it so
        terms = np.maximum(squares, 0.0) + np.maximum(np.linalg.slogdet(added)[1], 0.0)
        return Marginal(added, total, means, terms.sum(axis=1))

    def deviances(self, variances: Floats, parameter: int, tried: Floats) -> Floats:
        """Return the deviance of the `marginal` with each trial variance of one parameter, shape (models,).

        With that variance t the precision of an estimate is Q + v v' / (p + t p^2), where v is the parameter's column
        of the precision at t = 0, p its diagonal element, and Q the Schur complement: one solution serves all t.
        """
        size = self.estimates.shape[1]
        others = np.where(np.arange(size) == parameter, 0.0, variances)
        added = np.eye(size) + self.information * others
        precisions = _symmetric(np.asarray(np.linalg.solve(added, self.information)))
        columns = precisions[:, :, parameter]
        diagonal = np.maximum(columns[:, parameter], np.finfo(float).tiny)
        rest = precisions - columns[:, :, np.newaxis] * (columns / diagonal[:, np.newaxis])[:, np.newaxis]
        rest[:, parameter] = rest[:, :, parameter] = 0.0
        grown = tried[:, np.newaxis] * diagonal
        shares = 1 / (diagonal * (1 + grown))
        outer = columns[:, :, np.newaxis] * columns[:, np.newaxis]
        total = rest.sum(axis=0) + np.tensordot(shares, outer, 1)
        total[:, range(size), range(size)] *= 1 + _RIDGE
        along = np.sum(columns * self.estimates, axis=1)
        weighted = np.matmul(rest, self.estimates[..., np.newaxis]).sum(axis=0)[:, 0] + (shares * along) @ columns
        means = np.linalg.solve(total, weighted[..., np.newaxis])[..., 0]
        deviations = self.estimates[:, np.newaxis] - means
        with np.errstate(over="ignore", invalid="ignore"):
            squares = np.sum(np.matmul(deviations, rest) * deviations, axis=2).T
            squares += shares * np.matmul(deviations, columns[..., np.newaxis])[..., 0].T ** 2
        # Neither is negative; for nearly collinear coefficients rounding may make it so
        determinants = np.maximum(np.linalg.slogdet(added)[1] + np.log1p(grown), 0.0)
        return np.asarray((np.maximum(squares, 0.0) + determinants).sum(axis=1))


@dataclass(frozen=True, eq=False)
class Marginal:
    """The distribution of all objects' estimates together, for several sets of variances over objects.

    With the information A on each object and variances T, `added` is I + A T, shape (models, objects, k, k); `total` is
    the information on the means over objects, shape (models, k, k), and `means`, shape (models, k), are by generalized
    least squares. `deviance`, shape (models,), is minus twice the log-likelihood above that of object-specific means.
    """

    added: Floats
    total: Floats
    means: Floats
    deviance: Floats

    @property
    def restricted_deviance(self) -> Floats:
        """Minus twice the restricted log-likelihood, with the means integrated out, but for a constant."""
        return np.asarray(self.deviance + np.linalg.slogdet(self.total)[1])


def marginal_deviance(effects: RandomEffects, common: int = 0) -> float:
    """Return minus twice the log marginal likelihood at the best means and variances over objects.

    It counts from object-specific means, so that it is the penalty of the coefficients; zero for a single object. The
    last `common` coefficients do not scatter. Raises `numpy.linalg.LinAlgError` if the total information is singular.
    """
    if len(effects.estimates) == 1:
        return 0.0
    scale = np.maximum(np.mean(effects.estimates**2, axis=0), np.finfo(float).tiny)

    def best(tried: Floats, parameter: int) -> tuple[float, float]:
        deviance = effects.deviances(tried[0], parameter, tried[:, parameter])
        index = int(np.argmin(deviance))
        return float(tried[index, parameter]), float(deviance[index])

    grids = dict(enumerate(scale[:, np.newaxis] * relative_variances()))
    for parameter in range(len(scale) - common, len(scale)):
        scale[parameter], grids[parameter] = 0.0, np.zeros(1)
    return _swept(scale, grids, best, LIKELIEST_SWEEPS)[1][-1]


@dataclass(frozen=True, eq=False)
class Shrinkage:
    """Coefficients shrunk to their means over objects.

    Parameters
    ----------
    estimates, covariances
        Shapes (objects, parameters) and (objects, parameters, parameters).
    shared_factors
        Shape (objects, parameters, parameters): one object's matrix times another's transposed is the covariance of
        their estimates, through the means.
    shrinkage
        From 0 (object-specific) to 1 (equal), mean over objects, shape (parameters,).
    """

    estimates: Floats
    covariances: Floats
    shared_factors: Floats
    shrinkage: Floats

    def mixed(self, turn: Floats) -> "Shrinkage":
        """Return the same for mixtures of the coefficients, `turn` times them, shape (parameters, parameters)."""
        return Shrinkage(
            self.estimates @ turn.T,
            _symmetric(turn @ self.covariances @ turn.T),
            turn @ self.shared_factors,
            np.clip((turn * np.linalg.inv(turn).T) @ self.shrinkage, 0.0, 1.0),
        )

    def averaged(self, other: "Shrinkage", weight: float) -> "Shrinkage":
        """Return the mean with another, which has this weight; the covariances are those of the mixture."""
        rest, more = 1 - weight, (other.estimates - self.estimates)[:, :, np.newaxis]
        return Shrinkage(
            rest * self.estimates + weight * other.estimates,
            rest * self.covariances + weight * other.covariances + rest * weight * more * more.swapaxes(1, 2),
            rest * self.shared_factors + weight * other.shared_factors,
            rest * self.shrinkage + weight * other.shrinkage,
        )


def shrink(estimates: Floats, covariances: Floats, variances: Floats) -> Shrinkage:
    """Draw estimates to their means over objects.

    What scatters over objects independently may be the coefficients, or may be mixtures of them: with the rate of
    growth r of a law r x - r/K x^2 both of its coefficients scatter. Independent scatter of the coefficients draws such
    objects away from the truth. So the mean over both is taken, by their marginal likelihood; the mixtures are the
    principal axes of the estimates in units of their errors, and each angle between these axes and the coefficients is
    penalized by the logarithm of the number of objects (BIC).

    Parameters
    ----------
    estimates
        Each object's own, shape (objects, parameters).
    covariances
        Of their errors, positive definite, shape (objects, parameters, parameters).
    variances
        Of each parameter over objects, shape (parameters,): zero for one that all have in common, infinite for one that
        is each object's own, NaN where the objects are to tell. Mixtures are considered where this is NaN for all.

    Raises `numpy.linalg.LinAlgError` if a covariance is singular.
    """
    # Means in which objects that say next to nothing hardly count
    units = 1 / np.sqrt(np.mean(1 / np.diagonal(covariances, axis1=1, axis2=2), axis=0))
    points, size = estimates / units, len(units)
    scaled = covariances / np.outer(units, units)
    errors: Floats = np.asarray(scaled + JITTER * scaled * np.eye(size))
    # An object that says nothing of one coefficient still does of others: its information has no large numbers
    sizes = np.sqrt(np.diagonal(errors, axis1=1, axis2=2))
    own_units = sizes[:, :, np.newaxis] * sizes[:, np.newaxis, :]
    information = _symmetric(np.linalg.inv(errors / own_units) / own_units)
    scale, weights = np.diag(units), 1 / np.trace(errors, axis1=1, axis2=2)
    typical = np.tensordot(weights / weights.sum(), errors, 1)
    is_lost = np.linalg.cond(typical) > WORST_CONDITION  # Coefficients that hang together to the last digits
    # Fewer objects than parameters do not determine axes: all their scatter is along some of them
    full = informative(points, np.diagonal(errors, axis1=1, axis2=2)).all(axis=1)
    is_determined = 1 < size <= full.sum() or is_lost
    if not is_determined or not np.isnan(variances).all():
        return _shrunk(points, errors, information, variances)[0].mixed(scale)
    # What stands before a later coefficient goes with it, as in the evidence: turned upside down
    root = np.linalg.cholesky(typical[::-1, ::-1])[::-1, ::-1]
    axes = np.eye(size) if is_lost else np.linalg.eigh(np.cov(np.linalg.solve(root, points[full].T)))[1]
    back = root @ axes
    forth = np.linalg.inv(back)
    mixed, turned_deviance = _shrunk(
        np.linalg.solve(back, points.T).T, forth @ errors @ forth.T, _symmetric(back.T @ information @ back), variances
    )
    mixed = mixed.mixed(back)
    if is_lost:
        return mixed.mixed(scale)
    shrunk, deviance = _shrunk(points, errors, information, variances)
    more = (turned_deviance + size * (size - 1) / 2 * np.log(len(points)) - deviance) / 2
    return shrunk.averaged(mixed, float(1 / (1 + np.exp(np.clip(more, -700, 700))))).mixed(scale)


def _shrunk(own: Floats, errors: Floats, information: Floats, variances: Floats) -> tuple[Shrinkage, float]:
    """Draw estimates to their means, of parameters that scatter independently, and return the deviance at that.

    The errors are the covariances of `shrink`, the information is their inverse, in units of typical errors.
    """
    effects = RandomEffects(own, information)
    # Estimates that are hardly known scatter by their errors
    counts = informative(own, np.diagonal(errors, axis1=1, axis2=2))
    between = np.var(effects.estimates, axis=0, where=counts)
    # What is left of an error where all other coefficients are known, and all of it
    alone = 1 / np.mean(np.diagonal(effects.information, axis1=1, axis2=2), axis=0)
    grids = [_grid(low / _BEYOND, (1 + high) * _BEYOND) for low, high in zip(alone, between, strict=True)]
    largest = np.array([grid[-1] for grid in grids])
    asked = {int(index): grids[index] for index in np.flatnonzero(np.isnan(variances))}
    start = np.where(variances == 0, 0.0, np.where(np.isinf(variances), 1e6, 1.0) * largest)

    def average(tried: Floats, parameter: int) -> tuple[float, Floats]:
        posterior = _Posterior.of(effects, tried)
        weights = posterior.weights(parameter)
        deviations = posterior.estimates - np.einsum("m,mok->ok", weights, posterior.estimates)
        shrinkage = posterior.shrinkage[:, parameter]
        grid, order = tried[:, parameter], np.argsort(shrinkage)
        least = grid[1] / _BEYOND  # The first is zero
        logarithms = np.log(np.maximum(grid, least))
        variance = float(np.exp(np.interp(weights @ shrinkage, shrinkage[order], logarithms[order])))
        squares = np.einsum("m,moj,mok->ojk", weights, deviations, deviations)
        return variance if variance > least else 0.0, squares

    likely, added = _swept(start, asked, average, sweeps=3)
    final = _Posterior.of(effects, likely[np.newaxis])
    covariances = _symmetric(final.covariances[0] + sum(added, np.zeros_like(information)))
    result = Shrinkage(final.estimates[0], covariances, final.shared_factors[0], final.shrinkage[0])
    return result, float(effects.marginal(likely[np.newaxis]).deviance[0])


@dataclass(frozen=True, eq=False)
class _Posterior:
    """What the objects' coefficients are, for several sets of variances over objects.

    The `deviance` is minus twice the logarithm of the variances' restricted likelihood, but for a constant, shape
    (models,); `estimates` have shape (models, objects, parameters), and `shrinkage`, the mean over objects, has shape
    (models, parameters).
    """

    deviance: Floats
    estimates: Floats
    covariances: Floats
    shared_factors: Floats
    shrinkage: Floats

    @classmethod
    def of(cls, effects: RandomEffects, variances: Floats) -> "_Posterior":
        """Return what follows from variances of shape (models, parameters)."""
        marginal = effects.marginal(variances)
        # How far each estimate is drawn to the mean: its errors' part of its covariance, E (E + T)^-1 = (I + T A)^-1
        drawn = np.linalg.inv(marginal.added).swapaxes(-1, -2)
        shared = np.matmul(drawn, _roots_of_inverses(marginal.total)[:, np.newaxis])
        given_means = drawn * variances[:, np.newaxis, np.newaxis, :]
        deviations = effects.estimates - marginal.means[:, np.newaxis]
        return cls(
            marginal.restricted_deviance,
            effects.estimates - np.einsum("moij,moj->moi", drawn, deviations),
            given_means + np.matmul(shared, shared.swapaxes(-1, -2)),
            shared,
            np.diagonal(drawn, axis1=2, axis2=3).mean(axis=1),
        )

    def weights(self, parameter: int) -> Floats:
        """Return how probable each model is if all shrinkages of a parameter are equally so before, shape (models,).

        This prior is proper, and fair for few objects too (Daniels 1999).
        """
        prior = abs(np.gradient(self.shrinkage[:, parameter]))
        weights = prior * np.exp((self.deviance.min() - self.deviance) / 2)
        return np.asarray(weights / weights.sum())


def informative(estimates: Floats, variances: Floats) -> Bools:
    """Return which estimates count among others of the same coefficient, both of shape (objects, parameters).

    Their errors have these variances. In a mean each has a weight of one over the variance of its error and that over
    objects. Those do not count whose weight is below a hundredth of a typical one: they move a mean by a tenth of an
    error. Means weighted by precision say what is typical, so that those that do not count do not change it.
    """
    precision = 1 / variances
    total = precision.sum(axis=0)
    mean = np.sum(precision * estimates, axis=0) / total
    between = np.sum(precision * (estimates - mean) ** 2, axis=0) / total
    typical = len(estimates) / total + between
    return np.asarray(0.01 * variances < typical)


def _symmetric(matrices: Floats) -> Floats:
    """Return matrices, shape (..., k, k), without what rounding has made their halves differ by."""
    return (matrices + matrices.swapaxes(-1, -2)) / 2


def _roots_of_inverses(matrices: Floats) -> Floats:
    """Return the lower Cholesky factors of the inverses of some information, shape (..., k, k).

    What is hardly more than rounding (1e-13 of the largest) counts as that much.
    """
    sizes = np.sqrt(np.diagonal(matrices, axis1=-2, axis2=-1))
    values, vectors = np.linalg.eigh(_symmetric(matrices / (sizes[..., np.newaxis] * sizes[..., np.newaxis, :])))
    scaled = (vectors * np.maximum(values, 1e-13)[..., np.newaxis, :]) @ vectors.swapaxes(-1, -2)
    upper = np.linalg.cholesky(scaled[..., ::-1, ::-1])[..., ::-1, ::-1]
    return np.asarray(np.linalg.inv(upper).swapaxes(-1, -2) / sizes[..., np.newaxis])


def _grid(low: float, high: float) -> Floats:
    """Return zero, and variances from low to high by half decades: what is between them matters little."""
    count = int(np.ceil(np.log(high / low) / np.log(np.sqrt(10)) - 1e-9))
    return np.concatenate([[0.0], low * np.sqrt(10) ** np.arange(count + 1)])


@cache
def relative_variances() -> Floats:
    """Return the variances that are tried where the best is sought, relative to the mean square of a coefficient."""
    result = _grid(1e-4, 1e2)
    result.flags.writeable = False
    return result


def _swept(
    variances: Floats, grids: dict[int, Floats], step: Callable[[Floats, int], tuple[float, _Result]], sweeps: int
) -> tuple[Floats, Sequence[_Result]]:
    """Return variances found one after the other, given the others, until none changes; and the last sweep's results.

    The grids are the variances that are tried, by the index of the parameter. A step takes the sets of variances that
    are tried, shape (models, k), and the parameter in which they differ; it returns its variance and a result.
    """
    results: list[_Result] = []
    for _ in range(sweeps):
        before, results = variances, []
        for parameter, grid in grids.items():
            tried = np.tile(variances, (len(grid), 1))
            tried[:, parameter] = grid
            variance, result = step(tried, parameter)
            variances = np.where(np.arange(len(variances)) == parameter, variance, variances)
            results.append(result)
        if np.array_equal(before, variances):
            break
    return variances, results
