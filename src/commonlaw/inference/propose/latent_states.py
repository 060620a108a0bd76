"""A latent state, or forcing, in laws that are sought: what it may do, and whether the measurements ask for it.

What it does is one of few equations, each with a scale and a start, by which it is counted: then nothing that could be
exchanged for something else is left in it. What it does to the measured states is chosen among their terms, by the
likelihood linearised about a law of few terms, which a fit begins at whose states follow from their starts. All are
hypotheses like others: the largest evidence decides, also against the law without such a state.

Laws of second order may be forced by functions of time whose parameters are found. They are the solutions of the
equations that such a forcing would have as a state, and so need none.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import refine_support, rescale_noise, with_close_neighbours
from commonlaw.inference.fit.fit import NO_ERROR, Fit, Status
from commonlaw.inference.fit.problem import SearchProblem, prepare
from commonlaw.inference.search.law_search import PATH
from commonlaw.inference.search.pool import Pool
from commonlaw.law import Step
from commonlaw.law.parameters import left_hand_sides, named_parameters
from commonlaw.law.text import structure
from commonlaw.library import ParametricTerm, Terms, Variables, parse_term
from commonlaw.library.notation import quoted
from commonlaw.library.parametric import free_name, parametric_term, terms_of_family
from commonlaw.outcomes import note
from commonlaw.runtime.progress import ProgressCallback, Stage
from commonlaw.trials import Trials
from commonlaw.trials.transformations import with_starts
from commonlaw.trials.trial import property_names


@dataclass(frozen=True)
class Family:
    """What a latent state may do.

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
"""Of laws that fit equally well, the first is taken."""


def with_latent_state(pool: Pool, trials: Trials, *, most_samples: int, progress: ProgressCallback) -> Pool:
    """Return a pool of laws of first order with laws that have a latent state, too."""
    plain = pool.plain
    assert plain is not None
    taken = (*plain.problem.terms.variables.names, *property_names(trials.properties))
    name, done = free_name("u", taken), list[str]()
    followed = [(each, state) for each in FAMILIES for state in (trials.schema.states if each.is_of_state else ("",))]
    models = [_LatentStateModel(plain, each, state, name) for each, state in followed]

    def fitted(model: _LatentStateModel) -> Fit:
        done.append(model.words)
        share = len(done) / (len(models) + 1)
        progress(Stage(f"trying a latent state that {model.words}", share))
        return model.fitted(trials, most_samples)

    tried = [(each, fit) for each in models if (fit := fitted(each)).is_usable]
    tried.sort(key=lambda pair: pair[1])
    tried[: settings.MAX_RIVALS] = [
        (each, each.again(trials, most_samples, fit)) for each, fit in tried[: settings.MAX_RIVALS]
    ]
    tried.sort(key=lambda pair: models.index(pair[0]))
    multiplicity = 2 * float(np.log(len(models)))
    fits = [(each, fit.with_score(fit.score.plus("multiplicity", multiplicity))) for each, fit in tried]
    return _compared(pool, fits)


def _compared(pool: Pool, fits: "Sequence[tuple[_LatentStateModel, Fit]]") -> Pool:
    """Return a pool with fits of a latent state; of those that fit equally well the first, which stands for all.

    They are one law in different words, which has the evidence of the best of them.
    """
    # Fits to what no law explains may get stuck, and their evidence is then too large
    without = pool.best.with_score(pool.best.score.plus("Laplace correction", pool.best.predicted_decrease))
    best = min([without, *(fit for _, fit in fits)])
    alike = [pair for pair in fits if _fit_alike(pair[1], best)]
    others = [fit for _, fit in fits if not _fit_alike(fit, best)]
    if not alike:
        more = [each.score - best.score for each in others]
        why = f"laws with one have at least {min(more):.3g} more of -2 log evidence" if more else "no law with one fits"
        step = Step(UNMEASURED_STATE, "none", why)
        return pool.with_best(replace(without, steps=(step,))).joined(others)
    (model, chosen), *same = alike
    why = f"{model.words}; without it -2 log evidence is {without.score - best.score:.3g} more"
    alternatives = "; or ".join(f"{'; '.join(_structure(fit))}, in which it {each.words}" for each, fit in same)
    chosen = replace(
        chosen.with_score(best.score),
        steps=(Step(UNMEASURED_STATE, _structure(chosen)[-1], why),),
        outcomes=(note("latent-state-not-identifiable", name=model.name, others=alternatives),) if same else (),
    )
    return pool.with_best(without).joined([chosen, *others])


