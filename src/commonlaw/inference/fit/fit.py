"""A model fitted to trials: supports with the estimates of all objects, and the likelihood linearized about them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, NamedTuple, Self

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.diagnostics import Outcome
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.fit.lack_of_fit import (
    NO_LAW,
    Departures,
    DiscretizationErrors,
    departures,
    discretization_errors,
    diverges,
    is_resolved,
)
from commonlaw.inference.fit.latent_initialization import pooled_start
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.score.score import Part, Score
from commonlaw.inference.score.supports import SupportEvidence
from commonlaw.law import Step
from commonlaw.library import Order
from commonlaw.likelihood import Estimate, NotPositiveError, Regression, fit_each, linearize_each
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.runtime.forking import cached_property

NO_MODEL_ERROR = 0.0
"""The model error of laws whose trajectories are solutions."""

ALL_MODEL_ERRORS = (*settings.MODEL_ERRORS, NO_MODEL_ERROR)
"""Model errors that are compared, and zero."""

PLAUSIBLE = float(-2 * np.log(settings.MIN_PROBABILITY))
"""2 log B to the best law up to which a law is plausible."""


class Status(StrEnum):
    """The outcome of a fit."""

    FITTED = "fitted"
    NOT_COMPUTABLE = "the likelihood cannot be computed"
    NOT_CONVERGED = "not converged"
    HAS_POLE = "a denominator vanishes at or between the states"
    NOT_IDENTIFIABLE = "nonlinear parameters are not identifiable"
    WITHOUT_EFFECT = "no term, or a latent state without effect"
    REFUSED = "the trials are incompatible with the model"


class Model(NamedTuple):
    """Everything by which two candidate laws can differ: the key of the pool.

    Equations are the names of their terms, those with fixed coefficients included; a latent state has its initial value
    as text.
    """

    order: Order
    equations: tuple[tuple[str, ...], ...]
    errors: ErrorKind
    latent_states: tuple[tuple[str, str], ...]
    input_interpolation: str
    log_states: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Fit:
    """A model with its estimates for all objects, the steps of its history, and its diagnostics.

    Supports are the terms of each equation, shape (equations, terms); alternatives are fits of other supports under the
    same errors. The model error is the standard deviation of a random walk in each step, relative to the noise, zero
    for solutions of the law. A failed fit has no estimates, and an infinite score. `shared` are the coefficients that
    objects have in common, shape (equations, terms), None if there are none.
    """

    problem: SearchProblem
    supports: Bools
    estimates: tuple[Estimate, ...]
    model_error: float
    score: Score
    status: Status = Status.FITTED
    alternatives: "tuple[Fit, ...]" = ()
    steps: tuple[Step, ...] = ()
    outcomes: tuple[Outcome, ...] = ()
    shared: Bools | None = None

    @classmethod
    def failed(
        cls, problem: SearchProblem, supports: Bools, status: Status, model_error: float = NO_MODEL_ERROR
    ) -> "Fit":
        return cls(problem, supports, (), model_error, Score({"likelihood": np.inf}), status)

    def but(self, status: Status) -> "Fit":
        return Fit.failed(self.problem, self.supports, status, self.model_error)

    def __lt__(self, reference: "Fit") -> bool:
        """Return whether the score is less, so that ``min`` is the best fit."""
        return self.score < reference.score

    @property
    def is_usable(self) -> bool:
        return self.status is Status.FITTED

    def with_score(self, score: Score) -> Self:
        return self._like(score=score)

    def with_steps(self, steps: tuple[Step, ...]) -> Self:
        return self._like(steps=steps)

    def with_alternatives(self, others: Sequence["Fit"]) -> Self:
        """Return the fit with alternatives under the same errors, the best one of each supports."""
        listed = {fit.supports.tobytes(): fit for fit in sorted(others, reverse=True)}
        listed.pop(self.supports.tobytes(), None)
        return self._like(alternatives=tuple(replace(fit, alternatives=()) for fit in listed.values()))

    def with_alternatives_of(self, before: "Fit") -> Self:
        """Return the fit with the alternatives of an earlier one, at the same differences of scores."""
        more = self.score - before.score
        kept = (alternative.with_score(alternative.score.plus("refit", more)) for alternative in before.alternatives)
        return self._like(alternatives=tuple(kept))

    def _like(self, **changes: Any) -> Self:
        """Return the fit with other attributes, keeping cached results, which must not depend on these."""
        changed, of_estimates = (
            replace(self, **changes),
            (
                "evidence",
                "departures",
                "discretization_errors",
                "is_resolved",
                "diverges",
            ),
        )
        vars(changed).update({name: known for name, known in vars(self).items() if name in of_estimates})
        return changed

    @property
    def has_model_error(self) -> bool:
        """Whether there is a random walk, as no law fits the measurements within their noise."""
        return self.model_error > NO_MODEL_ERROR

    @property
    def fitted_model_error(self) -> float:
        """The model error at which the estimates were fitted."""
        return self.problem.errors_to_fit(self.model_error)[-1]

    @property
    def errors(self) -> ErrorKind:
        return "random-walk" if self.has_model_error else self.problem.errors.kind

    @property
    def has_process_noise(self) -> bool:
        """Whether there is process noise, besides measurement errors."""
        return self.errors in ("random-walk", "gp-forcing")

    @property
    def size(self) -> int:
        """Number of coefficients of an object."""
        return int(self.supports.sum())

    @cached_property
    def model(self) -> Model:
        """The fitted model."""
        terms, schema = self.problem.terms, self.problem.trials.schema
        given = np.any(np.nan_to_num(self.problem.known) != 0, axis=0)
        chosen = (self.supports | given) & terms.is_factor
        equations = tuple(tuple(terms.names[k] for k in np.flatnonzero(row)) for row in chosen)
        latent = tuple((name, str(start)) for name, start in schema.initial_values.items())
        return Model(
            self.problem.order, equations, self.errors, latent, schema.input_interpolation, tuple(schema.logarithmic)
        )

    @cached_property
    def evidence(self) -> SupportEvidence:
        """The evidence for supports, linearized about the estimates, see `linearized_evidence`."""
        return linearized_evidence(self.problem, self.estimates, self.fitted_model_error)

    @property
    def free_coefficients(self) -> list[Bools]:
        """The estimated coefficients of each object as masks of shape (equations, terms)."""
        pairs = zip(self.estimates, self.problem.known, strict=True)
        return [(estimate.coefficients != 0) & np.isnan(known) for estimate, known in pairs]

    @cached_property
    def regressions(self) -> list[Regression | None]:
        """The linear regression of each object about the estimates; None with a random walk or latent processes.

        None, too, for objects whose initial states are not identifiable.
        """
        models = self.problem.models
        if self.has_model_error or models[0].latent.width:
            return [None] * len(models)
        return list(map(Regression.of, models, self.estimates, self.free_coefficients))

    @property
    def predicted_decrease(self) -> float:
        """Decrease of minus twice the linearized log-likelihood to its minimum, ``|Q' r|^2``; zero at convergence."""
        chosen, decrease = np.flatnonzero(self.supports), 0.0
        for problem, estimate in zip(self.evidence.problems, self.estimates, strict=True):
            columns = problem.factor[:, chosen]
            residuals = problem.factor[:, -1] - columns @ estimate.coefficients.ravel()[chosen]
            decrease += float(np.sum((np.linalg.qr(columns)[0].T @ residuals) ** 2))
        return decrease

    @property
    def score_at_estimates(self) -> Score:
        """The score by the likelihood at the estimates instead of the maximum of its linearization.

        With R_0 the least sum of squares of the linearization, R = R_0 + `predicted_decrease` that at the estimates,
        and d(R) the `NoiseScale.deviance`, it is larger by d(R) - d(R_0). Both are equal at convergence; elsewhere,
        outliers and noise levels at the estimates do not belong to R_0, which may even be less than the outliers alone.
        """
        least = self.evidence.squares(self.supports)
        count, noise_scale = self.size * len(self.estimates), self.evidence.noise_scale
        there, here = (noise_scale.deviance(squares, count) for squares in (least + self.predicted_decrease, least))
        return self.score.plus("Laplace correction", float(there - here))

    @property
    def has_converged(self) -> bool:
        """Whether the maximum is within `SIGNIFICANT` standard errors; else Laplace's approximation does not hold.

        The predicted decrease is their square, of each object.
        """
        return self.predicted_decrease < settings.SIGNIFICANT**2 * len(self.estimates)

    @cached_property
    def departures(self) -> Departures:
        return NO_LAW if self.has_model_error else departures(self.problem, self.estimates)

    @cached_property
    def discretization_errors(self) -> list[DiscretizationErrors]:
        """The errors of collocation, see `discretization_errors`."""
        return discretization_errors(self.problem, self.estimates)

    @cached_property
    def is_resolved(self) -> bool:
        """Whether the discretization error is below the noise, see `is_resolved`."""
        return is_resolved(self.discretization_errors)

    @cached_property
    def diverges(self) -> bool:
        """Whether the trajectory of a trial diverges from its fitted initial state, see `diverges`."""
        return diverges(self.problem, self.estimates, self.discretization_errors)

    @property
    def is_solved(self) -> bool:
        """Whether the discretization error is below the noise, and no trajectory diverges."""
        return self.is_resolved and not self.diverges

    @property
    def lack_of_fit(self) -> str:
        """Description of the lack of fit, empty if there is none."""
        reason = "; ".join(words for words, is_of_noise in self.departures.items() if not is_of_noise)
        if not reason and self.diverges:
            return "trajectories of training trials diverge"
        return reason

    @property
    def has_few_measurements(self) -> bool:
        """Whether there are fewer than `MIN_SAMPLES_PER_TERM` measurements for each coefficient and initial state."""
        problem = self.problem
        numbers = self.size * len(problem.models) + problem.models[0].width * len(problem.trials)
        return bool(sum(problem.measured) < settings.MIN_SAMPLES_PER_TERM * numbers)

    @property
    def reason_for_error_model(self) -> str:
        """Why errors other than white noise are estimated, as text; empty if they are not."""
        reason = "; ".join(self.departures) or self.lack_of_fit
        if reason or not self.problem.errors:
            few = self.has_few_measurements and not self.problem.noise_is_fixed
            return reason or ("too few measurements to test for heteroscedasticity" if few else "")
        return "the noise is heteroscedastic"

    def neighbours(self) -> list[list[tuple[float, Bools]]]:
        """Return the neighbouring supports of each equation, see `SupportEvidence.neighbours`."""
        exact = [(max(alternative.score - self.score, 0.0), alternative.supports) for alternative in self.alternatives]
        return self.evidence.neighbours(self.supports, exact)

    def predicted_neighbours(self) -> Iterator[tuple[float, Bools]]:
        """Yield neighbouring supports with minus twice their log-evidence, linearized about the fit."""
        for j, listed in enumerate(self.evidence.neighbours(self.supports)):
            for more, support in listed:
                supports = self.supports.copy()
                supports[j] = support
                yield self.score.total + more, supports

    def refitted(self, supports: Bools, model_error: float | None = None) -> "Fit":
        """Return the fit of other supports from the maximum of their linearized likelihood."""
        error = self.model_error if model_error is None else model_error
        if not self.is_usable:
            return Fit.failed(self.problem, supports, self.status, error)
        start = restricted(self.problem, self.evidence, self.estimates, supports)
        return fitted(self.problem, start, supports, error)


