"""Log-evidence of a support that all objects share, with object-specific coefficients as random effects.

For a support S with k coefficients in each of m objects, n measured numbers and the residual sum of squares R(S),

    -2 log p(y | S) = D(R(S)) + k (log n + log m) + C(S),

where D is minus twice the log-likelihood with the noise scale integrated out (`NoiseScale.deviance`), the second part
is the Bayesian information criterion of k means over objects and k between-object variances, and C is the marginal
deviance of coefficients that are drawn from normal distributions over objects, at the variances of largest marginal
likelihood (`commonlaw.hierarchy.marginal_deviance`). For m = 1 this is the BIC.

Random effects may be independent in the coefficients; in orthogonalized combinations of them, as in a rate k (a - x)
height and slope covary if the origin of x is arbitrary; or in combinations the first of which is along their mean, as
the coefficients of objects that differ in their time scale are multiples of each other. The three bases have equal
prior probabilities, and C is that of their mixture.
"""

from collections.abc import Sequence
from ctypes import CDLL
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.formulation import explained
from commonlaw.hierarchy import LIKELIEST_SWEEPS, WORST_CONDITION, RandomEffects, marginal_deviance, relative_variances
from commonlaw.inference.settings import COLLINEAR, MIN_SINGULAR_VALUE
from commonlaw.kernel import CONSTANTS, MeasuredStructure, address, kernel
from commonlaw.likelihood import ERRORS, ErrorModel, Scales, by_group, cost_of_scatter
from commonlaw.likelihood.levels import free_levels
from commonlaw.runtime.time_limit import check
from commonlaw.trials.trial import Replication, Trial

(_MIN_COLUMN,), (_RIDGE,) = CONSTANTS["MIN_COLUMN"], CONSTANTS["RIDGE"]


@dataclass(frozen=True)
class NoiseScale:
    """The inverse-gamma posterior of the noise variance, in units of its present value.

    With nu0 prior observations of sum of squares `prior`, the variance given residual squares R of k coefficients is

        s^2 = max((R - outliers + prior) / (freedom - k), least),

    and integrating it out gives a Student t likelihood of `freedom` degrees of freedom: those before coefficients are
    fitted, prior observations included; infinite for known noise. `count` are the measured numbers n. The contribution
    of outliers to sums of squares does not count as noise, and `least` is the lower bound of the variance.
    """

    count: int
    freedom: float = np.inf
    prior: float = 0.0
    outliers: float = 0.0
    least: float = 0.0

    def without(self, coefficients: int) -> "NoiseScale":
        """Return the posterior with fewer degrees of freedom, for coefficients that are fitted besides."""
        return replace(self, freedom=self.freedom - coefficients)

    def variance(self, squares: float, coefficients: int) -> float:
        """Return the noise variance s^2 given the residual sum of squares of so many coefficients."""
        if np.isinf(self.freedom):
            return 1.0
        return float(self._variance(squares, max(self.freedom - coefficients, 1.0)))

    def deviance(self, squares: Floats | float, coefficients: int) -> Floats | float:
        """Return minus twice the log-likelihood of residual squares R with the noise scale integrated out.

        It is ``freedom log s^2 + (R - outliers + prior) / s^2``: above the lower bound of s^2 that of a t density, up
        to a constant, and at the bound that of a normal density. For known noise it is R.
        """
        if np.isinf(self.freedom):
            return squares
        nu = max(self.freedom - coefficients, 1.0)
        variance = self._variance(squares, nu)
        return self.freedom * np.log(variance) + self._of_noise(squares) / variance

    def _variance(self, squares: Floats | float, nu: float) -> Floats:
        return np.maximum(self._of_noise(squares) / nu, self.least)

    def _of_noise(self, squares: Floats | float) -> Floats:
        return np.maximum(squares - self.outliers, 0.0) + self.prior