def _structure(fit: Fit) -> tuple[str, ...]:
    """Return the form of each equation, with numbers for coefficients that are known."""
    coefficients = np.array([each.coefficients for each in fit.estimates])
    law, known = replace(fit.problem.law, coefficients=coefficients), fit.problem.known[0]
    letters = [
        each.name if np.isnan(known[each.equation, each.term]) else f"{known[each.equation, each.term]:g}"
        for each in named_parameters(law).definitions
        if law.terms.is_factor[each.term]
    ]
    return structure(left_hand_sides(law), law.terms.factors, law.support & law.terms.is_factor, letters)


def _fit_alike(one: Fit, other: Fit) -> bool:
    """Return whether laws with a latent state leave the same, with as many coefficients."""
    states = (one.problem.trials.schema.states, other.problem.trials.schema.states)
    return (
        states[0] == states[1]
        and one.size == other.size
        and abs(_deviance(one) - _deviance(other)) < settings.MAX_MESH_CHANGE
    )


def _deviance(fit: Fit) -> float:
    """Return twice the negative log-likelihood of what was measured, but for a constant."""
    problem = fit.problem
    measured = ~problem.trials.schema.unmeasured
    states = np.concatenate([trial.states for trial in problem.trials])[:, measured]
    scale = 2 * np.isfinite(states).sum(axis=0) @ np.log(problem.noise[measured])
    return float(scale) + sum(each.deviance for each in fit.estimates)


@dataclass(frozen=True, eq=False)
class _LatentStateModel:
    """A law with a latent state of this name, which does what a family says, perhaps to a state.

    The law without it, as it was found, has the terms that are to choose from.
    """

    without: Fit
    family: Family
    followed: str
    name: str

    @property
    def words(self) -> str:
        """What it does."""
        return self.family.words.format(x=self.followed)

    def fitted(self, trials: Trials, most_samples: int) -> Fit:
        """Return the law of largest evidence."""
        return min(self._searched(trials, few, most_samples) for few in self._begins)

    def again(self, trials: Trials, most_samples: int, fit: Fit) -> Fit:
        """Return the law that is found from the terms of another one: what a search begins with depends on them."""
        for _ in range(settings.ALTERNATIONS):
            other = self._searched(trials, fit.supports, most_samples)
            if not fit.score - other.score > settings.MIN_GAIN:
                break
            fit = other
        return fit

    def _searched(self, trials: Trials, few: Bools, most_samples: int) -> Fit:
        """Return the law that is found from one of few terms, shape (equations, terms)."""
        trials, fit = with_starts(trials, {self.name: self.family.start}), self.without
        try:
            for _ in range(settings.ALTERNATIONS):
                problem = self._prepared(trials, few, most_samples)
                fit = rescale_noise(refine_support(problem, few, problem.starts, NO_ERROR))
                fit = rescale_noise(with_close_neighbours([fit])[0])
                if not fit.is_usable or not fit.supports[:-1, self._has_state].any():
                    return fit.but(Status.WITHOUT_EFFECT)
                if np.isfinite(fit.score.total) and fit.predicted_decrease < settings.MIN_GAIN * len(fit.estimates):
                    return replace(fit, problem=replace(fit.problem, solver=None), alternatives=())
                few = fit.supports  # Fits that got stuck on the way may not from there
        except (CommonlawError, np.linalg.LinAlgError):  # Trials that are too short, or start where nothing is finite
            return fit.but(Status.REFUSED)
        return fit.but(Status.NOT_CONVERGED)

    def _prepared(self, trials: Trials, few: Bools, most_samples: int) -> SearchProblem:
        """Return the problem among all terms, which begins with a fit of few, shape (equations, terms)."""
        before, known, signs = self.without.problem, self._known, np.zeros_like(self._known)
        signs[:, -1] = -1.0  # The state decays
        problem = prepare(
            trials,
            self.terms,
            np.where(few, known, np.nan_to_num(known)),
            noise=np.append(before.noise_estimate, np.nan) if before.noise_given else None,
            huber_threshold=before.models[0].observation.huber_threshold,
            most_samples=most_samples,
            guess=np.where(few, signs, 0.0),
        )
        return replace(problem, known=known, solver=PATH, differentiation=before.differentiation)

    @property
    def _has_state(self) -> Bools:
        """Which terms have the state in them, shape (terms,)."""
        column = self.terms.variables.index(self.name)
        return np.array([column in term.columns() for term in self.terms.terms])

    @cached_property
    def terms(self) -> Terms:
        """Those of the law without, and products of the state with one or none of the others."""
        before = self.without.problem.terms
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
        found[:, :-1, self._has_state] = np.nan
        if self.family.found:
            found[:, -1, self._index(self.family.found)] = np.nan
        if self.family.given:
            found[:, -1, self._index(self.family.given)] = 1.0
        return found

    @property
    def _begins(self) -> list[Bools]:
        """Supports to begin with, shape (equations, terms): linear ones, and that of the law without the state.

        Both with the state in them, and if it follows another one with their product.
        """
        free = np.isnan(self._known[0])
        effects = [self._index("{u}")] + ([self._index("{u}*{x}")] if self.family.is_of_state else [])
        states = self.without.problem.terms.variables.states
        linear = [self.terms.terms.index(parse_term(quoted(x), self.terms.variables)) for x in states]
        found = [np.zeros_like(free), np.zeros_like(free)]
        found[0][:-1, linear] = True
        found[1][:-1, : self.without.supports.shape[1]] = self.without.supports
        for each in found:
            each[:-1, effects] = True
            each[-1] = True
        return [each & free for each in found]