def best_fit(fits: Sequence[Fit]) -> Fit:
    """Return the fit of largest evidence.

    Raises `CommonlawError` if none succeeded.
    """
    best = min(fits, default=None)
    if best is None or not best.is_usable:
        raise CommonlawError("no-law-near-measurements")
    return best


def fitted(problem: SearchProblem, estimates: Sequence[Estimate] | None, supports: Bools, model_error: float) -> Fit:
    """Return the fit of supports from initial estimates at a model error, zero for solutions of the law.

    Estimated coefficients outside of the supports start, and remain, at zero. A model error no larger than that of
    solutions, see `SearchProblem.errors_to_fit`, is none. It is a failed fit without estimates, or if the likelihood is
    not computable.
    """
    if model_error <= problem.errors_to_fit(NO_MODEL_ERROR)[-1]:
        model_error = NO_MODEL_ERROR
    if estimates is None:
        return Fit.failed(problem, supports, Status.NOT_COMPUTABLE, model_error)
    kept = supports | ~np.isnan(problem.known)
    starts = [
        replace(estimate, coefficients=np.where(inside, estimate.coefficients, 0.0))
        for estimate, inside in zip(estimates, kept, strict=True)
    ]
    try:
        done = fit_each(problem.models, starts, supports, problem.errors_to_fit(model_error))
        fit = Fit(problem, supports, _identified(problem, done, supports, model_error), model_error, Score({}))
        return fit.with_score(fit.evidence.score(supports))
    except NotPositiveError:
        return Fit.failed(problem, supports, Status.NOT_COMPUTABLE, model_error)


