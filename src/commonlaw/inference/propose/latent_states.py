"""A state that nobody measured, in laws that are sought: what it may do, and whether the measurements ask for it.

What it does is one of few equations, each with a scale and a start, by which it is counted: then nothing that could be
exchanged for something else is left in it. What it does to the measured states is chosen among their terms, by the
likelihood linearised about a law of few terms, which a fit begins at whose states follow from their starts. All are
hypotheses like others: the largest evidence decides, also against the law without such a state.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference.fit.annealing import polish, to_scale, with_close_neighbours
from commonlaw.inference.fit.problem import SearchProblem, prepare
from commonlaw.inference.fit.state import NO_ERROR, SearchState, promised
from commonlaw.inference.propose.forcing import UNMEASURED_STATE, with_provenance
from commonlaw.inference.score.score import Score
from commonlaw.inference.search.law_search import PATH, LawSearch, best_of
from commonlaw.law import Law, Step
from commonlaw.law.text import structure
from commonlaw.library import Terms, parse_term
from commonlaw.library.naming import quoted
from commonlaw.library.parametric import free_name
from commonlaw.outcomes import Outcome, note
from commonlaw.progress import ProgressCallback, Stage
from commonlaw.trials import Trials
from commonlaw.trials.starts import with_starts
from commonlaw.trials.trial import property_names

_NAME = "u"
"""Of the state, unless something else has it."""

_AGAIN, _ROUNDS, _GAIN = 2, 2, 0.1
"""How many hypotheses are searched again from the terms that they came to, how often, and for what gain."""

_PROMISED = 0.1
"""Twice the log-likelihood for each object that a fit may be promised elsewhere: more, where many terms are nearly
alike, says that the evidence means nothing."""

_ALIKE = 1.0
"""Twice the log-likelihood in which two laws of as many coefficients fit alike."""


@dataclass(frozen=True)
class Family:
    """What a state that nobody measured may do.

    Parameters
    ----------
    words
        What that is, with the measured state that it follows as ``{x}``.
    start
        Where trials start in it.
    found
        The term of its equation whose coefficient is to be found, of ``{u}`` and ``{x}``; nothing if there is none.
    given
        The term whose coefficient is one, by which it is counted; nothing if its start says that.
    """

    words: str
    start: float
    found: str = ""
    given: str = ""

    @property
    def is_of_state(self) -> bool:
        """Whether it follows one of the measured states."""
        return "{x}" in self.found + self.given


FAMILIES = (
    Family("decays from 1, as a depot or a drive does", 1.0, found="{u}"),
    Family("is used up from 1 by {x}, as the susceptible are by the infected", 1.0, found="{u}*{x}"),
    Family("adds up {x} from 0, as a pool does that keeps what it gets", 0.0, given="{x}"),
    Family("is filled by {x} from 0 and decays, as a compartment does", 0.0, given="{x}", found="{u}"),
)
"""Of laws that fit alike, the first is taken."""


def with_unmeasured_state(
    found: LawSearch, trials: Trials, *, most_samples: int, progress: ProgressCallback
) -> LawSearch:
    """Return the law of largest evidence with a state that nobody measured or without, with the others as its rivals.

    Parameters
    ----------
    found
        The law of first order without, and its rivals.
    trials
        What was measured, as the law follows it.
    most_samples
        See `search_supports`.
    progress
        Takes what is being done.
    """
    plain = found.among_plain
    taken = (*plain.template.terms.variables.names, *property_names(trials.properties))
    name, done = free_name(_NAME, taken), list[str]()
    hypotheses = [_Hypothesis(plain, each, state, name) for each, state in _listed(trials.schema.states)]

    def fitted(hypothesis: _Hypothesis) -> LawSearch | None:
        done.append(hypothesis.words)
        share = len(done) / (len(hypotheses) + 1)
        progress(Stage(f"trying a state that nobody measured: it {hypothesis.words}", share))
        return hypothesis.fitted(trials, most_samples)

    tried = [(each, law) for each in hypotheses if (law := fitted(each)) is not None]
    tried.sort(key=lambda pair: pair[1].state.score)
    tried[:_AGAIN] = [(each, each.again(trials, most_samples, law)) for each, law in tried[:_AGAIN]]
    tried.sort(key=lambda pair: hypotheses.index(pair[0]))
    price = 2 * float(np.log(len(hypotheses)))
    return _chosen(found, [(each, _scored(law, law.state.score.plus("multiplicity", price))) for each, law in tried])


def _scored(found: LawSearch, score: Score) -> LawSearch:
    return replace(found, state=replace(found.state, score=score))


def _chosen(found: LawSearch, laws: "Sequence[tuple[_Hypothesis, LawSearch]]") -> LawSearch:
    """Return the law of largest evidence, said to be so; of those that fit alike the first, which stands for all.

    They are one law in different words, which has the evidence of the best of them.
    """
    # Fits to what no law explains may get stuck
    found = _scored(found, found.state.score.plus("Laplace correction", promised(found.problem, found.state)))
    best = min([found, *(law for _, law in laws)], key=lambda each: each.state.score)
    alike = [pair for pair in laws if _fit_alike(pair[1], best)]
    others = [law for _, law in laws if not _fit_alike(law, best)]
    if not alike:
        more = [each.state.score - best.state.score for each in others]
        why = f"laws with one have at least {min(more):.3g} more of -2 log evidence" if more else "no law with one fits"
        step = Step(UNMEASURED_STATE, "none", why)
        return best_of([with_provenance(found, (step,), ()), *found.rivals, *others])
    (hypothesis, chosen), *same = alike
    why = f"{hypothesis.words}; without it -2 log evidence is {found.state.score - best.state.score:.3g} more"
    step = Step(UNMEASURED_STATE, _structure(chosen)[-1], why)
    chosen = _scored(chosen, best.state.score)
    outcomes = (_ambiguous(hypothesis.name, same),) if same else ()
    return best_of([with_provenance(chosen, (step,), outcomes), found, *found.rivals, *others])


def _ambiguous(name: str, same: "Sequence[tuple[_Hypothesis, LawSearch]]") -> Outcome:
    """Return what is said of laws that fit alike."""
    listed = "; or ".join(f"{'; '.join(_structure(law))}, where it {hypothesis.words}" for hypothesis, law in same)
    return note("latent-state-not-identifiable", name=name, others=listed)


def _structure(found: LawSearch) -> tuple[str, ...]:
    """Return the form of each equation, with numbers for coefficients that are known."""
    coefficients = np.array([each.coefficients for each in found.state.estimates])
    law, known = replace(found.template, coefficients=coefficients), found.problem.known[0]
    letters = [
        each.name if np.isnan(known[each.equation, each.term]) else f"{known[each.equation, each.term]:g}"
        for each in law.named_coefficients
        if law.terms.is_factor[each.term]
    ]
    return structure(law.left_hand_sides, law.terms.factors, law.support & law.terms.is_factor, letters)


def _fit_alike(one: LawSearch, other: LawSearch) -> bool:
    """Return whether laws with a state that nobody measured leave the same, with as many coefficients."""
    states = (one.problem.trials.schema.states, other.problem.trials.schema.states)
    counts = [int(each.state.supports.sum()) for each in (one, other)]
    return states[0] == states[1] and counts[0] == counts[1] and abs(_left(one) - _left(other)) < _ALIKE


def _left(found: LawSearch) -> float:
    """Return twice the negative log-likelihood of what was measured, but for a constant."""
    problem = found.problem
    measured = ~problem.trials.schema.unmeasured
    states = np.concatenate([trial.states for trial in problem.trials])[:, measured]
    scale = 2 * np.isfinite(states).sum(axis=0) @ np.log(problem.noise[measured])
    return float(scale) + sum(each.deviance for each in found.state.estimates)


def _listed(states: Sequence[str]) -> Iterator[tuple[Family, str]]:
    """Yield families with the state that each follows; those that follow none with no name."""
    for each in FAMILIES:
        for state in states if each.is_of_state else ("",):
            yield each, state


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """A law with a state of this name that nobody measured, which does what a family says, perhaps to a state.

    The law without it, as it was found, has the terms that are to choose from.
    """

    without: LawSearch
    family: Family
    followed: str
    name: str

    @property
    def words(self) -> str:
        """What it does."""
        return self.family.words.format(x=self.followed)

    def fitted(self, trials: Trials, most_samples: int) -> LawSearch | None:
        """Return the law of largest evidence, none if the state has no effect in any that can be fitted."""
        laws = [each for few in self._begins if (each := self._searched(trials, few, most_samples)) is not None]
        return min(laws, key=lambda each: each.state.score, default=None)

    def again(self, trials: Trials, most_samples: int, found: LawSearch) -> LawSearch:
        """Return the law that is found from the terms of another one: what a search begins with depends on them."""
        for _ in range(_ROUNDS):
            other = self._searched(trials, found.state.supports, most_samples)
            if other is None or not found.state.score - other.state.score > _GAIN:
                break
            found = other
        return found

    def _searched(self, trials: Trials, few: Bools, most_samples: int) -> LawSearch | None:
        """Return the law that is found from one of few terms, shape (equations, terms)."""
        trials = with_starts(trials, {self.name: self.family.start})
        with suppress(CommonlawError, np.linalg.LinAlgError):
            for _ in range(_ROUNDS):
                problem = self._prepared(trials, few, most_samples)
                problem, state = to_scale(problem, polish(problem, few, problem.starts, NO_ERROR, PATH))
                problem, state = to_scale(problem, with_close_neighbours(problem, [state])[0])
                if not self._has_effect(state):
                    break
                if np.isfinite(state.score.total) and promised(problem, state) < _PROMISED * len(state.estimates):
                    return LawSearch(self._template(trials), problem, state, None, (state,))
                few = state.supports  # Fits that got stuck on the way may not from there
        return None

    def _prepared(self, trials: Trials, few: Bools, most_samples: int) -> SearchProblem:
        """Return the problem among all terms, which begins with a fit of few, shape (equations, terms)."""
        before, known = self.without.problem, self._known
        problem = prepare(
            trials,
            self.terms,
            np.where(few, known, np.nan_to_num(known)),
            noise=np.append(before.first_noise, np.nan) if before.noise_given else None,
            huber_threshold=before.models[0].observation.huber_threshold,
            most_samples=most_samples,
            guess=np.where(few, self._guess, 0.0),
        )
        return replace(problem, known=known)

    def _template(self, trials: Trials) -> Law:
        before = self.without.template
        return Law(
            self.terms, trials.schema, 1, before.objects, np.nan_to_num(self._known), provenance=before.provenance
        )

    def _has_effect(self, state: SearchState) -> bool:
        column = self.terms.variables.index(self.name)
        ours = np.array([column in term.columns() for term in self.terms.terms])
        return bool(state.supports[:-1, ours].any())

    @cached_property
    def terms(self) -> Terms:
        """Those of the law without, and products of the state with one or none of the others."""
        before = self.without.template.terms
        variables = replace(before.variables, states=(*before.variables.states, self.name))
        texts = [term.expression(before.variables.names) for term in before.terms]
        texts += [self._own, *(f"{self._own}*{quoted(x)}" for x in before.variables.states)]
        texts += [quoted(x) for x in before.variables.states]
        return Terms(variables, tuple(dict.fromkeys(parse_term(each, variables) for each in texts)))

    @property
    def _own(self) -> str:
        return quoted(self.name)

    def _index(self, text: str) -> int:
        """Return the index of a term of a family."""
        written = text.format(u=self._own, x=quoted(self.followed))
        return self.terms.terms.index(parse_term(written, self.terms.variables))

    @cached_property
    def _known(self) -> Floats:
        """Coefficients that are known, shape (objects, equations, terms), NaN where they are to be found."""
        before = self.without.problem.known
        objects, equations, count = before.shape
        found = np.zeros((objects, equations + 1, len(self.terms)))
        found[:, :-1, :count] = before
        column = self.terms.variables.index(self.name)
        found[:, :-1, [column in term.columns() for term in self.terms.terms]] = np.nan
        if self.family.found:
            found[:, -1, self._index(self.family.found)] = np.nan
        if self.family.given:
            found[:, -1, self._index(self.family.given)] = 1.0
        return found

    @property
    def _guess(self) -> Floats:
        """Signs: the state decays."""
        found = np.zeros_like(self._known)
        found[:, -1] = -1.0
        return found

    @property
    def _begins(self) -> list[Bools]:
        """Supports to begin with, shape (equations, terms): linear ones, and that of the law without the state.

        Both with the state in them, and if it follows another one with their product.
        """
        free = np.isnan(self._known[0])
        effects = [self._index("{u}")] + ([self._index("{u}*{x}")] if self.family.is_of_state else [])
        linear = [self.terms.terms.index(parse_term(quoted(x), self.terms.variables)) for x in self._states]
        found = [np.zeros_like(free), np.zeros_like(free)]
        found[0][:-1, linear] = True
        found[1][:-1, : self.without.state.supports.shape[1]] = self.without.state.supports
        for each in found:
            each[:-1, effects] = True
            each[-1] = True
        return [each & free for each in found]

    @property
    def _states(self) -> tuple[str, ...]:
        return self.without.template.terms.variables.states
