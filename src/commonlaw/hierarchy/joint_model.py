"""Coefficients of all objects as one linear Gaussian model: factors that objects share, scatter, errors of estimates.

Each coefficient is ``columns @ factors`` plus scatter, or in logarithms ``offsets + log(factor)`` plus scatter. The
errors of an object's coefficients depend on each other, so that what is found of one sharpens what is known of the
others: where gravity is universal, drag is known better.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Floats


@dataclass(frozen=True, eq=False)
class CoefficientModel:
    """The model of one coefficient of all objects; or several models, along a first axis.

    `columns` multiply the factors, shape (objects, factors), `offsets` are added and `variances` are those of the
    scatter, both of shape (objects,). The prior precision of the factors, shape (factors,), is zero where it is flat.
    `in_logs` says whether the logarithm of the coefficient is modelled.
    """

    columns: Floats
    offsets: Floats
    variances: Floats
    in_logs: bool
    precision: Floats

    @classmethod
    def powers(cls, logs: Floats, variances: Floats, in_logs: bool) -> "CoefficientModel":
        """Return the model of a factor times the exponential of logarithms, shape (models, objects), with scatter.

        Variances, of logarithms or relative to the power law, broadcast to that shape.
        """
        if in_logs:
            return cls(np.ones((1, logs.shape[1], 1)), logs, np.asarray(variances), True, np.zeros(1))
        powers = np.exp(logs)
        return cls(powers[..., np.newaxis], np.zeros((1, logs.shape[1])), variances * powers**2, False, np.zeros(1))

    @classmethod
    def left_out(cls, objects: int, in_logs: bool = False) -> "CoefficientModel":
        """Return that of a coefficient without factors and scatter."""
        return cls(np.empty((objects, 0)), np.zeros(objects), np.zeros(objects), in_logs, np.empty(0))

    @property
    def alone(self) -> "CoefficientModel":
        """The same as the only one of several models."""
        return replace(self, **{name: getattr(self, name)[np.newaxis] for name in ("columns", "offsets", "variances")})

    def some(self, index: int | slice) -> "CoefficientModel":
        """Return one of several models, or some of them."""

        def chosen(values: Floats) -> Floats:
            every = slice(None) if isinstance(index, slice) else 0
            return np.asarray(values[index if len(values) > 1 else every])

        return replace(
            self, columns=chosen(self.columns), offsets=chosen(self.offsets), variances=chosen(self.variances)
        )


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of all coefficients, (objects, k), with covariances; logarithms are linear about `points`."""

    estimates: Floats
    covariances: Floats
    points: Floats

    def in_logs(self, chosen: Sequence[bool]) -> "Estimates":
        """Return the same with the logarithms of some coefficients' sizes in place of these."""
        logs = np.asarray(chosen)
        points = np.where(logs, self.points, 1.0)
        moved = np.log(abs(points)) + (self.estimates - points) / points
        estimates = np.where(logs, moved, self.estimates)
        covariances = self.covariances / (points[:, :, np.newaxis] * points[:, np.newaxis])
        return Estimates(estimates, covariances, self.points)


