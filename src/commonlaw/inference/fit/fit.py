"""A model fitted to trials: supports with the estimates of all objects, and the likelihood linearized about them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.fit.lack_of_fit import NO_LAW, Departure, departures, diverges, in_words, is_resolved
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.score.score import Part, Score
from commonlaw.inference.score.supports import SupportEvidence
from commonlaw.law import Step
from commonlaw.library import Order
from commonlaw.likelihood import Estimate, NotPositiveError, fit_each, linearize_each
from commonlaw.outcomes import Outcome
from commonlaw.runtime.fit_options import ErrorKind

NO_ERROR = 0.0
"""The model error of laws whose solutions the trajectories are."""

ANY_ERROR = (*settings.MODEL_ERRORS, NO_ERROR)
"""Model errors that are compared, and none."""

PLAUSIBLE = float(-2 * np.log(settings.MIN_PROBABILITY))
"""2 log B up to which a law is as probable as the best."""


class Status(StrEnum):
    """What became of a fit."""

    FITTED = "fitted"
    NOT_COMPUTABLE = "the likelihood cannot be computed"
    NOT_CONVERGED = "not converged"
    HAS_POLE = "a denominator vanishes at or between the states"
    NOT_IDENTIFIABLE = "nonlinear parameters are not identifiable"
    WITHOUT_EFFECT = "no term, or a latent state without effect"
    REFUSED = "the trials are incompatible with the model"


class Model(NamedTuple):
    """Everything by which two candidate laws can differ; equal models are one model.

    Equations are terms by their names, with those that are known; a latent state has its initial value, as text.
    """

    order: Order
    equations: tuple[tuple[str, ...], ...]
    errors: ErrorKind
    latent_states: tuple[tuple[str, str], ...]
    input_interpolation: str
    log_states: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Fit:
    """A model with the estimates of all objects.

    Parameters
    ----------
    problem
        Trials on meshes, candidate terms, and the levels of errors.
    supports
        Which terms each equation has, shape (equations, terms).
    estimates
        States and coefficients of each object; none if the fit failed.
    model_error
        Standard deviation of a random walk in each step, relative to the noise; zero for solutions of the law.
    score
        Minus twice the log-evidence, but for a constant; infinite if the fit failed.
    status
        What became of it.
    alternatives
        Fits of other supports under the same errors.
    steps, outcomes
        What is to be said of how the model came about.
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

    @classmethod
    def failed(cls, problem: SearchProblem, supports: Bools, status: Status, model_error: float = NO_ERROR) -> "Fit":
        """Return a fit that failed: it is less probable than any other."""
        return cls(problem, supports, (), model_error, Score({"likelihood": np.inf}), status)

    def but(self, status: Status) -> "Fit":
        """Return the fit as one that failed after all."""
        return Fit.failed(self.problem, self.supports, status, self.model_error)

    def __lt__(self, other: "Fit") -> bool:
        """Return whether the score is less: the best fit is the least."""
        return self.score < other.score

    @property
    def is_usable(self) -> bool:
        """Whether the fit succeeded."""
        return self.status is Status.FITTED

    def with_score(self, score: Score) -> Self:
        """Return the fit with another score."""
        return self._like(score=score)

    def with_alternatives(self, others: Sequence["Fit"]) -> Self:
        """Return the fit with others, under the same errors: the best with each supports."""
        listed = {fit.supports.tobytes(): fit for fit in sorted(others, reverse=True)}
        listed.pop(self.supports.tobytes(), None)
        return self._like(alternatives=tuple(replace(fit, alternatives=()) for fit in listed.values()))

    def with_alternatives_of(self, before: "Fit") -> Self:
        """Return the fit with the alternatives of one that was fitted before, by as much less plausible."""
        more = self.score - before.score
        kept = (alternative.with_score(alternative.score.plus("refit", more)) for alternative in before.alternatives)
        return self._like(alternatives=tuple(kept))

    def _like(self, **changes: Any) -> Self:
        """Return the fit with changes that its linearization does not depend on."""
        changed, of_estimates = replace(self, **changes), ("evidence", "departures", "is_resolved", "diverges")
        vars(changed).update({name: known for name, known in vars(self).items() if name in of_estimates})
        return changed

    @property
    def has_model_error(self) -> bool:
        """Whether the measurements depart from the law by more than their noise."""
        return self.model_error > NO_ERROR

    @property
    def fitted_model_error(self) -> float:
        """The model error at which the estimates were fitted."""
        return errors_to_fit(self.model_error)[-1]

    @property
    def errors(self) -> ErrorKind:
        """The kind of errors of the model."""
        return "walk" if self.has_model_error else self.problem.errors.kind

    @property
    def has_process_noise(self) -> bool:
        """Whether the law itself errs, and not the measurements alone."""
        return self.errors in ("walk", "force")

    @property
    def size(self) -> int:
        """How many coefficients an object has."""
        return int(self.supports.sum())

    @cached_property
    def model(self) -> Model:
        """What was fitted."""
        terms, schema = self.problem.terms, self.problem.trials.schema
        given = np.any(np.nan_to_num(self.problem.known) != 0, axis=0)
        chosen = (self.supports | given) & terms.is_factor
        equations = tuple(tuple(terms.names[k] for k in np.flatnonzero(row)) for row in chosen)
        latent = tuple((name, str(start)) for name, start in schema.starts.items())
        return Model(
            self.problem.order, equations, self.errors, latent, schema.input_between, tuple(schema.logarithmic)
        )

    @cached_property
    def evidence(self) -> SupportEvidence:
        """The evidence for supports by the likelihood linearized about the estimates, see `linearized_evidence`."""
        return linearized_evidence(self.problem, self.estimates, self.fitted_model_error)

    @property
    def predicted_decrease(self) -> float:
        """By how much minus twice the linearized log-likelihood is less elsewhere: next to nothing at its maximum."""
        chosen, decrease = np.flatnonzero(self.supports), 0.0
        for problem, estimate in zip(self.evidence.problems, self.estimates, strict=True):
            columns = problem.factor[:, chosen]
            residuals = problem.factor[:, -1] - columns @ estimate.coefficients.ravel()[chosen]
            decrease += float(np.sum((np.linalg.qr(columns)[0].T @ residuals) ** 2))
        return decrease

    @property
    def has_converged(self) -> bool:
        """Whether the linearized likelihood predicts next to nothing more elsewhere.

        Where it does, the fit got stuck on the way, and the evidence that is computed about it means nothing.
        """
        return self.predicted_decrease < settings.MAX_PREDICTED_DECREASE * len(self.estimates)

    @cached_property
    def departures(self) -> tuple[Departure, ...]:
        """In what the residuals depart from white noise."""
        return (NO_LAW,) if self.has_model_error else departures(self.problem, self.estimates)

    @cached_property
    def is_resolved(self) -> bool:
        """Whether the discretization error is below the noise, see `is_resolved`."""
        return is_resolved(self.problem, self.estimates)

    @cached_property
    def diverges(self) -> bool:
        """Whether a trajectory of a trial diverges from its fitted start, see `diverges`."""
        return diverges(self.problem, self.estimates)

    @property
    def is_solved(self) -> bool:
        """Whether solutions of the law follow the trials, from their starts and step by step."""
        return self.is_resolved and not self.diverges

    @property
    def lack_of_fit(self) -> str:
        """What speaks against the law itself, whatever its noise, in words; nothing if nothing does."""
        reason = in_words(departure for departure in self.departures if not departure.is_of_noise)
        if not reason and self.diverges:
            return "trajectories of training trials diverge"
        return reason

    @property
    def has_few_measurements(self) -> bool:
        """Whether objects have fewer measurements for each coefficient and start than terms need.

        A law may follow these, so that what it leaves does not show their errors.
        """
        problem = self.problem
        numbers = self.size * len(problem.models) + problem.models[0].width * len(problem.trials)
        return bool(sum(problem.measured) < settings.MIN_SAMPLES_PER_TERM * numbers)

    @property
    def reason_for_errors(self) -> str:
        """Why errors besides white noise are to be estimated with the law, in words; nothing if they are not."""
        reason = in_words(self.departures) or self.lack_of_fit
        if reason or not self.problem.errors:
            few = self.has_few_measurements and not self.problem.noise_is_fixed
            return reason or ("too few measurements to test for heteroscedasticity" if few else "")
        return "the noise is heteroscedastic"

    def neighbours(self) -> list[list[tuple[float, Bools]]]:
        """Return the supports next to those of the fit, by equation, see `SupportEvidence.neighbours`."""
        exact = [(alternative.score - self.score, alternative.supports) for alternative in self.alternatives]
        return self.evidence.neighbours(self.supports, exact)

    def predicted_neighbours(self) -> Iterator[tuple[float, Bools]]:
        """Yield the supports next to those of the fit, with minus twice their log-evidence as linearized about it."""
        for j, listed in enumerate(self.evidence.neighbours(self.supports)):
            for more, support in listed:
                supports = self.supports.copy()
                supports[j] = support
                yield self.score.total + more, supports

    def refitted(self, supports: Bools, model_error: float | None = None) -> "Fit":
        """Return other supports fitted, from the coefficients that the linearized likelihood gives for them."""
        error = self.model_error if model_error is None else model_error
        if not self.is_usable:
            return Fit.failed(self.problem, supports, self.status, error)
        start = restricted(self.problem, self.evidence, self.estimates, supports)
        return fitted(self.problem, start, supports, error)