@dataclass(frozen=True, eq=False)
class NoisePrior:
    """The prior of the noise and of levels of other errors, which is the same for all laws of some trials.

    Of the variance of each measured quantity it is inverse gamma: the `estimate` before any law, shape (m,), counts
    as so many `observations`; it is None for known noise. Both are variances of neighbouring differences: of white
    noise v, and of autocorrelated errors of standard deviation sigma and correlation time tau at sampling step h,
    they are ``v + sigma^2 tanh(h / (2 tau))``, of a Wiener process of variance c^2 a unit of time ``v + c^2 h / 4``.
    Repeats in `trials` add their pure error. Neighbouring differences hardly see a drift. Levels above their lower
    bounds cost log n each, and so does their time (BIC): at these bounds they stand for no such errors. Those of a
    drift cost the log of the number of trials, each of which has one offset and one slope (BIC of mixed-effects
    models; Delattre, Lavielle and Poursat 2014), and its mean slopes log n; for those of groups see
    `cost_of_scatter`. There are n = `count` measured numbers, with a `freedom` before coefficients are fitted.
    """

    count: int
    freedom: float
    measured: Bools
    estimate: Floats | None
    observations: float
    trials: Sequence[tuple[Trial, Replication]]
    floors: Floats
    scales: Scales

    def posterior(self, noise: Floats, errors: ErrorModel, relative: Floats) -> NoiseScale:
        """Return the posterior of the noise variance, in units of that at the present levels.

        White noise has mean squares `relative` in units of that of a state of zero, shape (m,). The variance is at
        least that of the `floors`, shape (m,).
        """
        if self.estimate is None:
            return NoiseScale(self.count)
        prior, freedom, inflation = 0.0, self.freedom, self._inflation(noise, errors, relative)
        for trial, of_trial in self.trials:
            prior += float(np.sum(of_trial.squares / errors.noise_of_trial(trial, noise) ** 2))
            freedom += float(of_trial.freedom.sum())
        prior += self.observations * float(np.sum(1 / inflation))
        freedom += self.observations * len(inflation)
        least = float(np.max((self.floors / noise)[self.measured])) ** 2
        return NoiseScale(self.count, freedom, prior, least=least)

    def penalty(self, noise: Floats, errors: ErrorModel, relative: Floats) -> float:
        """Return minus twice the log prior of the noise, with the normalization of repeats about their means."""
        penalty = 0.0
        for trial, of_trial in self.trials:
            levels = np.where(of_trial.freedom > 0, errors.noise_of_trial(trial, noise), 1.0)
            penalty += 2 * float(np.sum(of_trial.freedom * np.log(levels)))
        if self.estimate is not None:
            penalty += self.observations * float(np.log(self._inflation(noise, errors, relative)).sum())
        return penalty

    def of_levels(self, errors: ErrorModel) -> float:
        """Return minus twice the log prior of levels and times of errors besides white noise."""
        is_free = free_levels(errors, self.scales)
        model = ERRORS[errors.kind]
        numbers = np.full(len(is_free), self.scales.trials if model.is_of_trials else self.count)
        numbers[model.means(len(is_free))] = self.count
        penalty = float(np.log(np.maximum(numbers, 2)[is_free]).sum())
        groups = by_group(errors.grouping).groups(trial for trial, _ in self.trials)
        counts = np.zeros((int(groups.max()) + 1, len(self.measured)))
        factors = np.ones(counts.shape)
        for k, (trial, of_trial) in zip(groups, self.trials, strict=True):
            counts[k] += of_trial.counts
            factors[k] = errors.noise_of_trial(trial, factors[k])
        for column, of_groups in zip(factors.T, counts.T, strict=True):
            if (scatters := column != 1).any():
                penalty += cost_of_scatter(np.log(column[scatters]), of_groups[scatters])
        return penalty

    def _inflation(self, noise: Floats, errors: ErrorModel, relative: Floats) -> Floats:
        """Return the noise variance over its prior estimate, of each measured quantity."""
        assert self.estimate is not None
        variances, latent = noise**2 * relative, errors.latent
        if latent.correlated is not None:
            share = self.scales.step / 4 if latent.walks else np.tanh(self.scales.step / (2 * latent.memory))
            variances = variances + latent.correlated**2 * share
        return np.asarray((variances / self.estimate**2)[self.measured])


def minus_twice_log_evidence(
    factors: Floats, indices: Indices, noise_scale: NoiseScale, needed: float = np.inf, common: int = 0
) -> float:
    """Return minus twice the log-evidence of a support of one equation that all objects share.

    Where it is not below `needed`, a lower bound that takes less time is returned. The triangular factors of the
    objects' least-squares problems have one target and residuals of unit variance, shape (objects, terms + 1, terms +
    1). Indices are those of the terms; the coefficients of the last so many as are `common` do not differ between
    objects.
    """
    check()
    library = kernel()
    if library is not None:
        return _compiled(library, factors, indices, noise_scale, needed, common)
    size = len(indices)
    reduced = np.asarray(np.linalg.qr(factors[:, :, [*indices, -1]], mode="r"))
    rss, parameters = float(np.sum(reduced[:, size:, size] ** 2)), size * len(factors)
    floor = float(noise_scale.deviance(rss, parameters)) + coefficient_penalty(size, len(factors), noise_scale)
    if not size or floor >= needed:
        return floor
    norms = np.sqrt(np.mean(np.sum(reduced[:, :size, :size] ** 2, axis=1), axis=0))
    columns = reduced[:, :size, :size] / np.where(norms > 0, norms, 1.0)
    try:
        targets, variance = reduced[:, :size, size:], noise_scale.variance(rss, parameters)
        bases = [_random_effects(columns, targets, variance, common)]
        if size > 1 and len(factors) > 1:  # Gram-Schmidt over the columns of all objects
            triangle = np.linalg.qr(columns.reshape(-1, size), mode="r")
            orthogonal = np.asarray(np.matmul(columns, np.linalg.inv(triangle)))
            bases.append(_random_effects(orthogonal, targets, variance, common))
            bases.append(None if bases[1] is None else _along_mean(bases[1], common))
        costs = np.array([np.inf if basis is None else marginal_deviance(basis, common) for basis in bases])
    except np.linalg.LinAlgError:
        return np.inf
    costs = np.where(np.isnan(costs), np.inf, costs)
    evidence = floor - 2 * float(np.logaddexp.reduce(-costs / 2) - np.log(len(costs)))
    return evidence if np.isfinite(evidence) else np.inf