@dataclass(frozen=True, eq=False)
class JointModel:
    """The model of all coefficients, or of all but one, which then has no factor and no scatter here.

    `residuals` are estimates less offsets, shape (objects, k), `errors` their covariances, `variances` those of the
    scatter, shape (objects, k), and `design` the derivatives of coefficients by factors, shape (objects, k, factors).
    """

    residuals: Floats
    errors: Floats
    variances: Floats
    design: Floats

    @classmethod
    def of(cls, measured: Estimates, models: Sequence[CoefficientModel]) -> "JointModel":
        """Return the model of coefficients that each have a model."""
        logs = measured.in_logs([model.in_logs for model in models])
        count, size = logs.estimates.shape
        offsets, variances, parts = np.zeros((count, size)), np.zeros((count, size)), [np.empty((count, size, 0))]
        for k, model in enumerate(models):
            offsets[:, k], variances[:, k] = model.offsets, model.variances
            part = np.zeros((count, size, model.columns.shape[1]))
            part[:, k] = model.columns
            parts.append(part)
        return cls(logs.estimates - offsets, logs.covariances, variances, np.concatenate(parts, axis=2))

    @property
    def precisions(self) -> Floats:
        """Inverse covariances of the estimates about the model, shape (objects, k, k)."""
        size = self.residuals.shape[1]
        return np.asarray(np.linalg.inv(self.errors + self.variances[:, np.newaxis] * np.eye(size)))

    def factors(self, precision: Floats) -> tuple[Floats, Floats]:
        """Return the best factors, shape (factors,), and their covariance, given their precision beforehand."""
        weighted = np.matmul(self.design.swapaxes(1, 2), self.precisions)
        covariance = np.linalg.inv((weighted @ self.design).sum(axis=0) + np.diag(precision))
        result = covariance @ np.einsum("oqk,ok->q", weighted, self.residuals)
        return result, (covariance + covariance.T) / 2

    def log_evidence(self, precision: Floats) -> float:
        """Return the logarithm of the density of all estimates, factors integrated out, given their precision."""
        precisions = self.precisions
        factors, covariance = self.factors(precision)
        squares = np.einsum("ok,okl,ol->", self.residuals, precisions, self.residuals)
        squares -= factors @ np.linalg.solve(covariance, factors)
        sizes = np.linalg.slogdet(precisions)[1].sum() + np.linalg.slogdet(covariance)[1]
        proper = precision[precision > 0]
        constant = (len(precision) - len(proper) - self.residuals.size) * np.log(2 * np.pi) + np.log(proper).sum()
        return float(constant + sizes - squares) / 2

    def without(self, index: int) -> tuple[Floats, Floats]:
        """Return the conditional mean of a coefficient that is left out, and its variance, both of shape (objects,)."""
        others = [k for k in range(self.residuals.shape[1]) if k != index]
        total = self.errors + self.variances[:, np.newaxis] * np.eye(self.residuals.shape[1])
        if not others:
            return self.residuals[:, index], total[:, index, index]
        part = JointModel(
            self.residuals[:, others],
            self.errors[:, others][:, :, others],
            self.variances[:, others],
            self.design[:, others],
        )
        factors, covariance = part.factors(np.zeros(self.design.shape[2]))
        gain = np.einsum("ok,okl->ol", total[:, index, others], part.precisions)
        moved = np.einsum("ok,okq->oq", gain, part.design)
        mean = self.residuals[:, index] - np.einsum("ok,ok->o", gain, part.residuals - part.design @ factors)
        spread = total[:, index, index] - np.einsum("ok,ok->o", gain, total[:, index, others])
        return mean, spread + np.einsum("oq,qr,or->o", moved, covariance, moved)


def log_evidence(others: JointModel, index: int, tried: CoefficientModel) -> Floats:
    """Return the log-evidence of several models of one coefficient, but for a constant, factors being integrated out.

    `others` models all but the coefficient at `index`; the first axis of `tried` may be of length 1 where models are
    equal.
    """
    precisions, design = others.precisions, others.design
    columns, known = precisions[:, :, index], others.residuals.copy()
    known[:, index] = 0.0
    information = columns[:, index]
    residuals = others.residuals[:, index] - tried.offsets
    # The scatter of one coefficient changes the precision by a product of two vectors (Sherman and Morrison 1950)
    less = 1 / (1 + tried.variances * information)
    lost = tried.variances * less
    projected = np.einsum("ok,ok->o", columns, known)
    pull = projected + information * residuals
    squares = np.einsum("ok,okl,ol->", known, precisions, known)
    squares = squares + np.sum(2 * residuals * projected + information * residuals**2 - lost * pull**2, axis=1)

    shared = np.einsum("okq,ok->oq", design, columns)
    count, width = design.shape[2], tried.columns.shape[2]
    weighted = less[..., np.newaxis] * tried.columns
    total = np.empty((len(weighted), count + width, count + width))
    pairs = shared[:, :, np.newaxis] * shared[:, np.newaxis]
    total[:, :count, :count] = np.einsum("okq,okl,olr->qr", design, precisions, design)
    total[:, :count, :count] -= np.tensordot(lost, pairs, axes=1)
    total[:, :count, count:] = np.matmul(shared.T, weighted)
    total[:, count:, :count] = total[:, :count, count:].swapaxes(1, 2)
    total[:, count:, count:] = np.matmul(weighted.swapaxes(1, 2), tried.columns * information[:, np.newaxis])
    total[:, count:, count:] += np.diag(tried.precision)

    sides = np.empty((max(len(pull), len(weighted)), count + width))
    sides[:, :count] = np.einsum("okq,okl,ol->q", design, precisions, known) + (residuals - lost * pull) @ shared
    sides[:, count:] = np.sum(weighted * pull[..., np.newaxis], axis=1)
    factors = np.matmul(np.linalg.inv(total), sides[..., np.newaxis])[..., 0]
    deviance = squares - np.sum(factors * sides, axis=1) + np.linalg.slogdet(total)[1]
    deviance = deviance + np.sum(np.log1p(tried.variances * information), axis=1)
    proper = tried.precision[tried.precision > 0]
    constant = (width - len(proper)) * np.log(2 * np.pi) + np.log(proper).sum()
    return np.asarray((constant - deviance) / 2)
