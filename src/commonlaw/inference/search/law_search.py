"""The way from trials to a law: search supports, or fit the one that is given, choose its errors; see `finishing`, too.

Each step returns what the next one takes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.inference.fit.annealing import beside_alternatives, fit_supports, polish, search, to_scale
from commonlaw.inference.fit.covariance import fitted_law
from commonlaw.inference.fit.heteroscedasticity import with_growing_noise
from commonlaw.inference.fit.lack_of_fit import Departure, departures, in_words
from commonlaw.inference.fit.mesh import on_finer_mesh, until_resolved
from commonlaw.inference.fit.problem import SearchProblem, prepare
from commonlaw.inference.fit.state import ANY_ERROR, PLAUSIBLE, SearchState
from commonlaw.inference.fit.validity import follows_solutions, runs_away
from commonlaw.inference.score.score import Kind
from commonlaw.inference.search.error_levels import ErrorKind, kind_of, with_errors_of_kind
from commonlaw.inference.search.error_models import OF_LAWS, candidates, chosen, hypotheses, under_each_kind
from commonlaw.inference.search.input_interpolation import best_interpolation, with_interpolation
from commonlaw.inference.search.log_scale import error_kinds
from commonlaw.inference.search.setup import FitSetup
from commonlaw.inference.search.staged_search import few_of, search_by_few
from commonlaw.inference.settings import MIN_SAMPLES_PER_TERM, VERY_STRONG
from commonlaw.law import Law, Step
from commonlaw.progress import ProgressCallback, Stage, part
from commonlaw.solvers import AbstractSolver, BestSubset
from commonlaw.trials import Trials

_FINER = 4
"""Points for each sampling step up to which a law with a model error is sought again: it needs no finer mesh."""

_SEARCH, _SEARCH_OF_MANY, CHOSEN = 0.75, 0.2, 0.9
"""Shares of the time after which terms are found, if white noise is enough, and if errors are to be estimated; and
after which the law is chosen. They are only shown, while it works."""

_RIVALS = 2
"""Laws of other terms that are fitted under each kind of errors, too."""


_BY_SOLUTIONS = "largest evidence without process noise: solutions of the law with it explain whole trials less well"

PATH = BestSubset(largest=8, nodes=1)
"""Lists the candidates of an equation. They need not be proven the best: neighbours of the chosen are compared too."""


@dataclass(frozen=True, eq=False)
class LawSearch:
    """A search for a law, as far as it has come.

    Parameters
    ----------
    template
        Terms, schema, order and objects of the law that is sought, and the coefficients that are known.
    problem, state
        What was measured, and what was found so far.
    solver
        Whose path lists the candidates of each equation; None where the terms are given.
    found
        All that was found, the largest evidence first.
    rivals
        Laws of other terms that were fitted, and the search among plain ones, if terms with constants inside were
        offered; the largest evidence first.
    approximation
        Of a law with process noise: the law of largest evidence under white noise, which solutions fit best.
    is_approximation
        Whether the law was taken in place of one with process noise, as its solutions explain more.
    """

    template: Law
    problem: SearchProblem
    state: SearchState
    solver: AbstractSolver | None
    found: Sequence[SearchState]
    rivals: "tuple[LawSearch, ...]" = ()
    approximation: "LawSearch | None" = None
    is_approximation: bool = False

    @property
    def chosen_by(self) -> str:
        """What the law and its rivals were chosen by, in the words of its history."""
        kind = self.state.score.kind
        return _BY_SOLUTIONS if self.is_approximation and kind is Kind.EVIDENCE else kind

    def fitted(self) -> Law:
        """Return the law with its coefficients and their errors."""
        return fitted_law(self.template, self.problem, self.state)

    @cached_property
    def _departures(self) -> tuple[Departure, ...]:
        return departures(self.problem, self.state)

    @cached_property
    def beyond_errors(self) -> str:
        """What speaks against the errors with the law that was found, in words; nothing if nothing does."""
        return in_words(self._departures) or self.lack_of_fit

    @cached_property
    def lack_of_fit(self) -> str:
        """What speaks against the law itself, whatever its noise, in words; nothing if nothing does."""
        reason = in_words(each for each in self._departures if not each.is_of_noise)
        if not reason and runs_away(self.problem, self.state):
            reason = "trajectories of the trials that the law was learned from diverge"
        return reason

    @cached_property
    def is_determined(self) -> bool:
        """Whether no coefficient is within its error on average over objects, and no object has them all within errors.

        Evidence keeps a term for what it explains; where its coefficient is within its error nonetheless, others make
        up for it, and the likelihood has no maximum to speak of.
        """
        law = self.fitted()
        chosen = np.broadcast_to(self.state.supports, law.coefficients.shape)
        values, errors = law.coefficients[chosen], law.standard_errors[chosen]
        ratios = np.divide(values, errors, out=np.full_like(values, np.inf), where=~(errors <= 0))
        squares = np.nan_to_num(ratios.reshape(len(law.objects), -1) ** 2, posinf=np.inf)
        of_terms, of_objects = squares.mean(axis=0), squares.max(axis=1, initial=0.0)
        return not squares.size or bool(min(*of_terms, *of_objects) > 1)

    @property
    def reason_for_errors(self) -> str:
        """Why errors beside white noise are to be estimated with the law, in words; nothing if they are not."""
        if self.problem.errors and not self.beyond_errors:
            return "noise grows with the states"
        few = self.has_few_measurements and not self.problem.noise_is_fixed
        return self.beyond_errors or ("few measurements may hide how noise grows" if few else "")

    @property
    def size(self) -> int:
        """How many coefficients an object has."""
        return int(self.state.supports.sum())

    @property
    def has_few_measurements(self) -> bool:
        """Whether objects have fewer measurements for each coefficient and start than terms need.

        A law may follow these, so that what it leaves does not show their errors.
        """
        problem = self.problem
        numbers = self.size * len(problem.models) + problem.models[0].width * len(problem.trials)
        return bool(sum(problem.measured) < MIN_SAMPLES_PER_TERM * numbers)

    @property
    def among_plain(self) -> "LawSearch":
        """The search among plain terms."""
        return self if self.solver is not None else next(each for each in self.rivals if each.solver is not None)


def search_supports(
    trials: Trials,
    template: Law,
    known: Floats,
    *,
    solver: AbstractSolver,
    noise: Floats | None,
    huber_threshold: float,
    kinds: Sequence[ErrorKind],
    most_samples: int,
    progress: ProgressCallback,
) -> LawSearch:
    """Search for the supports of largest evidence on the coarsest mesh, see `explained_on_finer_mesh`.

    Parameters
    ----------
    trials
        What was measured.
    template, solver
        See `LawSearch`.
    known
        Coefficients that are known, NaN where they are to be found, shape (objects, equations, terms).
    noise
        Standard deviation of each state's measurement noise, shape (states,), if it is known.
    huber_threshold
        Standard deviations beyond which a measurement counts as an outlier, infinite for none.
    kinds
        Of errors that laws may have: noise is in proportion where that may be and differences show it.
    most_samples
        Samples that are fitted at most, see `prepare`.
    progress
        Takes what is being done.

    Raises
    ------
    CommonlawError
        If a trial is too short, a term is not finite on it, or the likelihood cannot be computed.
    """
    progress("estimating noise, smoothing")

    def prepared(most_samples: int) -> SearchProblem:
        guess, terms = template.coefficients, template.terms
        problem = prepare(
            trials, terms, known, noise=noise, huber_threshold=huber_threshold, most_samples=most_samples, guess=guess
        )
        return with_growing_noise(problem) if "proportional" in kinds else problem

    problem, rest = prepared(most_samples=most_samples), part(progress, 0.05, 1.0)
    few = few_of(problem, prepared)
    found = search_by_few(problem, few, solver, rest) if few else search(problem, solver, rest)
    return LawSearch(template, *to_scale(problem, found[0]), solver, found)


def explained_on_finer_mesh(found: LawSearch, progress: ProgressCallback) -> LawSearch:
    """Return a search on a finer mesh if its law has a model error, as a coarse mesh looks, too."""
    problem, listed = found.problem, found.found
    while listed[0].has_model_error and problem.points < _FINER:
        # The random walk is to be the same in twice as many steps
        finer = on_finer_mesh(problem, listed[0], (listed[0].model_error / np.sqrt(2),))
        if finer is None:
            break
        progress("searching again on a finer mesh")
        assert found.solver is not None
        problem, _ = finer
        listed = search(problem, found.solver, progress)
    if problem is found.problem:
        return found
    problem, state = to_scale(problem, listed[0])
    return replace(found, problem=problem, state=state, found=listed)


def fit_terms(setup: FitSetup) -> LawSearch:
    """Fit the terms of a law to what was measured, on a mesh that is fine enough.

    Raises
    ------
    CommonlawError
        If a trial is too short, a term is not finite on it, or the likelihood cannot be computed.
    """
    problem, law = setup.problem(), setup.law
    state = fit_supports(problem, problem.allowed, ANY_ERROR)
    problem, state = to_scale(*until_resolved(problem, state, lambda _, fitted: fitted))
    template = Law(law.terms, law.schema, law.order, law.objects, np.nan_to_num(setup.known))
    return LawSearch(template, problem, state, None, (state,))


def begin_search(
    begin: Callable[[Trials, ProgressCallback], LawSearch],
    trials: Trials,
    *,
    input_between: str,
    errors: ErrorKind | Literal["auto"],
    progress: ProgressCallback,
    is_chosen: bool = False,
) -> tuple[LawSearch, list[Step]]:
    """Return a search with the interpolation of inputs that is chosen, and what to say of that.

    Parameters
    ----------
    begin
        Searches supports by `search_supports`, or fits those that are given by `fit_terms`.
    trials
        What was measured, as the law follows it.
    input_between
        The interpolation of inputs between samples, ``"auto"`` for the one of largest evidence.
    errors
        Those that `choose_errors` will be asked for.
    progress
        Takes what is being done.
    is_chosen
        Whether laws of plain terms chose that of the trials: one without lack of fit is needed to choose again.

    Raises
    ------
    CommonlawError
        If the likelihood cannot be computed, or errors do not go with the trials.
    """
    error_kinds(errors, trials.schema)
    found, steps = begin(trials, part(progress, 0.0, _SEARCH)), list[Step]()
    if input_between == "auto" and trials.schema.inputs:
        progress("comparing interpolations of inputs between samples")

        def may_decide(problem: SearchProblem, state: SearchState) -> bool:
            return not (is_chosen and replace(found, problem=problem, state=state).lack_of_fit)

        steps = [best_interpolation(found.problem, found.state, may_decide)]
        if steps[0].choice != trials.schema.input_between:
            found = begin(with_interpolation(trials, steps[0].choice), progress)
    return found, steps


def choose_errors(
    found: LawSearch,
    *,
    errors: ErrorKind | Literal["auto"],
    propose: Callable[[LawSearch], Bools | None],
    progress: ProgressCallback,
) -> LawSearch:
    """Return a search with the errors that are chosen.

    Parameters
    ----------
    found
        By `begin_search`.
    errors
        Those beside white noise, ``"auto"`` for the kind of largest evidence where white noise does not explain the
        measurements.
    propose
        Returns supports that are compared too then, shape (equations, terms), if there are any.
    progress
        Takes what is being done.

    Raises
    ------
    CommonlawError
        If the likelihood cannot be computed.
    """
    reason = found.reason_for_errors if errors == "auto" else "as asked for"
    if reason:
        progress(Stage(f"{reason}: estimating errors with the law", _SEARCH_OF_MANY))
        kinds = error_kinds(errors, found.problem.trials.schema)
        if errors == "auto" and not found.lack_of_fit:
            known = kind_of(found.problem.errors) if found.problem.errors else "proportional"
            kinds = tuple(each for each in kinds if each in ("white", known))
        other = propose(found.among_plain) if found.rivals or found.solver else None
        found = with_error_models(found, other, kinds, part(progress, _SEARCH_OF_MANY, CHOSEN))
    return found


def with_error_models(
    found: LawSearch, other: Bools | None, kinds: Sequence[ErrorKind], progress: ProgressCallback
) -> LawSearch:
    """Return a search with the law of largest evidence, and errors of these kinds; its terms stay if they are given."""
    if found.rivals:
        near = [found, *found.rivals[:_RIVALS]]
        near += [] if any(each.solver for each in near) else [found.among_plain]
        return best_of([with_error_models(replace(each, rivals=()), other, kinds, progress) for each in near])
    compared = []
    if found.solver is None:
        compared = under_each_kind(found.problem, found.state.supports, kinds)
    elif hypothesized := hypotheses(found.problem, found.state, kinds, found.solver, part(progress, 0.0, 0.5)):
        others = [each.supports for each in found.found] + ([] if other is None else [other & found.problem.allowed])
        progress(Stage("comparing laws under each kind of errors", 0.5))
        compared = candidates(hypothesized, others, found.solver)
        if compared:
            progress("comparing errors of the law that is chosen")
            compared += under_each_kind(found.problem, chosen(compared).state.supports, kinds)
    if not compared:
        return found
    best = chosen(compared, VERY_STRONG if found.solver is None else 0.0)  # Given terms are fitted by least squares
    problem, state = best.problem, best.state
    if best.kind != "white":  # Levels about the law itself, to the last digits: units and origins do not show
        problem, state = with_errors_of_kind(problem, state, best.kind)
    alike = {kind: [each.state for each in compared if each.kind == kind] for kind in kinds}
    plain, approximation = [each for each in compared if each.kind == "white" and best.kind in OF_LAWS], None
    if plain:
        exact = chosen(plain)
        white = exact.state.with_alternatives(alike["white"])
        approximation = replace(found, problem=exact.problem, state=white)
    state = state.with_alternatives(alike[best.kind])
    return replace(found, problem=problem, state=state, approximation=approximation)


def best_of(listed: Sequence[LawSearch]) -> LawSearch:
    """Return the search whose law has the largest evidence, with the others as its rivals.

    Laws that are too fast for their steps, of those as likely as this, come last.
    """
    ordered = sorted((replace(each, rivals=()) for each in listed), key=lambda each: each.state.score)
    first, last = list[LawSearch](), list[LawSearch]()
    for each in ordered:
        near = not first or each.state.score - first[0].state.score < PLAUSIBLE
        (last if near and not follows_solutions(each.problem, each.state) else first).append(each)
    best, *others = [*first, *last]
    return replace(best, rivals=tuple(others))


def resolved(found: LawSearch, progress: ProgressCallback) -> LawSearch:
    """Return a search on a mesh that is fine enough, its terms chosen again there, beside all that is plausible."""

    def again(problem: SearchProblem, state: SearchState) -> SearchState:
        if found.solver is None:
            return state
        progress("choosing terms again on a finer mesh")
        return polish(problem, state.supports, state.estimates, state.model_error, found.solver).keeping(state)

    problem, state, done = found.problem, found.state, set[bytes]()
    while True:
        problem, state = to_scale(*until_resolved(problem, state, again))
        if found.solver is None:
            return replace(found, problem=problem, state=state)
        done.add(state.supports.tobytes())
        best = beside_alternatives(problem, state)
        if best.supports.tobytes() in done:  # Each of two may be the better one under the noise that the other leaves
            return replace(found, problem=problem, state=best)
        progress("fitting what is more plausible")
        state = best