def _compiled(library: CDLL, factors: Floats, indices: Indices, noise: NoiseScale, needed: float, common: int) -> float:
    """Return the same by the kernel, to rounding."""
    worst = _worst_condition(len(factors))
    factors, chosen = np.ascontiguousarray(factors), np.ascontiguousarray(indices, dtype=np.int64)
    structure = MeasuredStructure(noise.count, noise.freedom, noise.prior, noise.outliers, noise.least)
    tried, result = relative_variances(), np.empty(1)
    failed = library.commonlaw_evidence(
        *(len(factors), factors.shape[2] - 1, address(factors), len(chosen), address(chosen), common),
        *(structure, needed, worst, len(tried), address(tried), LIKELIEST_SWEEPS, address(result)),
    )
    if failed:
        raise MemoryError
    return float(result[0])


def residual_squares(factors: Floats, indices: Indices) -> float:
    """Return the residual sum of squares of a support over all objects."""
    residuals = np.asarray(np.linalg.qr(factors[:, :, [*indices, -1]], mode="r"))[:, -1, -1]
    return float(residuals @ residuals)


def _random_effects(columns: Floats, targets: Floats, variance: float, common: int) -> RandomEffects | None:
    """Return the coefficients of each object as random effects; None if they are not identifiable.

    Those that are not the same for all objects are identifiable if the trials of one object identify them: of x and
    ``x*mass`` only one may be in a law, as the other's coefficient can have any value in each object.
    """
    information = np.asarray(np.matmul(columns.transpose(0, 2, 1), columns))
    if not np.linalg.cond(information.sum(axis=0)) < _worst_condition(len(columns)):
        return None
    is_large = np.abs(np.diagonal(columns, axis1=1, axis2=2)) > _MIN_COLUMN
    if len(columns) > 1 and not is_large[:, : columns.shape[1] - common].all(axis=1).any():
        return None
    determined = is_large.all(axis=1)
    estimates = np.empty(columns.shape[:2])
    estimates[determined] = np.linalg.solve(columns[determined], targets[determined])[..., 0]
    ridge = _MIN_COLUMN**2 * np.eye(columns.shape[1])
    projected = np.matmul(columns[~determined].transpose(0, 2, 1), targets[~determined])
    estimates[~determined] = np.linalg.solve(information[~determined] + ridge, projected)[..., 0]
    return RandomEffects(estimates, information / max(variance, np.finfo(float).tiny))


def _along_mean(effects: RandomEffects, common: int) -> RandomEffects | None:
    """Return the random effects reflected so that the mean of those that scatter lies along the first axis.

    Objects have weights of one over the trace of their covariance; None if the mean is zero.
    """
    size = effects.estimates.shape[1]
    weights = 1 / np.trace(np.linalg.inv(effects.information + _RIDGE * np.eye(size)), axis1=1, axis2=2)
    axis = np.where(np.arange(size) < size - common, weights @ effects.estimates, 0.0)
    if not np.any(axis):
        return None
    axis[0] += np.copysign(np.linalg.norm(axis), axis[0])
    reflection = np.eye(size) - 2 / (axis @ axis) * np.outer(axis, axis)
    return RandomEffects(effects.estimates @ reflection, reflection @ effects.information @ reflection)


def _worst_condition(objects: int) -> float:
    return WORST_CONDITION if objects > 1 else MIN_SINGULAR_VALUE**-2


def coefficient_penalty(size: int, objects: int, noise_scale: NoiseScale) -> float:
    """Return ``k (log n + log m)``, the BIC of k means over m objects and their variances."""
    return float(size * (np.log(noise_scale.count) + np.log(objects)))


def rss_with_added_term(factors: Floats, indices: Indices) -> Floats:
    """Return the residual sums of squares of a support plus one of the other terms, last without any, (terms + 1,).

    For a term in the support, or collinear with it, this is zero, a lower bound.
    """
    reductions = explained(factors, indices, COLLINEAR, bound=True)
    return np.append(np.maximum(reductions[-1] - reductions[:-1], 0.0), reductions[-1])