def fully_measured(problem: SearchProblem, estimates: Sequence[Estimate]) -> list[Floats]:
    """Return the coefficients of the objects of which each state was measured, each of shape (equations, terms)."""
    pairs = zip(estimates, problem.measured_states, strict=True)
    return [estimate.coefficients for estimate, measured in pairs if measured.all()]


def _identified(
    problem: SearchProblem, estimates: tuple[Estimate, ...], supports: Bools, model_error: float
) -> tuple[Estimate, ...]:
    """Return the estimates; of objects with unmeasured states those with coefficients fixed at pooled values.

    The scale of an unmeasured state is identified by other objects alone. An object that does not fit with their
    coefficients keeps its own.
    """
    whole, result = fully_measured(problem, estimates), list(estimates)
    if len(whole) in (0, len(estimates)):
        return estimates
    last = problem.errors_to_fit(model_error)[-1]
    schedule = (*(error for error in settings.MODEL_ERRORS if error > last), last)
    for o, (model, start) in enumerate(zip(problem.models, problem.starts, strict=True)):
        if not problem.measured_states[o].all():
            free = supports & ~problem.fixed_at_pooled(o)
            (estimate,) = fit_each([model], [pooled_start(model, start, whole)], free, schedule)
            if estimate.deviance < settings.MAX_DEVIANCE_RATIO * result[o].deviance:
                result[o] = estimate
    return tuple(result)


