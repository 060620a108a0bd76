"""The search for the supports of a law, from many terms to few, while the trajectories become solutions of it.

At each model error the likelihood is linearised about the trajectories and coefficients so far, the supports of largest
evidence are chosen on it, and both are fitted again. Supports and model errors are compared by their evidence: where
the measurements follow a law of the library, the smallest model error wins; where they do not, one wins that is not
negligible, a random walk that pushes the states off their course (weak constraint; Evensen 2009, chapter 7).
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.errors import CommonlawError
from commonlaw.inference.fit.initial_condition_prior import AlikeStarts
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.state import (
    MODEL_ERRORS,
    MOST,
    NO_ERROR,
    PLAUSIBLE,
    SearchState,
    errors_to_fit,
    evidence_about,
    fitted,
    is_settled,
    linearized_evidence,
    list_by_evidence,
    promised_near,
    restricted,
)
from commonlaw.likelihood import Estimate, NotPositiveError, threads_pay
from commonlaw.parallel import in_parallel
from commonlaw.progress import ProgressCallback, Stage
from commonlaw.solvers import AbstractSolver
from commonlaw.wording import counted

SCHEDULES = ((3.0, 1.0, 0.3, 0.1, NO_ERROR), (0.3, NO_ERROR), (0.1, NO_ERROR))
"""Model errors, relative to the noise, at which supports are chosen. Different ways find different supports; the best
is kept."""

_ROUNDS = 6
"""How often supports are chosen and fitted at one model error at the end, and how often noise is enlarged."""

STRONG = 6.0
"""2 log B from which evidence is strong (Kass and Raftery 1995)."""

LEFT_BY_LAW = "by what the law leaves of the measurements"
"""Why the noise is what it is."""

_CLOSE = 1.001
"""By how much noise changes at least."""


def search(
    problem: SearchProblem, solver: AbstractSolver, progress: ProgressCallback, proposals: Sequence[Bools] = ()
) -> list[SearchState]:
    """Return what all schedules find, proposals, and what may be as plausible, that of largest evidence first."""
    found = annealed(problem, solver, progress)
    found += _fit_all(problem, proposals)
    found += _without_model_error(problem, list_by_evidence(found)[0])
    return with_close_neighbours(problem, found)


def annealed(
    problem: SearchProblem,
    solver: AbstractSolver,
    progress: ProgressCallback,
    schedules: Sequence[Sequence[float]] = SCHEDULES,
) -> list[SearchState]:
    """Return what was found at all model errors of all schedules."""

    def tell(done: int) -> None:
        of = counted(len(schedules), "search", "es")
        progress(Stage(f"choosing terms, {done} of {of} done", done / (len(schedules) + 1)))

    tell(0)
    ways = in_parallel(
        lambda each: _anneal(problem, solver, each), schedules, pays=threads_pay(problem.models), done=tell
    )
    return [state for each in ways for state in each]


def polish(
    problem: SearchProblem, supports: Bools, estimates: Sequence[Estimate], model_error: float, solver: AbstractSolver
) -> SearchState:
    """Choose and fit at one model error until nothing gets better."""
    best: SearchState | None = None
    for _ in range(_ROUNDS):
        state, evidence = fitted(problem, estimates, supports, model_error)
        if best is not None and not state.score < best.score:
            break
        best = state
        chosen = evidence.choose(supports, solver)
        if np.array_equal(chosen, supports):
            break
        supports, estimates = chosen, restricted(problem, evidence, state.estimates, chosen)
    assert best is not None
    return best


def fit_supports(problem: SearchProblem, supports: Bools, model_errors: Sequence[float] = MODEL_ERRORS) -> SearchState:
    """Return the estimates with these supports, shape (equations, terms), and with the model error of largest evidence.

    Model errors that are compared are relative to the noise, from large to small. Where terms are much alike, large
    ones leave coefficients undetermined, and lead away; so the smallest is also begun with, from the smoothed
    measurements. Where states were not measured, large ones lead from one set of coefficients to another that fits as
    well, and the smallest is begun with only from where the search begins.

    Raises
    ------
    CommonlawError
        If the likelihood cannot be computed.
    """
    *larger, smallest = model_errors
    ways = dict.fromkeys(((tuple(larger) if problem.trials.schema.starts else (*larger, smallest)), (smallest,)))
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
        are near enough, whichever fits better; see `fit_supports` for states that were not measured.

    Raises
    ------
    NotPositiveError
        If the likelihood cannot be computed there.
    """
    if start is None and problem.trials.schema.starts:
        start = problem.starts
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


def fit_solutions(problem: SearchProblem, supports: Bools) -> tuple[SearchProblem, SearchState]:
    """Return the estimates with these supports and no model error, see `fit_with`, and the noise that this takes."""
    return to_scale(problem, fit_with(problem, supports, NO_ERROR))


def to_scale(problem: SearchProblem, state: SearchState) -> tuple[SearchProblem, SearchState]:
    """Return a problem with white noise of the size that a state leaves, and the state fitted to it.

    Step by step, as less of what is left goes with outliers then. Noise that was given stays, and none is below that
    which laws are fitted under at least. Levels of other errors were found at their size.

    Raises
    ------
    NotPositiveError
        If the likelihood cannot be computed.
    """
    if problem.noise_is_fixed or problem.errors or state.has_model_error:
        return problem, state
    evidence = evidence_about(problem, state)
    for _ in range(_ROUNDS):
        factor = float(np.sqrt(max(evidence.noise_variance(state.supports), problem.least_variance)))
        if 1 / _CLOSE <= factor <= _CLOSE or not 0 < factor < np.inf:
            break
        problem, before = problem.noisier(factor, LEFT_BY_LAW), state
        state, evidence = fitted(problem, state.estimates, state.supports, state.model_error)
        state = state.keeping(before)
    return problem, state


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