def errors_to_fit(model_error: float) -> tuple[float, ...]:
    """Return the model errors that are fitted with one after the other, to come to one; none is approached."""
    return (model_error,) if model_error else settings.FINAL_MODEL_ERRORS


def best_of(fits: Sequence[Fit]) -> Fit:
    """Return the fit of largest evidence.

    Raises `CommonlawError` if none succeeded.
    """
    best = min(fits, default=None)
    if best is None or not best.is_usable:
        raise CommonlawError("no-law-near-measurements")
    return best


def fitted(problem: SearchProblem, estimates: Sequence[Estimate] | None, supports: Bools, model_error: float) -> Fit:
    """Return supports fitted from estimates at a model error, or without one where it is zero.

    The fit fails where there are no estimates, or the likelihood cannot be computed.
    """
    if estimates is None:
        return Fit.failed(problem, supports, Status.NOT_COMPUTABLE, model_error)
    try:
        done = fit_each(problem.models, estimates, supports, errors_to_fit(model_error))
        fit = Fit(problem, supports, done, model_error, Score({}))
        return fit.with_score(fit.evidence.score(supports))
    except NotPositiveError:
        return Fit.failed(problem, supports, Status.NOT_COMPUTABLE, model_error)


def restricted(
    problem: SearchProblem, evidence: SupportEvidence, estimates: Sequence[Estimate], supports: Bools
) -> tuple[Estimate, ...] | None:
    """Return the estimates with the coefficients that the linearized likelihood gives for supports.

    Parameters inside terms, in which it is not linear, stay. None if it is not finite.
    """
    if not all(np.isfinite(problem.factor).all() for problem in evidence.problems):
        return None
    factors = problem.terms.is_factor
    held = np.array([np.where(supports & ~factors, estimate.coefficients, 0.0) for estimate in estimates])
    coefficients = evidence.coefficients(supports & factors, held) + np.nan_to_num(problem.known)
    return tuple(replace(estimate, coefficients=theta) for estimate, theta in zip(estimates, coefficients, strict=True))


