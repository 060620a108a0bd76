"""Trajectories of all objects fitted to what was measured, by a law and a function that its objects share."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.discrepancy.posterior import Posterior, SharedRows, posterior
from commonlaw.errors import CommonlawError
from commonlaw.inference.fit.fit import ANY_ERROR, NO_ERROR, errors_to_fit
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.library import Terms
from commonlaw.likelihood import Estimate, NotPositiveError, fit, linearize

_ROUNDS = 8
"""How often trajectories follow the coefficients that the last ones gave, at most."""

_CONVERGED = 0.03
"""What twice the log-evidence changes by once the fit has converged."""

_NOISE_MEASUREMENTS = 2.0
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
    held: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class FunctionFit:
    """Trajectories at one model error, relative to the noise, and the posterior about them.

    The first estimate of the noise counts as so many measurements; the price is the penalty of the model error.
    """

    model: FunctionModel
    estimates: tuple[Estimate, ...]
    model_error: float
    rows: SharedRows
    noise_measurements: float
    posterior: Posterior
    price: float

    @property
    def value(self) -> float:
        """Minus twice the log-evidence, but for a constant."""
        return self.posterior.value + self.price

    @property
    def has_model_error(self) -> bool:
        """Whether each trial departs from law and function by itself."""
        return self.model_error > NO_ERROR

    @property
    def deviance(self) -> float:
        """What the measurements are off the trajectories, in units of the noise."""
        return sum(each.deviance for each in self.estimates)


def start(problem: SearchProblem, model: FunctionModel) -> tuple[Estimate, ...]:
    """Return smoothed measurements, with known coefficients and none of the others."""
    size = model.own.shape[1]
    known = (np.pad(np.nan_to_num(own), ((0, 0), (0, size - own.shape[1]))) for own in problem.known)
    return tuple(replace(each, coefficients=own) for each, own in zip(problem.starts, known, strict=True))


def annealed(problem: SearchProblem, model: FunctionModel) -> list[FunctionFit]:
    """Return the fits at all model errors, from large ones to none; raises `CommonlawError` if none can be computed."""
    estimates, found = start(problem, model), list[FunctionFit]()
    for model_error in ANY_ERROR:
        with suppress(NotPositiveError):
            first = fit_about(problem, model, estimates, model_error)
            found.append(fit_about(problem, model, followed(problem, first), model_error))
            estimates = found[-1].estimates
    if not found:
        raise CommonlawError("discrepancy-fit-failed")
    return found


def converged(problem: SearchProblem, fitted: FunctionFit) -> FunctionFit:
    """Return the fit after its trajectories have followed the coefficients until these converge."""
    for _ in range(_ROUNDS):
        try:
            found = fit_about(problem, fitted.model, followed(problem, fitted), fitted.model_error)
        except NotPositiveError:
            break
        last, fitted = fitted, found
        if abs(found.value - last.value) < _CONVERGED:
            break
    return fitted


def followed(problem: SearchProblem, fitted: FunctionFit) -> tuple[Estimate, ...]:
    """Return trajectories with the coefficients and weights of a fit."""
    model, errors = fitted.model, errors_to_fit(fitted.model_error)
    none, found = np.zeros_like(model.own), []
    pairs = zip(problem.models, fitted.estimates, fitted.posterior.coefficients, strict=True)
    for trajectory, estimate, coefficients in pairs:
        changed = estimate.coefficients.copy()
        changed[model.own], changed[model.shared] = coefficients, fitted.posterior.weights
        found.append(fit(replace(trajectory, terms=model.terms), replace(estimate, coefficients=changed), none, errors))
    return tuple(found)


def fit_about(
    problem: SearchProblem, model: FunctionModel, estimates: tuple[Estimate, ...], model_error: float
) -> FunctionFit:
    """Return the posterior of the likelihood linearized about estimates.

    Raises `NotPositiveError` if it cannot be computed, or coefficients are not identifiable.
    """
    columns = model.own | model.shared
    order = np.argsort(model.shared[columns], kind="stable")
    order = np.append(order, len(order))
    factors, constant, starts, at = [], 0.0, 0, errors_to_fit(model_error)[-1]
    for trajectory, estimate, name in zip(problem.models, estimates, problem.trials.objects, strict=True):
        linear = linearize(replace(trajectory, terms=model.terms), estimate, at, columns)
        factors.append(np.asarray(np.linalg.qr(linear.problem.factor[:, order], mode="r")))
        constant += linear.log_determinant
        starts += trajectory.width * len(problem.trials.of_object(name))
    own = int(model.own.sum())
    numbers = max(sum(problem.measured) - starts - own * len(factors), 1)
    worth = np.inf if problem.noise_given else _NOISE_MEASUREMENTS * len(problem.noise)
    rows = SharedRows.of(factors, own, numbers, constant)
    price = float(np.log(sum(problem.measured))) if model_error else 0.0
    found = posterior(rows, model.factors, model.size, worth)
    return FunctionFit(model, estimates, model_error, rows, worth, found, price)


def best(found: Sequence[FunctionFit]) -> FunctionFit:
    """Return the fit of largest evidence."""
    return min(found, key=lambda each: each.value)
