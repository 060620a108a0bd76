"""What a search goes from and to: supports with the estimates of all objects, and the evidence for others about it."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.score.score import Part, Score
from commonlaw.inference.score.supports import ComparedSupport, SupportEvidence
from commonlaw.likelihood import Estimate, Linearization, NotPositiveError, fit_each, linearize_each
from commonlaw.solvers import AbstractSolver

NO_ERROR = 0.0
"""The model error of laws whose solutions the trajectories are."""

MODEL_ERRORS = (10.0, 3.0, 1.0, 0.3, 0.1)
"""Model errors that are compared where the measurements follow no law."""

ANY_ERROR = (*MODEL_ERRORS, NO_ERROR)
"""Those, and none."""

FINAL = (0.03, 0.003, 0.0003)
"""Model errors down to which laws without one are fitted. The last times the number of samples of a trial should be
below one: what is allowed in each step adds up, and coefficients would be less accurate than the data allow."""


LEAST = 0.01
"""Probability below which a law is not carried along: what it says would not move an interval of 95 % by much."""

MOST = 12
"""Laws that are carried along at most."""

PLAUSIBLE = float(-2 * np.log(LEAST))
"""2 log B up to which a law is as probable as that beside the best."""

_UNSETTLED = 4.0
"""Twice the log-likelihood for each object that a fit may be promised elsewhere: hardly more than it may be held by."""


@dataclass(frozen=True, eq=False)
class SearchState:
    """Supports, shape (equations, terms), and the estimates of all objects with them.

    The model error is its standard deviation in each step, relative to the noise; the score is minus twice the
    log-evidence, but for a constant. Alternatives are states with other supports, fitted under the same errors. The
    evidence for supports is kept where it was found with the state.
    """

    supports: Bools
    estimates: tuple[Estimate, ...]
    model_error: float
    score: Score
    alternatives: "tuple[SearchState, ...]" = ()
    linearized: "Linearized | None" = None

    def with_alternatives(self, others: Sequence["SearchState"]) -> "SearchState":
        """Return the state with others, which were fitted under the same errors: the best with each supports."""
        listed = {each.supports.tobytes(): each for each in sorted(others, key=lambda each: -each.score.total)}
        listed.pop(self.supports.tobytes(), None)
        kept = tuple(replace(each, alternatives=(), linearized=None) for each in listed.values())
        return replace(self, alternatives=kept)

    def keeping(self, before: "SearchState") -> "SearchState":
        """Return the state with the alternatives of one that was fitted before, by as much less plausible."""
        more = self.score - before.score
        kept = (replace(each, score=each.score.plus("refit", more)) for each in before.alternatives)
        return replace(self, alternatives=tuple(kept))

    @property
    def fitted(self) -> tuple[tuple[float, Bools], ...]:
        """2 log B of all alternatives against the state, with their supports."""
        return tuple((each.score - self.score, each.supports) for each in self.alternatives)

    @property
    def has_model_error(self) -> bool:
        """Whether the measurements depart from the law by more than their noise."""
        return self.model_error > NO_ERROR

    @property
    def fitted_model_error(self) -> float:
        """The model error at which the estimates were fitted."""
        return errors_to_fit(self.model_error)[-1]


@dataclass(frozen=True, eq=False)
class Linearized:
    """The evidence for supports of a problem by the likelihood linearised about estimates."""

    problem: SearchProblem
    estimates: Sequence[Estimate]
    evidence: SupportEvidence


def errors_to_fit(model_error: float) -> tuple[float, ...]:
    """Return the model errors that are fitted with one after the other, to come to one; none is approached."""
    return (model_error,) if model_error else FINAL


def list_by_evidence(found: Sequence[SearchState]) -> list[SearchState]:
    """Return what was found, the largest evidence first; nothing found is an error."""
    if not found:
        raise CommonlawError("no-law-near-measurements")
    return sorted(found, key=lambda each: each.score)


def neighbours(problem: SearchProblem, state: SearchState) -> list[list[ComparedSupport]]:
    """Return the supports next to those found, equation by equation, see `SupportEvidence.neighbours`."""
    return evidence_about(problem, state).neighbours(state.supports, state.fitted)


def nearest(problem: SearchProblem, state: SearchState, count: int) -> list[Bools]:
    """Return the supports of largest evidence next to those found: so many for each equation."""
    here = np.eye(len(state.supports), dtype=bool)[:, :, np.newaxis]
    return [
        np.where(here[j], each.support, state.supports)
        for j, listed in enumerate(neighbours(problem, state))
        for each in listed[:count]
    ]


def promised_near(problem: SearchProblem, state: SearchState) -> Iterator[tuple[float, Bools]]:
    """Yield the supports next to those of a state, with minus twice their log-evidence as linearised about it."""
    for j, listed in enumerate(evidence_about(problem, state).neighbours(state.supports)):
        here = next(each.twice_log_bayes_factor for each in listed if np.array_equal(each.support, state.supports[j]))
        for each in listed:
            supports = state.supports.copy()
            supports[j] = each.support
            yield state.score.total + each.twice_log_bayes_factor - here, supports


def path(problem: SearchProblem, state: SearchState, solver: AbstractSolver) -> Iterator[Bools]:
    """Yield the supports from no term to many that a solver lists for each equation, the others being as found."""
    evidence = evidence_about(problem, state)
    for j in range(len(state.supports)):
        for own in evidence.path(state.supports, j, solver):
            changed = state.supports.copy()
            changed[j] = own
            yield changed


def evidence_of(problem: SearchProblem, state: SearchState, listed: Sequence[Bools]) -> list[float]:
    """Return minus twice the log-evidence of supports, by the likelihood linearised about a state."""
    evidence = evidence_about(problem, state)
    return [evidence.value(each) for each in listed]


def evidence_about(problem: SearchProblem, state: SearchState) -> SupportEvidence:
    """Return the evidence by the likelihood linearised about a state, at the model error that it was fitted with."""
    known = state.linearized
    if known is not None and known.problem is problem and known.estimates is state.estimates:
        return known.evidence
    return linearized_evidence(problem, state.estimates, state.fitted_model_error)


def linearized_evidence(problem: SearchProblem, estimates: Sequence[Estimate], model_error: float) -> SupportEvidence:
    """Return the evidence by the likelihood linearised about estimates, comparable between model errors."""
    linear = linearize_each(problem.models, estimates, model_error)
    known = np.nan_to_num(problem.known)
    pairs = zip(linear, known, strict=True)
    problems = [each.problem.subtract(own.reshape(1, -1)) if own.any() else each.problem for each, own in pairs]
    outliers, cost, count = _outliers(problem, estimates)
    counted = problem.counted.with_outliers(outliers, count)
    extra = offsets(problem, linear, model_error) | {"outliers": 0.0 if problem.noise_is_fixed else cost}
    most, stated = problem.most_terms, problem.trials.schema.unmeasured
    in_ratios = _in_ratios(problem, estimates)
    return SupportEvidence(problems, problem.allowed, counted, problem.prices, most, extra, stated, in_ratios)


def is_settled(problem: SearchProblem, state: SearchState) -> bool:
    """Return whether the likelihood, linearised about a fit, promises next to nothing more elsewhere.

    Where it does, the fit got stuck on the way, and the evidence that is computed about it means nothing.
    """
    return promised(problem, state) < _UNSETTLED * len(state.estimates)


def promised(problem: SearchProblem, state: SearchState) -> float:
    """Return what the likelihood, linearised about a fit, promises elsewhere, in twice its logarithm."""
    chosen, found = np.flatnonzero(state.supports), 0.0
    for each, estimate in zip(evidence_about(problem, state).problems, state.estimates, strict=True):
        columns = each.factor[:, chosen]
        left = each.factor[:, -1] - columns @ estimate.coefficients.ravel()[chosen]
        found += float(np.sum((np.linalg.qr(columns)[0].T @ left) ** 2))
    return found


def _in_ratios(problem: SearchProblem, estimates: Sequence[Estimate]) -> Floats | None:
    """Return the values of constants inside of terms, and of what such terms are multiplied by; zero of all others.

    And of those whose signs differ between objects, shape (objects, equations x terms); nothing without constants.
    """
    terms = problem.models[0].terms
    if not terms.constants:
        return None
    values = np.array([each.coefficients for each in estimates])
    own = problem.allowed & np.array(terms.have_constants, dtype=bool)
    same = np.abs(np.sign(values).sum(axis=0)) == len(values)
    return np.where(own & same, values, 0.0).reshape(len(values), -1)


def offsets(problem: SearchProblem, linear: Sequence[Linearization], model_error: float) -> dict[Part, float]:
    """Return what is added to minus twice the log-evidence of all supports, for its errors.

    A model error is one more number to be found, at the price of any (BIC).
    """
    return {
        "latent states": sum(each.log_determinant for each in linear),
        "model error": price_of_model_error(model_error, sum(problem.measured)),
        "error levels": problem.price_of_errors,
    }


def price_of_model_error(model_error: float, count: int) -> float:
    """Return what a model error costs where so many numbers were measured."""
    return float(np.log(count)) if model_error > FINAL[0] else 0.0


def _outliers(problem: SearchProblem, estimates: Sequence[Estimate]) -> tuple[float, float, int]:
    """Return what outliers add to the sum of squares, what they cost where that does not count, and how many there are.

    Each costs what a measurement at the threshold does, however far off it is: else a law under noise that is too small
    has all the outliers that it needs.
    """
    model, states = problem.models[0], np.concatenate([own for each in estimates for own in each.states])
    residuals = problem.measurements.measured - states @ model.observed.T
    sizes, bound = np.abs(residuals / problem.white_std), model.observation.huber_threshold
    far = sizes[sizes > bound]
    return (float(bound * far.sum()), float(bound**2 * len(far)), len(far)) if len(far) else (0.0, 0.0, 0)


def fit_neighbours(problem: SearchProblem, state: SearchState, listed: Sequence[Bools]) -> list[SearchState]:
    """Return other supports fitted under the errors of a state, from the coefficients that are linear about it.

    What cannot be computed is left out.
    """
    found = list[SearchState]()
    with suppress(NotPositiveError):
        evidence = linearized_evidence(problem, state.estimates, state.model_error)
        for supports in listed:
            with suppress(NotPositiveError):
                start = restricted(problem, evidence, state.estimates, supports)
                found.append(fitted(problem, start, supports, state.model_error)[0])
    return found


def fitted(
    problem: SearchProblem, estimates: Sequence[Estimate], supports: Bools, model_error: float
) -> tuple[SearchState, SupportEvidence]:
    """Return the state fitted with these supports at a model error, with none where it is negligible; its evidence."""
    model_errors = errors_to_fit(model_error)
    done = fit_each(problem.models, estimates, supports, model_errors)
    evidence = linearized_evidence(problem, done, model_errors[-1])
    known = Linearized(problem, done, evidence)
    return SearchState(supports, done, model_error, evidence.score(supports), linearized=known), evidence


def restricted(
    problem: SearchProblem, evidence: SupportEvidence, estimates: Sequence[Estimate], supports: Bools
) -> tuple[Estimate, ...]:
    """Return the estimates with the coefficients that the linearised likelihood gives for these supports.

    Constants inside of terms, in which it is not linear, stay.

    Raises
    ------
    NotPositiveError
        If the likelihood could not be linearised: numbers are not finite.
    """
    if not all(np.isfinite(each.factor).all() for each in evidence.problems):
        raise NotPositiveError
    factors = problem.models[0].terms.is_factor
    held = np.array([np.where(supports & ~factors, each.coefficients, 0.0) for each in estimates])
    coefficients = evidence.coefficients(supports & factors, held) + np.nan_to_num(problem.known)
    return tuple(replace(each, coefficients=own) for each, own in zip(estimates, coefficients, strict=True))