def linearized_evidence(problem: SearchProblem, estimates: Sequence[Estimate], model_error: float) -> SupportEvidence:
    """Return the evidence by the likelihood linearized about estimates, comparable between model errors.

    Raises `NotPositiveError` if numbers are not finite, or too far apart.
    """
    linear = linearize_each(problem.models, estimates, model_error)
    known = np.nan_to_num(problem.known)
    pairs = zip(linear, known, strict=True)
    problems = [
        linearization.problem.subtract(beta.reshape(1, -1)) if beta.any() else linearization.problem
        for linearization, beta in pairs
    ]
    outliers, cost, count = _outliers(problem, estimates)
    noise_scale = problem.noise_scale.with_outliers(outliers, count)
    offsets: dict[Part, float] = {
        "latent states": sum(linearization.log_determinant for linearization in linear),
        "model error": model_error_penalty(model_error, sum(problem.measured)),
        "error levels": problem.error_level_penalty,
        "outliers": 0.0 if problem.noise_is_fixed else cost,
    }
    log_parametrized = None
    if problem.terms.parameters:  # Those whose signs differ between objects have no logarithms
        values = np.array([estimate.coefficients for estimate in estimates])
        parametrized = problem.allowed & np.array(problem.terms.have_parameters, dtype=bool)
        same = np.abs(np.sign(values).sum(axis=0)) == len(values)
        log_parametrized = np.where(parametrized & same, values, 0.0).reshape(len(values), -1)
    most, stated = problem.most_terms, problem.trials.schema.unmeasured
    return SupportEvidence(
        problems, problem.allowed, noise_scale, problem.structure_prior, most, offsets, stated, log_parametrized
    )


def model_error_penalty(model_error: float, count: int) -> float:
    """Return what a model error costs where so many numbers were measured: as any number to be found (BIC)."""
    return float(np.log(count)) if model_error > settings.FINAL_MODEL_ERRORS[0] else 0.0


def _outliers(problem: SearchProblem, estimates: Sequence[Estimate]) -> tuple[float, float, int]:
    """Return what outliers add to the sum of squares, what they cost where that does not count, and how many there are.

    Each costs what a measurement at the threshold does, however far off it is: else a law under noise that is too small
    has all the outliers that it needs.
    """
    model, states = problem.models[0], np.concatenate([z for estimate in estimates for z in estimate.states])
    residuals = problem.measurements.measured - states @ model.observed.T
    sizes, bound = np.abs(residuals / problem.white_std), model.observation.huber_threshold
    far = sizes[sizes > bound]
    return (float(bound * far.sum()), float(bound**2 * len(far)), len(far)) if len(far) else (0.0, 0.0, 0)
