"""The search for the supports of a law, from many terms to few, while the trajectories become solutions of it.

At each model error the likelihood is linearised about the trajectories and coefficients so far, the supports of largest
evidence are chosen on it, and both are fitted again. Supports and model errors are compared by their evidence: where
the measurements follow a law of the library, the smallest model error wins; where they do not, one wins that is not
negligible, a random walk that pushes the states off their course (weak constraint; Evensen 2009, chapter 7).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.errors import CommonlawError
from commonlaw.inference.search_problem import SearchProblem
from commonlaw.inference.support_search import ComparedSupport, SupportEvidence
from commonlaw.likelihood import Estimate, NotPositiveError, fit, linearize
from commonlaw.progress import ProgressCallback
from commonlaw.solvers import AbstractSolver

SCHEDULES = ((3.0, 1.0, 0.3, 0.1, 0.03), (0.3, 0.03), (0.1, 0.03))
"""Model errors, relative to the noise, at which supports are chosen. Different ways find different supports; the best
is kept."""

MODEL_ERRORS = (10.0, 3.0, 1.0, 0.3, 0.1)
"""Model errors that are compared where the measurements follow no law."""

NEGLIGIBLE = 0.03
"""At and below this model error the measurements count as following the law."""

FINAL = (0.03, 0.003, 0.0003)
"""Model errors down to which laws without one are fitted. The last times the number of samples of a trial should be
below one: what is allowed in each step adds up, and coefficients would be less accurate than the data allow."""

_ROUNDS = 6
"""How often supports are chosen and fitted at one model error at the end."""


@dataclass(frozen=True, eq=False)
class SearchState:
    """Supports, shape (equations, terms), and the estimates of all objects with them.

    The model error is its standard deviation in each step, relative to the noise; the value is minus twice the
    log-evidence, but for a constant.
    """

    supports: Bools
    estimates: tuple[Estimate, ...]
    model_error: float
    value: float

    @property
    def has_model_error(self) -> bool:
        """Whether the measurements depart from the law by more than their noise."""
        return self.model_error > NEGLIGIBLE

    @property
    def fitted_model_error(self) -> float:
        """The model error at which the estimates were fitted."""
        return self.model_error if self.has_model_error else FINAL[-1]


def search(problem: SearchProblem, solver: AbstractSolver, progress: ProgressCallback) -> SearchState:
    """Return the supports and model error of largest evidence that are found, and the estimates with them."""
    found = []
    for number, model_errors in enumerate(SCHEDULES, start=1):
        progress(f"choosing terms, way {number} of {len(SCHEDULES)}")
        found += _anneal(problem, solver, model_errors)
    return _best(found)


def polish(
    problem: SearchProblem, supports: Bools, estimates: Sequence[Estimate], model_error: float, solver: AbstractSolver
) -> SearchState:
    """Choose and fit at one model error until nothing gets better."""
    best: SearchState | None = None
    for _ in range(_ROUNDS):
        state, evidence = _fitted(problem, estimates, supports, model_error)
        if best is not None and not state.value < best.value:
            break
        best = state
        chosen = evidence.choose(supports, solver)
        if np.array_equal(chosen, supports):
            break
        supports, estimates = chosen, _restricted(problem, evidence, state.estimates, chosen)
    assert best is not None
    return best


def fit_supports(problem: SearchProblem, supports: Bools, model_errors: Sequence[float] = MODEL_ERRORS) -> SearchState:
    """Return the estimates with these supports, and with the model error of largest evidence.

    Parameters
    ----------
    problem
        What was measured.
    supports
        Shape (equations, terms).
    model_errors
        Those that are compared, relative to the noise, from large to small.

    Raises
    ------
    CommonlawError
        If the likelihood cannot be computed.
    """
    found: list[SearchState] = []
    estimates: tuple[Estimate, ...] = problem.starts
    for model_error in model_errors:
        try:
            evidence = _evidence(problem, estimates, model_error)
            state, _ = _fitted(problem, _restricted(problem, evidence, estimates, supports), supports, model_error)
        except NotPositiveError:
            break
        found.append(state)
        estimates = state.estimates
    return _best(found)


def neighbours(problem: SearchProblem, state: SearchState) -> list[list[ComparedSupport]]:
    """Return the supports next to those found, equation by equation, see `SupportEvidence.neighbours`."""
    return _evidence(problem, state.estimates, state.model_error).neighbours(state.supports)


def _anneal(problem: SearchProblem, solver: AbstractSolver, model_errors: Sequence[float]) -> list[SearchState]:
    """Choose and fit, one model error after the other; return what was found at each, as far as it can be computed."""
    supports: Bools = problem.allowed
    estimates: tuple[Estimate, ...] = problem.starts
    found: list[SearchState] = []
    for model_error in model_errors:
        try:
            evidence = _evidence(problem, estimates, model_error)
            chosen = evidence.choose(supports, solver)
            if not np.array_equal(chosen, supports):
                supports, estimates = chosen, _restricted(problem, evidence, estimates, chosen)
            if model_error > NEGLIGIBLE:
                state, _ = _fitted(problem, estimates, supports, model_error)
            else:
                state = polish(problem, supports, estimates, model_error, solver)
        except NotPositiveError:
            break
        found.append(state)
        estimates = state.estimates
    return found


def _best(found: Sequence[SearchState]) -> SearchState:
    if not found:
        raise CommonlawError(
            "no law was found whose trajectories stay near the measurements: these may be too noisy or too far apart "
            "for this library; try fewer terms, or choose them by derivative regression"
        )
    return min(found, key=lambda each: each.value)


def _evidence(problem: SearchProblem, estimates: Sequence[Estimate], model_error: float) -> SupportEvidence:
    """Return the evidence by the likelihood linearised about estimates, comparable between model errors."""
    pairs = zip(problem.models, estimates, strict=True)
    linear = [linearize(model, estimate, model_error) for model, estimate in pairs]
    known = np.nan_to_num(problem.known)
    problems = [each.problem.subtract(own.reshape(1, -1)) for each, own in zip(linear, known, strict=True)]
    measured = sum(problem.measured)
    # A model error is one more number to be found, at the price of any (BIC)
    price = 0.0 if model_error <= NEGLIGIBLE else float(np.log(measured))
    offset = sum(each.log_determinant for each in linear) + price
    return SupportEvidence(problems, problem.allowed, measured, problem.most_terms, offset)


def _restricted(
    problem: SearchProblem, evidence: SupportEvidence, estimates: Sequence[Estimate], supports: Bools
) -> tuple[Estimate, ...]:
    """Return the estimates with the coefficients that the linearised likelihood gives for these supports."""
    coefficients = evidence.coefficients(supports) + np.nan_to_num(problem.known)
    return tuple(replace(each, coefficients=own) for each, own in zip(estimates, coefficients, strict=True))


def _fitted(
    problem: SearchProblem, estimates: Sequence[Estimate], supports: Bools, model_error: float
) -> tuple[SearchState, SupportEvidence]:
    """Return the state fitted with these supports at a model error, with none where it is negligible; its evidence."""
    model_errors = FINAL if model_error <= NEGLIGIBLE else (model_error,)
    pairs = zip(problem.models, estimates, strict=True)
    fitted = tuple(fit(model, estimate, supports, model_errors) for model, estimate in pairs)
    evidence = _evidence(problem, fitted, model_error)
    return SearchState(supports, fitted, model_error, evidence.value(supports)), evidence