def restricted(
    problem: SearchProblem, evidence: SupportEvidence, estimates: Sequence[Estimate], supports: Bools
) -> tuple[Estimate, ...] | None:
    """Return the estimates with coefficients at the maximum of the linearized likelihood of supports.

    Nonlinear parameters are kept. None if the linearization is not finite.
    """
    if not all(np.isfinite(problem.factor).all() for problem in evidence.problems):
        return None
    factors = problem.terms.is_factor
    held = np.array([np.where(supports & ~factors, estimate.coefficients, 0.0) for estimate in estimates])
    coefficients = evidence.coefficients(supports & factors, held) + np.nan_to_num(problem.known)
    return tuple(replace(estimate, coefficients=theta) for estimate, theta in zip(estimates, coefficients, strict=True))


def linearized_evidence(problem: SearchProblem, estimates: Sequence[Estimate], model_error: float) -> SupportEvidence:
    """Return the evidence of supports by the likelihood linearized about estimates, comparable between model errors.

    With the Huber threshold c, an outlier of size u contributes ``c u`` to the sum of weighted squares, or nothing if
    it is rejected, and has the penalty ``c^2``, that of a measurement at the threshold. Raises `NotPositiveError` if
    numbers are not finite, or too far apart.
    """
    linear = linearize_each(problem.models, estimates, model_error)
    pairs = zip(linear, np.nan_to_num(problem.known), strict=True)
    problems = [
        linearization.problem.subtract(beta.reshape(1, -1)) if beta.any() else linearization.problem
        for linearization, beta in pairs
    ]
    model, states = problem.models[0], np.concatenate([z for estimate in estimates for z in estimate.states])
    sizes = np.abs((problem.measurements - states @ model.observed.T) / problem.white_std)
    threshold = model.observation.huber_threshold
    outliers = sizes[sizes > threshold]
    penalty = float(threshold**2 * len(outliers)) if len(outliers) else 0.0
    noise_scale = replace(
        problem.noise_scale,
        outliers=float(threshold * outliers.sum()) if len(outliers) and not model.observation.rejects else 0.0,
        freedom=problem.noise_scale.freedom - len(outliers),
    )
    offsets: dict[Part, float] = {
        "latent states": sum(linearization.log_determinant for linearization in linear),
        "model error": model_error_penalty(problem, model_error),
        "error levels": problem.level_penalty,
        "outliers": 0.0 if problem.noise_is_fixed else penalty,
    }
    log_parametrized = None
    if problem.terms.parameters:  # Those whose signs differ between objects have no logarithms
        values = np.array([estimate.coefficients for estimate in estimates])
        parametrized = problem.allowed & np.array(problem.terms.have_parameters, dtype=bool)
        same = np.abs(np.sign(values).sum(axis=0)) == len(values)
        log_parametrized = np.where(parametrized & same, values, 0.0).reshape(len(values), -1)
    most, stated = problem.most_terms, problem.trials.schema.is_latent
    return SupportEvidence(
        problems, problem.allowed, noise_scale, problem.structure_prior, most, offsets, stated, log_parametrized
    )


def model_error_penalty(problem: SearchProblem, model_error: float) -> float:
    """Return the penalty log n of a model error in a sampling step, one fitted number (BIC)."""
    is_fitted = model_error * np.sqrt(problem.points) > settings.FINAL_MODEL_ERRORS[0]
    is_fitted &= model_error > problem.errors_to_fit(NO_MODEL_ERROR)[-1]
    return float(np.log(sum(problem.measured))) if is_fitted else 0.0