def with_close_neighbours(
    problem: SearchProblem, states: Sequence[SearchState], starts: AlikeStarts | None = None
) -> list[SearchState]:
    """Return states, and what may be as plausible as the best, fitted; the best comes first, with the others.

    Starts that are alike count where they are given; the values of the states have their prices.
    Evidence linearised about one law errs for others. So supports are fitted one after the other whose evidence, about
    any law that was fitted and is plausible, comes near to the best, the most promising first: until none is left, or
    so many as are carried along at most were fitted in vain.
    """
    found = list_by_evidence(states)
    done = {each.supports.tobytes() for each in found if each.model_error == found[0].model_error}
    seen, promising, vain = set[bytes](), dict[bytes, tuple[float, SearchState, Bools]](), 0
    while vain < MOST:
        best = found[0]
        most = best.score.total + PLAUSIBLE
        for near in (each for each in found if each.model_error == best.model_error and each.score.total < most):
            if (key := near.supports.tobytes()) not in seen:
                seen.add(key)
                more = starts.near(near) if starts else lambda _: 0.0
                for promise, supports in promised_near(problem, near):
                    value = promise + more(supports)
                    known = promising.get(own := supports.tobytes())
                    promising[own] = (value, near, supports) if known is None or value < known[0] else known
        left = [each for key, each in promising.items() if key not in done and each[0] < most]
        if not left:
            break
        _, near, supports = min(left, key=lambda each: each[0])
        done.add(supports.tobytes())
        found = list_by_evidence([*found, *_comparable(problem, near, supports, best.model_error, starts)])
        vain = vain + 1 if found[0] is best else 0
    best = found[0]
    return [best.with_alternatives([each for each in found if each.model_error == best.model_error]), *found[1:]]


def _comparable(
    problem: SearchProblem, near: SearchState, supports: Bools, model_error: float, starts: AlikeStarts | None
) -> list[SearchState]:
    """Return supports fitted from a state that is near, to be compared with others; nothing if that means nothing.

    Of supports that leave far more than the noise all would count as outliers, which cost too little; so no evidence is
    larger than under noise of the size that they leave.
    """
    try:
        start = near.estimates
        if not np.array_equal(supports, near.supports):
            start = restricted(problem, evidence_about(problem, near), start, supports)
        state = fitted(problem, start, supports, model_error)[0]
        own = to_scale(problem, state)[1]
    except NotPositiveError:
        return []
    if not is_settled(problem, state):
        return []
    score = own.score if state.score < own.score else state.score
    return [replace(state, score=score.plus("initial conditions", starts.price(state)) if starts else score)]


def beside_alternatives(problem: SearchProblem, state: SearchState) -> SearchState:
    """Return the best of a state and its alternatives, fitted to a problem, and of what else may be as plausible."""
    here = evidence_about(problem, state).score(state.supports)
    states, starts = [replace(state, score=here)], AlikeStarts(problem, state)
    for each in state.alternatives:
        if each.score - state.score < PLAUSIBLE:
            states += _comparable(problem, each, each.supports, state.model_error, starts)
    best = with_close_neighbours(problem, states, starts)[0]
    return state.keeping(best) if np.array_equal(best.supports, state.supports) else best


def beside_those_ahead(problem: SearchProblem, state: SearchState) -> SearchState:
    """Return the best of a state and the supports next to it that have more evidence as linearised about it, fitted.

    At most as many are fitted as laws are carried along.
    """
    starts, done = AlikeStarts(problem, state), {each.supports.tobytes() for each in (state, *state.alternatives)}
    for _ in range(MOST):
        ahead = [
            (promise, supports)
            for promise, supports in promised_near(problem, state)
            if promise < state.score.total and supports.tobytes() not in done
        ]
        if not ahead:
            break
        _, supports = min(ahead, key=lambda each: each[0])
        done.add(supports.tobytes())
        for other in _comparable(problem, state, supports, state.model_error, starts):
            best, rest = (other, state) if other.score < state.score else (state, other)
            state = best.with_alternatives([*state.alternatives, rest])
    return state


def _anneal(problem: SearchProblem, how: AbstractSolver | Bools, model_errors: Sequence[float]) -> list[SearchState]:
    """Choose, or take given supports, and fit at one model error after the other; return what could be computed."""
    supports: Bools = problem.allowed
    estimates: tuple[Estimate, ...] = problem.starts
    found: list[SearchState] = []
    for model_error in model_errors:
        try:
            evidence = linearized_evidence(problem, estimates, errors_to_fit(model_error)[0])
            chosen = evidence.choose(supports, how) if isinstance(how, AbstractSolver) else how
            if chosen is how or not np.array_equal(chosen, supports):
                supports, estimates = chosen, restricted(problem, evidence, estimates, chosen)
            if isinstance(how, AbstractSolver) and not model_error:
                state = polish(problem, supports, estimates, model_error, how)
            else:
                state, _ = fitted(problem, estimates, supports, model_error)
        except NotPositiveError:
            break
        found.append(state)
        estimates = state.estimates
    return found
