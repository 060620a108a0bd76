"""A function that objects share, in addition to object-specific coefficients: its evidence and its posterior.

All rows are linear in both, with Gaussian errors; whatever can be integrated is, by formulas, and amplitude and length
of the function on a grid (O'Hagan 1978; Kennedy and O'Hagan 2001).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.likelihood import NotPositiveError

_AMPLITUDES = np.geomspace(1e-3, 10.0, 17)
"""Standard deviations of the function that are compared, relative to what it adds to; each factor is as probable."""


@dataclass(frozen=True, eq=False)
class ObjectRows:
    """Triangular rows of one object: ``own @ coefficients + across @ weights = target``."""

    own: Floats
    across: Floats
    target: Floats

    @property
    def inverse(self) -> Floats:
        """The inverse factor; raises `NotPositiveError` if coefficients are not identifiable."""
        try:
            return np.asarray(np.linalg.inv(self.own))
        except np.linalg.LinAlgError:
            raise NotPositiveError from None


@dataclass(frozen=True, eq=False)
class SharedRows:
    """Rows of all objects with the object-specific coefficients eliminated.

    `objects` has each object's rows of its own coefficients, `shared`, shape (k, functions), and `target`, shape (k,),
    those of the weights. `rest` is the residual sum of squares, `numbers` the degrees of freedom, and `constant` what
    else belongs to minus twice the log-likelihood.
    """

    objects: tuple[ObjectRows, ...]
    shared: Floats
    target: Floats
    rest: float
    numbers: float
    constant: float

    @classmethod
    def of(cls, factors: Sequence[Floats], own: int, numbers: float, constant: float) -> "SharedRows":
        """Return the rows of triangular factors ``[own | shared | target]``, one of each object."""
        objects, left = [], []
        for factor in factors:
            objects.append(ObjectRows(factor[:own, :own], factor[:own, own:-1], factor[:own, -1]))
            left.append(factor[own:, own:])
            constant += 2 * float(np.sum(np.log(np.abs(np.diag(factor)[:own]))))
        together = np.asarray(np.linalg.qr(np.concatenate(left), mode="r"))
        width = together.shape[1] - 1
        rest = float(np.sum(together[width:, -1] ** 2))
        return cls(tuple(objects), together[:width, :-1], together[:width, -1], rest, numbers, constant)

    def deviance(self, squares: Floats, noise_measurements: float) -> Floats:
        """Return minus twice the log-likelihood for sums of squares, see `posterior`."""
        if np.isinf(noise_measurements):
            return squares + self.constant
        total = self.numbers + noise_measurements
        return total * np.log((squares + noise_measurements) / total) + total + self.constant

    def variance(self, squares: Floats, noise_measurements: float) -> Floats:
        """Return the variance of rows for sums of squares, which is one where the noise is known."""
        if np.isinf(noise_measurements):
            return np.ones_like(squares)
        return (squares + noise_measurements) / max(self.numbers + noise_measurements - 2, 1.0)


@dataclass(frozen=True, eq=False)
class Posterior:
    """The posterior of the function's weights and of the coefficients.

    `value` is minus twice the log-evidence but for a constant, `weights` and `covariance` are those of the functions,
    `coefficients` has shape (objects, coefficients), `own_covariance` is theirs given the weights, `follow` their
    derivative by the weights, and `noise_factor` the ratio of the noise to what was assumed.
    """

    value: float
    weights: Floats
    covariance: Floats
    coefficients: Floats
    own_covariance: Floats
    follow: Floats
    noise_factor: float

    @property
    def shared_factor(self) -> Floats:
        """A factor of the covariance of weights, shape (functions, functions)."""
        values, vectors = np.linalg.eigh(self.covariance)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def posterior(rows: SharedRows, factors: Sequence[Floats], size: float, noise_measurements: float) -> Posterior:
    """Return evidence and posterior, with amplitude and length scale of the function integrated out.

    `factors` are those of the prior of the weights, one a length, none without a function; `size` is that of what the
    function adds to. The first estimate of the noise counts as `noise_measurements`, infinite where the noise is known.
    """
    alone = float(rows.target @ rows.target) + rows.rest
    if not factors:
        none = np.array([alone])
        variance = float(rows.variance(none, noise_measurements)[0])
        return _mixed(rows, rows.deviance(none, noise_measurements), [], variance)
    values, found, amplitudes = list[float](), [], size * _AMPLITUDES
    for factor in factors:
        left, singular, right = np.linalg.svd(rows.shared @ factor, full_matrices=False)
        turned, seen = factor @ right.T, left.T @ rows.target
        rest = factor @ factor.T - turned @ turned.T
        signals = (amplitudes[:, np.newaxis] * singular) ** 2  # Over the noise, shape (amplitudes, directions)
        squares = alone - np.sum(signals / (1 + signals) * seen**2, axis=1)
        variances = rows.variance(squares, noise_measurements)
        values += (rows.deviance(squares, noise_measurements) + np.log1p(signals).sum(axis=1)).tolist()
        for amplitude, signal, variance in zip(amplitudes, signals, variances, strict=True):
            mean = amplitude**2 * turned @ (singular / (1 + signal) * seen)
            covariance = variance * amplitude**2 * ((turned / (1 + signal)) @ turned.T + rest)
            found.append((mean, covariance, float(variance)))
    return _mixed(rows, np.array(values), found, 1.0)


def _mixed(
    rows: SharedRows, values: Floats, found: Sequence[tuple[Floats, Floats, float]], variance: float
) -> Posterior:
    """Return the mixture over amplitudes and lengths, as probable as their evidence says."""
    width = rows.shared.shape[1]
    probable = np.exp(-(values - values.min()) / 2)
    value = float(values.min() - 2 * np.log(np.mean(probable)))
    weights, covariance = np.zeros(width), np.zeros((width, width))
    if found:
        probable /= probable.sum()
        weights = np.sum([p * mean for p, (mean, _, _) in zip(probable, found, strict=True)], axis=0)
        for p, (mean, own, _) in zip(probable, found, strict=True):
            covariance += p * (own + np.outer(mean - weights, mean - weights))
        variance = float(probable @ np.array([each for _, _, each in found]))
    inverses = [each.inverse for each in rows.objects]
    pairs = list(zip(inverses, rows.objects, strict=True))
    return Posterior(
        value,
        weights,
        covariance,
        np.array([inverse @ (each.target - each.across @ weights) for inverse, each in pairs]),
        variance * np.array([inverse @ inverse.T for inverse in inverses]),
        np.array([-inverse @ each.across for inverse, each in pairs]),
        float(np.sqrt(variance)),
    )