UNMEASURED_STATE = "latent state"
"""Of the history of a law: what was chosen of a latent state."""


def drives(variables: Variables) -> tuple[ParametricTerm, ...]:
    """Return what a law of second order may be driven by without an input: functions of time.

    They are the solutions of u' = -r u and of u'' = -w^2 u.
    """
    t = variables.time
    return (parametric_term(f"exp(-r*{t})", variables), *terms_of_family("periodic", variables, (t,)))


def with_drive_said(pool: Pool, offered: Sequence[ParametricTerm]) -> Pool:
    """Return laws of second order, the best without terms that it is better without, and with a word on what drives it.

    Parameters
    ----------
    pool
        The law of largest evidence among those with drives, and without.
    offered
        Those drives, see `drives`.
    """
    fit = _without_needless_terms(pool.best)
    terms = fit.problem.terms
    chosen = fit.supports.any(axis=0) & terms.is_factor
    named = [terms.names[k] for k in np.flatnonzero(chosen) if _is_one_of(terms, int(k), offered)]
    without = min((each.score for each in pool.rivals if each.problem.solver is not None), default=None)
    more = np.inf if without is None else without - fit.score
    why = f"latent forcing; without it -2 log evidence is {more:.3g} more"
    step = Step(UNMEASURED_STATE, ", ".join(named) or "none", why)
    if not named:
        step = Step(UNMEASURED_STATE, "none", "no latent forcing increases the evidence")
    return pool.with_best(replace(fit, steps=(step,)))


def _is_one_of(terms: Terms, index: int, offered: Sequence[ParametricTerm]) -> bool:
    """Return whether a term with parameters is one of those that were offered, whatever its parameters are called."""
    first = len(terms.variables.measured)
    columns = sorted(column for column in terms.terms[index].columns() if column >= first)
    names = [terms.variables.names[column] for column in columns]
    term = parse_term(terms.terms[index].expression(terms.variables.names), terms.variables)
    return any(
        parse_term(text, terms.variables) == term
        for each in offered
        if len(each.shared_parameters) == len(names)
        for text in each.expressions(terms.variables, names)
    )


def _without_needless_terms(fit: Fit) -> Fit:
    """Return a law with parameters inside terms without plain terms that its evidence is larger without."""
    terms = fit.problem.terms
    plain = terms.is_factor & ~np.array(terms.have_parameters, dtype=bool)
    while fit.problem.solver is None:
        fewer = list[Bools]()
        for j, k in np.argwhere(fit.supports & plain).tolist():
            fewer.append(fit.supports.copy())
            fewer[-1][j, k] = False
        refitted = (fit.refitted(each) for each in fewer)
        converged = [each for each in refitted if each.is_usable and each.has_converged]
        best = min(converged, default=fit)
        if not best < fit:
            break
        fit = best
    return fit
