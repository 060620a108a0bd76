"""Trajectories of all objects fitted by a law and a function that its objects share, and the posterior of both."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference.fit.fit import ALL_MODEL_ERRORS, NO_MODEL_ERROR
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.library import Terms
from commonlaw.likelihood import Estimate, NotPositiveError, fit, linearize

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
        objects, lower = [], []
        for factor in factors:
            objects.append(ObjectRows(factor[:own, :own], factor[:own, own:-1], factor[:own, -1]))
            lower.append(factor[own:, own:])
            constant += 2 * float(np.sum(np.log(np.abs(np.diag(factor)[:own]))))
        together = np.asarray(np.linalg.qr(np.concatenate(lower), mode="r"))
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
    values, components, amplitudes = list[float](), [], size * _AMPLITUDES
    for factor in factors:
        vectors, singular, right = np.linalg.svd(rows.shared @ factor, full_matrices=False)
        turned, seen = factor @ right.T, vectors.T @ rows.target
        rest = factor @ factor.T - turned @ turned.T
        signals = (amplitudes[:, np.newaxis] * singular) ** 2  # Over the noise, shape (amplitudes, directions)
        squares = alone - np.sum(signals / (1 + signals) * seen**2, axis=1)
        variances = rows.variance(squares, noise_measurements)
        values += (rows.deviance(squares, noise_measurements) + np.log1p(signals).sum(axis=1)).tolist()
        for amplitude, signal, variance in zip(amplitudes, signals, variances, strict=True):
            mean = amplitude**2 * turned @ (singular / (1 + signal) * seen)
            covariance = variance * amplitude**2 * ((turned / (1 + signal)) @ turned.T + rest)
            components.append((mean, covariance, float(variance)))
    return _mixed(rows, np.array(values), components, 1.0)


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
        for p, (mean, part_covariance, _) in zip(probable, found, strict=True):
            covariance += p * (part_covariance + np.outer(mean - weights, mean - weights))
        variance = float(probable @ np.array([part_variance for _, _, part_variance in found]))
    inverses = [name.inverse for name in rows.objects]
    pairs = list(zip(inverses, rows.objects, strict=True))
    return Posterior(
        value,
        weights,
        covariance,
        np.array([inverse @ (block.target - block.across @ weights) for inverse, block in pairs]),
        variance * np.array([inverse @ inverse.T for inverse in inverses]),
        np.array([-inverse @ block.across for inverse, block in pairs]),
        float(np.sqrt(variance)),
    )


MAX_ROUNDS = 8
"""How often trajectories follow the coefficients that the last ones gave, at most."""

CONVERGED = 0.03
"""What twice the log-evidence changes by once the fit has converged."""

NOISE_MEASUREMENTS = 2.0
"""Measurements of each state that its estimated noise is worth."""


@dataclass(frozen=True, eq=False)
class FunctionModel:
    """A law with a function that its objects share.

    `terms` are those of the law, then the functions; `own` marks unknown object-specific coefficients, `shared` the
    weights, both of shape (equations, terms). For `factors` and `size` see `posterior`, for `zero_at` and `held`
    `Meaning`.
    """

    terms: Terms
    own: Bools
    shared: Bools
    factors: Sequence[Floats]
    size: float
    zero_at: float | None = None
    held: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class FunctionFit:
    """Trajectories at one model error, relative to the noise, and the posterior about them.

    The first estimate of the noise counts as so many measurements; the penalty is that of the model error, and the
    deviance is what the measurements are off the trajectories, in units of the noise. Trajectories of observed laws
    follow from the posterior, and have no estimates.
    """

    model: FunctionModel
    estimates: tuple[Estimate, ...]
    model_error: float
    rows: SharedRows
    noise_measurements: float
    posterior: Posterior
    penalty: float
    deviance: float

    @property
    def value(self) -> float:
        """Minus twice the log-evidence, but for a constant."""
        return self.posterior.value + self.penalty

    @property
    def has_model_error(self) -> bool:
        """Whether each trial departs from law and function by itself."""
        return self.model_error > NO_MODEL_ERROR


def annealed(problem: SearchProblem, model: FunctionModel) -> list[FunctionFit]:
    """Return the fits at all model errors, from large ones to none; raises `CommonlawError` if none can be computed."""
    # Smoothed measurements, with known coefficients and none of the others
    size, result = model.own.shape[1], list[FunctionFit]()
    known = (np.pad(np.nan_to_num(c), ((0, 0), (0, size - c.shape[1]))) for c in problem.known)
    estimates = tuple(replace(start, coefficients=c) for start, c in zip(problem.starts, known, strict=True))
    for model_error in ALL_MODEL_ERRORS:
        with suppress(NotPositiveError):
            first = fit_about(problem, model, estimates, model_error)
            result.append(fit_about(problem, model, followed(problem, first), model_error))
            estimates = result[-1].estimates
    if not result:
        raise CommonlawError("discrepancy-fit-failed")
    return result


def converged(problem: SearchProblem, fitted: FunctionFit) -> FunctionFit:
    """Return the fit after its trajectories have followed the coefficients until these converge."""
    with suppress(NotPositiveError):
        for _ in range(MAX_ROUNDS):
            last, fitted = fitted, fit_about(problem, fitted.model, followed(problem, fitted), fitted.model_error)
            if abs(fitted.value - last.value) < CONVERGED:
                break
    return fitted


def followed(problem: SearchProblem, fitted: FunctionFit) -> tuple[Estimate, ...]:
    """Return trajectories with the coefficients and weights of a fit."""
    model, errors = fitted.model, problem.errors_to_fit(fitted.model_error)
    none, fits = np.zeros_like(model.own), []
    triples = zip(problem.models, fitted.estimates, fitted.posterior.coefficients, strict=True)
    for trajectory, estimate, coefficients in triples:
        changed = estimate.coefficients.copy()
        changed[model.own], changed[model.shared] = coefficients, fitted.posterior.weights
        fits.append(fit(replace(trajectory, terms=model.terms), replace(estimate, coefficients=changed), none, errors))
    return tuple(fits)


def fit_about(
    problem: SearchProblem, model: FunctionModel, estimates: tuple[Estimate, ...], model_error: float
) -> FunctionFit:
    """Return the posterior of the likelihood linearized about estimates.

    Raises `NotPositiveError` if it cannot be computed, or coefficients are not identifiable.
    """
    columns = model.own | model.shared
    order = np.argsort(model.shared[columns], kind="stable")
    order = np.append(order, len(order))
    factors, constant, starts, at = [], 0.0, 0, problem.errors_to_fit(model_error)[-1]
    for trajectory, estimate, name in zip(problem.models, estimates, problem.trials.objects, strict=True):
        linear = linearize(replace(trajectory, terms=model.terms), estimate, at, columns)
        factors.append(np.asarray(np.linalg.qr(linear.problem.factor[:, order], mode="r")))
        constant += linear.log_determinant
        starts += trajectory.width * len(problem.trials.of_object(name))
    count = int(model.own.sum())
    numbers = max(sum(problem.measured) - starts - count * len(factors), 1)
    worth = np.inf if problem.noise_given else NOISE_MEASUREMENTS * len(problem.noise)
    rows = SharedRows.of(factors, count, numbers, constant)
    penalty = float(np.log(sum(problem.measured))) if model_error else 0.0
    mixture = posterior(rows, model.factors, model.size, worth)
    deviance = sum(estimate.deviance for estimate in estimates)
    return FunctionFit(model, estimates, model_error, rows, worth, mixture, penalty, deviance)


def best(found: Sequence[FunctionFit]) -> FunctionFit:
    """Return the fit of largest evidence."""
    return min(found, key=lambda fitted: fitted.value)
