"""The search for the supports of a law, from many terms to few, while the trajectories become solutions of it.

At each model error the likelihood is linearised about the trajectories and coefficients so far, the supports of largest
evidence are chosen on it, and both are fitted again. Supports and model errors are compared by their evidence: where
the measurements follow a law of the library, the smallest model error wins; where they do not, one wins that is not
negligible, a random walk that pushes the states off their course (weak constraint; Evensen 2009, chapter 7).
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.errors import CommonlawError
from commonlaw.inference.first_noise import noise_floor
from commonlaw.inference.search_problem import SearchProblem
from commonlaw.inference.support_search import ComparedSupport, SupportEvidence
from commonlaw.likelihood import Estimate, Linearization, NotPositiveError, TrajectoryModel, fit_each, linearize_each
from commonlaw.parallel import in_parallel
from commonlaw.progress import ProgressCallback, Stage
from commonlaw.solvers import AbstractSolver
from commonlaw.wording import counted

NO_ERROR = 0.0
"""The model error of laws whose solutions the trajectories are."""

SCHEDULES = ((3.0, 1.0, 0.3, 0.1, NO_ERROR), (0.3, NO_ERROR), (0.1, NO_ERROR))
"""Model errors, relative to the noise, at which supports are chosen. Different ways find different supports; the best
is kept."""

MODEL_ERRORS = (10.0, 3.0, 1.0, 0.3, 0.1)
"""Model errors that are compared where the measurements follow no law."""

ANY_ERROR = (*MODEL_ERRORS, NO_ERROR)
"""Those, and none."""

FINAL = (0.03, 0.003, 0.0003)
"""Model errors down to which laws without one are fitted. The last times the number of samples of a trial should be
below one: what is allowed in each step adds up, and coefficients would be less accurate than the data allow."""

_ROUNDS = 6
"""How often supports are chosen and fitted at one model error at the end, and how often noise is enlarged."""
STRONG = 6.0
"""2 log B from which evidence is strong (Kass and Raftery 1995)."""

LEFT_BY_LAW = "by what the law leaves of the measurements"
"""Why the noise is what it is."""

_CLOSE = 1.001
"""By how much noise changes at least."""


@dataclass(frozen=True, eq=False)
class SearchState:
    """Supports, shape (equations, terms), and the estimates of all objects with them.

    The model error is its standard deviation in each step, relative to the noise; the value is minus twice the
    log-evidence, but for a constant. 2 log B is kept with all supports that were fitted under the same errors.
    """

    supports: Bools
    estimates: tuple[Estimate, ...]
    model_error: float
    value: float
    fitted: tuple[tuple[float, Bools], ...] = ()

    def with_alternatives(self, others: Sequence["SearchState"]) -> "SearchState":
        """Return the state with the evidence of others, which were fitted under the same errors, against its own."""
        listed = {each.supports.tobytes(): each for each in sorted(others, key=lambda each: -each.value)}
        return replace(self, fitted=tuple((each.value - self.value, each.supports) for each in listed.values()))

    @property
    def has_model_error(self) -> bool:
        """Whether the measurements depart from the law by more than their noise."""
        return self.model_error > NO_ERROR

    @property
    def fitted_model_error(self) -> float:
        """The model error at which the estimates were fitted."""
        return errors_to_fit(self.model_error)[-1]


def errors_to_fit(model_error: float) -> tuple[float, ...]:
    """Return the model errors that are fitted with one after the other, to come to one; none is approached."""
    return (model_error,) if model_error else FINAL


def search(
    problem: SearchProblem,
    solver: AbstractSolver,
    progress: ProgressCallback,
    schedules: Sequence[Sequence[float]] = SCHEDULES,
    proposals: Sequence[Bools] = (),
) -> list[SearchState]:
    """Return what was found at all model errors of all schedules, and proposals, that of largest evidence first."""

    def tell(done: int) -> None:
        of = counted(len(schedules), "search", "es")
        progress(Stage(f"choosing terms, {done} of {of} done", done / (len(schedules) + 1)))

    tell(0)
    ways = in_parallel(lambda each: _anneal(problem, solver, each), schedules, done=tell)
    found = [state for each in ways for state in each]
    if schedules is not SCHEDULES:
        return list_by_evidence(found)
    found += _fit_all(problem, proposals)
    found += _without_model_error(problem, list_by_evidence(found)[0])
    return with_close_neighbours(problem, found)


def polish(
    problem: SearchProblem, supports: Bools, estimates: Sequence[Estimate], model_error: float, solver: AbstractSolver
) -> SearchState:
    """Choose and fit at one model error until nothing gets better."""
    best: SearchState | None = None
    for _ in range(_ROUNDS):
        state, evidence = fitted(problem, estimates, supports, model_error)
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
    """Return the estimates with these supports, shape (equations, terms), and with the model error of largest evidence.

    Model errors that are compared are relative to the noise, from large to small. Where terms are much alike, large
    ones leave coefficients undetermined, and lead away; so the smallest is also begun with, from the smoothed
    measurements.

    Raises
    ------
    CommonlawError
        If the likelihood cannot be computed.
    """
    *larger, smallest = model_errors
    ways = dict.fromkeys(((*larger, smallest), (smallest,)))
    found = [state for way in ways for state in _anneal(problem, supports, way)]
    last = [state for state in found if state.model_error == smallest]
    others = [state for state in found if state.model_error != smallest]
    return list_by_evidence([*others, *sorted(last, key=_objective)[:1]])[0]


def fit_with(
    problem: SearchProblem, supports: Bools, model_error: float, start: Sequence[Estimate] | None = None
) -> SearchState:
    """Return the estimates with these supports at one model error.

    Parameters
    ----------
    problem, supports, model_error
        See `fit_supports`.
    start
        Estimates that are near; without them larger model errors lead there from the smoothed measurements, or these
        are near enough, whichever fits better.

    Raises
    ------
    NotPositiveError
        If the likelihood cannot be computed there.
    """
    if start is not None:
        return fitted(problem, start, supports, model_error)[0]
    larger = [each for each in MODEL_ERRORS if each > model_error]
    ways = dict.fromkeys(((*larger, model_error), (model_error,)))
    found = [state for way in ways for state in _anneal(problem, supports, way) if state.model_error == model_error]
    if not found:
        raise NotPositiveError
    return min(found, key=_objective)


def _objective(state: SearchState) -> float:
    """Return minus twice the log-likelihood at estimates, which compares those with the same supports and errors."""
    return sum(each.objective for each in state.estimates)


def fit_solutions(
    problem: SearchProblem, supports: Bools, start: Sequence[Estimate] | None = None
) -> tuple[SearchProblem, SearchState]:
    """Return the estimates with these supports and no model error, see `fit_with`, and the noise that this takes."""
    return to_scale(problem, fit_with(problem, supports, NO_ERROR, start))


def to_scale(problem: SearchProblem, state: SearchState) -> tuple[SearchProblem, SearchState]:
    """Return a problem with white noise of the size that a state leaves, and the state fitted to it.

    Step by step, as less of what is left goes with outliers then. Noise that was given stays, and none is below what
    the digits of the measurements tell. Levels of other errors were found at their size.

    Raises
    ------
    NotPositiveError
        If the likelihood cannot be computed.
    """
    if problem.noise_is_fixed or problem.errors or state.has_model_error:
        return problem, state
    least = noise_floor(problem.trials)
    for _ in range(_ROUNDS):
        left = float(np.sqrt(evidence_about(problem, state).noise_variance(state.supports)))
        factor = max(left, float(np.max(least / problem.noise)))
        if 1 / _CLOSE <= factor <= _CLOSE or not 0 < factor < np.inf:
            break
        problem = problem.noisier(factor, LEFT_BY_LAW)
        state, _ = fitted(problem, state.estimates, state.supports, state.model_error)
    return problem, state


def nearest(problem: SearchProblem, state: SearchState, count: int = 4, below: float = np.inf) -> list[Bools]:
    """Return the supports of largest evidence next to those found: so many for each equation, of less 2 log B."""
    pairs = enumerate(neighbours(problem, state))
    here = np.eye(len(state.supports), dtype=bool)[:, :, np.newaxis]
    return [
        np.where(here[j], each.support, state.supports)
        for j, listed in pairs
        for each in listed[:count]
        if each.twice_log_bayes_factor < below
    ]


def path(problem: SearchProblem, state: SearchState, solver: AbstractSolver) -> Iterator[Bools]:
    """Yield the supports from no term to many that a solver lists for each equation, the others being as found."""
    evidence = evidence_about(problem, state)
    for j in range(len(state.supports)):
        for own in evidence.path(state.supports, j, solver):
            changed = state.supports.copy()
            changed[j] = own
            yield changed


def neighbours(problem: SearchProblem, state: SearchState) -> list[list[ComparedSupport]]:
    """Return the supports next to those found, equation by equation, see `SupportEvidence.neighbours`."""
    return evidence_about(problem, state).neighbours(state.supports, state.fitted)


def fit_neighbour(problem: SearchProblem, state: SearchState, supports: Bools) -> SearchState:
    """Return other supports fitted under the errors of a state, from the coefficients that are linear about it.

    Raises
    ------
    NotPositiveError
        If the likelihood cannot be computed.
    """
    evidence = _evidence(problem, state.estimates, state.model_error)
    start = _restricted(problem, evidence, state.estimates, supports)
    return fitted(problem, start, supports, state.model_error)[0]


def _fit_all(problem: SearchProblem, listed: Sequence[Bools]) -> list[SearchState]:
    """Return supports fitted to all objects, each once; those that cannot be fitted are left out."""
    found = []
    for supports in {each.tobytes(): each for each in listed}.values():
        with suppress(CommonlawError):
            found.append(fit_supports(problem, supports, SCHEDULES[-1]))
    return found


def _without_model_error(problem: SearchProblem, best: SearchState) -> list[SearchState]:
    """Return the supports that are best with a model error as they are without: no schedule may have come by there."""
    if best.has_model_error:
        with suppress(NotPositiveError):
            return [fitted(problem, best.estimates, best.supports, NO_ERROR)[0]]
    return []


def with_close_neighbours(problem: SearchProblem, states: Sequence[SearchState]) -> list[SearchState]:
    """Return states, and what is hardly less probable than the best, fitted until the best stays, which comes first.

    Evidence linearised about one law errs; the best keeps that of all others under its errors.
    """
    found = list_by_evidence(states)
    done = {each.supports.tobytes() for each in found if each.model_error == found[0].model_error}
    while True:
        best = found[0]
        close = [each for each in nearest(problem, best, below=STRONG) if each.tobytes() not in done]
        if not close:
            alike = [each for each in found[1:] if each.model_error == best.model_error]
            return [best.with_alternatives(alike), *found[1:]]
        evidence = evidence_about(problem, best)
        for supports in close:
            done.add(supports.tobytes())
            with suppress(NotPositiveError):
                estimates = _restricted(problem, evidence, best.estimates, supports)
                found.append(fitted(problem, estimates, supports, best.model_error)[0])
        found = list_by_evidence(found)


def _anneal(problem: SearchProblem, how: AbstractSolver | Bools, model_errors: Sequence[float]) -> list[SearchState]:
    """Choose, or take given supports, and fit at one model error after the other; return what could be computed."""
    supports: Bools = problem.allowed
    estimates: tuple[Estimate, ...] = problem.starts
    found: list[SearchState] = []
    for model_error in model_errors:
        try:
            evidence = _evidence(problem, estimates, errors_to_fit(model_error)[0])
            chosen = evidence.choose(supports, how) if isinstance(how, AbstractSolver) else how
            if chosen is how or not np.array_equal(chosen, supports):
                supports, estimates = chosen, _restricted(problem, evidence, estimates, chosen)
            if isinstance(how, AbstractSolver) and not model_error:
                state = polish(problem, supports, estimates, model_error, how)
            else:
                state, _ = fitted(problem, estimates, supports, model_error)
        except NotPositiveError:
            break
        found.append(state)
        estimates = state.estimates
    return found


def list_by_evidence(found: Sequence[SearchState]) -> list[SearchState]:
    """Return what was found, the largest evidence first; nothing found is an error."""
    if not found:
        raise CommonlawError(
            "no law was found whose trajectories stay near the measurements: these may be too noisy or too far apart "
            "for this library; try fewer terms, or choose them by derivative regression"
        )
    return sorted(found, key=lambda each: each.value)


def evidence_of(problem: SearchProblem, state: SearchState, listed: Sequence[Bools]) -> list[float]:
    """Return minus twice the log-evidence of supports, by the likelihood linearised about a state."""
    evidence = evidence_about(problem, state)
    return [evidence.value(each) for each in listed]


def evidence_about(problem: SearchProblem, state: SearchState) -> SupportEvidence:
    """Return the evidence by the likelihood linearised about a state, at the model error that it was fitted with."""
    return _evidence(problem, state.estimates, state.fitted_model_error)


def _evidence(problem: SearchProblem, estimates: Sequence[Estimate], model_error: float) -> SupportEvidence:
    """Return the evidence by the likelihood linearised about estimates, comparable between model errors."""
    linear = linearize_each(problem.models, estimates, model_error)
    known = np.nan_to_num(problem.known)
    problems = [each.problem.subtract(own.reshape(1, -1)) for each, own in zip(linear, known, strict=True)]
    extra = offset(problem, linear, model_error)
    counted = problem.counted.with_outliers(
        *np.sum([_of_outliers(*pair) for pair in zip(problem.models, estimates, strict=True)], axis=0)
    )
    return SupportEvidence(problems, problem.allowed, counted, problem.prices, problem.most_terms, extra)


def _of_outliers(model: TrajectoryModel, estimate: Estimate) -> tuple[float, int]:
    """Return what outliers add to the sum of squares, and how many there are."""
    sizes, bound = [], model.observation.huber_threshold
    for mesh, states, _ in model.parts(estimate):
        own = np.abs(model.residuals(mesh, states) / (model.observation.noise * mesh.scale))
        sizes.append(own[own > bound])
    far = np.concatenate(sizes)
    return float(bound * far.sum()) if len(far) else 0.0, len(far)


def offset(problem: SearchProblem, linear: Sequence[Linearization], model_error: float) -> float:
    """Return what is added to minus twice the log-evidence of all supports, for its errors.

    A model error is one more number to be found, at the price of any (BIC), and so is every level of other errors; the
    noise has a prior.
    """
    numbers = int(model_error > FINAL[0]) + problem.errors.hyperparameters
    price = numbers * float(np.log(sum(problem.measured))) + problem.noise_deviance()
    return sum(each.log_determinant for each in linear) + price


def _restricted(
    problem: SearchProblem, evidence: SupportEvidence, estimates: Sequence[Estimate], supports: Bools
) -> tuple[Estimate, ...]:
    """Return the estimates with the coefficients that the linearised likelihood gives for these supports.

    Constants inside of terms, in which it is not linear, stay.
    """
    factors = problem.models[0].terms.is_factor
    held = np.array([np.where(supports & ~factors, each.coefficients, 0.0) for each in estimates])
    coefficients = evidence.coefficients(supports & factors, held) + np.nan_to_num(problem.known)
    return tuple(replace(each, coefficients=own) for each, own in zip(estimates, coefficients, strict=True))


def fitted(
    problem: SearchProblem, estimates: Sequence[Estimate], supports: Bools, model_error: float
) -> tuple[SearchState, SupportEvidence]:
    """Return the state fitted with these supports at a model error, with none where it is negligible; its evidence."""
    model_errors = errors_to_fit(model_error)
    done = fit_each(problem.models, estimates, supports, model_errors)
    evidence = _evidence(problem, done, model_errors[-1])
    return SearchState(supports, done, model_error, evidence.value(supports)), evidence
