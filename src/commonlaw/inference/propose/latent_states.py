"""Latent states and forcing: candidate equations for them, compared by their evidence.

The equation of a latent state is one of a few, with fixed scale and initial value, so that it is identifiable. Its
effects on the measured states are selected among products with their terms, by the likelihood linearised about a fit
of few terms. The law without a latent state is one of the candidates.

Laws of second order may have forcing terms, functions of time with estimated parameters. They are solutions of the
equations that such a forcing would have as a latent state.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.diagnostics import note
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import refine_support, rescale_noise, with_neighbours
from commonlaw.inference.fit.fit import NO_MODEL_ERROR, Fit, Status
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.search.law_search import PATH
from commonlaw.inference.search.pool import Pool
from commonlaw.law import Step
from commonlaw.law.parameters import left_hand_sides, named_parameters
from commonlaw.law.text import Addend, written_equations
from commonlaw.library import ParametricTerm, Terms, Variables, parse_term
from commonlaw.library.notation import quoted
from commonlaw.library.parametric import free_name, parametric_term, terms_of_family
from commonlaw.runtime.forking import cached_property
from commonlaw.runtime.progress import ProgressCallback, Stage
from commonlaw.trials import Trials
from commonlaw.trials.transformations import with_starts
from commonlaw.trials.trial import property_names


@dataclass(frozen=True)
class Family:
    """A candidate equation of a latent state ``{u}``, which may contain a measured one, ``{x}``.

    All trials have the initial value `start`. The equation has a term with an estimated coefficient, and one with
    coefficient one, which fixes the scale; either may be empty.
    """

    description: str
    start: float
    estimated: str = ""
    fixed: str = ""

    @property
    def is_of_state(self) -> bool:
        return "{x}" in self.estimated + self.fixed


FAMILIES = (
    Family("decays from 1, as a depot or a drive does", 1.0, estimated="{u}"),
    Family("is used up from 1 by {x}, as the susceptible are by the infected", 1.0, estimated="{u}*{x}"),
    Family("adds up {x} from 0, as a pool does that keeps what it gets", 0.0, fixed="{x}"),
    Family("is filled by {x} from 0 and decays, as a compartment does", 0.0, fixed="{x}", estimated="{u}"),
)
"""In order of preference among laws that fit equally well."""


def with_latent_state(pool: Pool, trials: Trials, *, most_samples: int, progress: ProgressCallback) -> Pool:
    """Return a pool of laws of first order with laws with a latent state; of equivalent ones only the first.

    That has the evidence of the best of them.
    """
    plain = pool.plain
    assert plain is not None
    taken = (*plain.problem.terms.variables.names, *property_names(trials.properties))
    name, tried = free_name("u", taken), list[tuple[_LatentStateModel, Fit]]()
    models = [
        _LatentStateModel(plain, family, state, name)
        for family in FAMILIES
        for state in (trials.schema.states if family.is_of_state else ("",))
    ]
    for number, model in enumerate(models, start=1):
        progress(Stage(f"trying a latent state that {model.description}", number / (len(models) + 1)))
        if (fit := model.fitted(trials, most_samples)).is_usable:
            tried.append((model, fit))
    tried.sort(key=lambda pair: pair[1])
    best_models = tried[: settings.MAX_RIVALS]
    tried[: settings.MAX_RIVALS] = [(model, model.restarted(trials, most_samples, fit)) for model, fit in best_models]
    tried.sort(key=lambda pair: models.index(pair[0]))
    multiplicity = 2 * float(np.log(len(models)))
    fits = [(model, fit.with_score(fit.score.plus("multiplicity", multiplicity))) for model, fit in tried]
    # A fit with lack of fit may end away from its optimum, where the Laplace approximation is too large
    without = pool.best.with_score(pool.best.score_at_estimates)
    best = min([without, *(fit for _, fit in fits)])
    equivalent = [pair for pair in fits if _is_equivalent(pair[1], best)]
    others = [fit for _, fit in fits if not _is_equivalent(fit, best)]
    if not equivalent:
        more = [fit.score - best.score for fit in others]
        why = f"laws with one have at least {min(more):.3g} more of -2 log evidence" if more else "no law with one fits"
        step = Step(LATENT_STATE, "none", why)
        return pool.with_best(replace(without, steps=(step,))).joined(*others)
    (model, chosen), *same = equivalent
    why = f"{model.description}; without it -2 log evidence is {without.score - best.score:.3g} more"
    alternatives = "; or ".join(
        f"{'; '.join(_structure(fit))}, in which it {alternative.description}" for alternative, fit in same
    )
    chosen = replace(
        chosen.with_score(best.score),
        steps=(Step(LATENT_STATE, _structure(chosen)[-1], why),),
        outcomes=(note("latent-state-not-identifiable", name=model.name, others=alternatives),) if same else (),
    )
    return pool.with_best(without).joined(chosen, *others)


def _structure(fit: Fit) -> tuple[str, ...]:
    """Return the structure of each equation, with numbers for known coefficients."""
    coefficients = np.array([estimate.coefficients for estimate in fit.estimates])
    law, known = replace(fit.problem.law, coefficients=coefficients), fit.problem.known[0]
    rows: list[list[Addend]] = [[] for _ in law.schema.states]
    for definition in named_parameters(law).definitions:
        if law.terms.is_factor[definition.term]:
            number = known[definition.equation, definition.term]
            label = definition.name if np.isnan(number) else f"{number:g}"
            rows[definition.equation].append(Addend(False, label, law.terms.factors[definition.term]))
    return written_equations(left_hand_sides(law), rows)


def _is_equivalent(one: Fit, reference: Fit) -> bool:
    """Return whether laws with a latent state and equally many coefficients have the same deviance."""

    def deviance(fit: Fit) -> float:
        """Return minus twice the log-likelihood of the measurements, up to a constant."""
        problem = fit.problem
        measured = ~problem.trials.schema.is_latent
        states = np.concatenate([trial.states for trial in problem.trials])[:, measured]
        scale = 2 * np.isfinite(states).sum(axis=0) @ np.log(problem.noise[measured])
        return float(scale) + sum(estimate.deviance for estimate in fit.estimates)

    return (
        one.problem.trials.schema.states == reference.problem.trials.schema.states
        and one.size == reference.size
        and abs(deviance(one) - deviance(reference)) < settings.MAX_MESH_CHANGE
    )


@dataclass(frozen=True, eq=False)
class _LatentStateModel:
    """The search for a law with a latent state of this name, with the equation of a family.

    The terms of the law without it are the candidates; `followed` is the measured state in its equation.
    """

    without: Fit
    family: Family
    followed: str
    name: str

    @property
    def description(self) -> str:
        """Its equation in words."""
        return self.family.description.format(x=self.followed)

    def fitted(self, trials: Trials, most_samples: int) -> Fit:
        return min(self._run_search(trials, few, most_samples) for few in self._initial_supports)

    def restarted(self, trials: Trials, most_samples: int, fit: Fit) -> Fit:
        """Return the law of a search restarted from the terms of the last one while the evidence increases."""
        for _ in range(settings.ALTERNATIONS):
            better = self._run_search(trials, fit.supports, most_samples)
            if not fit.score - better.score > settings.MIN_GAIN:
                break
            fit = better
        return fit

    def _run_search(self, trials: Trials, few: Bools, most_samples: int) -> Fit:
        """Return the law of a search that starts from few terms, shape (equations, terms)."""
        trials, fit = with_starts(trials, {self.name: self.family.start}), self.without
        before, signs = self.without.problem, np.zeros_like(self._known)
        signs[:, -1] = -1.0  # The state decays
        try:
            for _ in range(settings.ALTERNATIONS):
                # With all terms, from a fit of few
                problem = prepare(
                    trials,
                    self.terms,
                    np.where(few, self._known, np.nan_to_num(self._known)),
                    noise=np.append(before.noise_estimate, np.nan) if before.noise_given else None,
                    huber_threshold=before.models[0].observation.huber_threshold,
                    most_samples=most_samples,
                    guess=np.where(few, signs, 0.0),
                )
                problem = replace(problem, known=self._known, solver=PATH, differentiation=before.differentiation)
                fit = rescale_noise(refine_support(problem, few, problem.starts, NO_MODEL_ERROR))
                fit = rescale_noise(with_neighbours([fit])[0])
                if not fit.is_usable or not fit.supports[:-1, self._has_state].any():
                    return fit.but(Status.WITHOUT_EFFECT)
                if np.isfinite(fit.score.total) and fit.predicted_decrease < settings.MIN_GAIN * len(fit.estimates):
                    return replace(fit, problem=replace(fit.problem, solver=None), alternatives=())
                few = fit.supports  # Another start from the supports so far
        except (CommonlawError, np.linalg.LinAlgError):  # Too short trials, or infinite terms
            return fit.but(Status.REFUSED)
        return fit.but(Status.NOT_CONVERGED)

    @property
    def _has_state(self) -> Bools:
        """Which terms contain the latent state, shape (terms,)."""
        column = self.terms.variables.index(self.name)
        return np.array([column in term.columns() for term in self.terms.terms])

    @cached_property
    def terms(self) -> Terms:
        """Those of the law without it, the latent state, and its products with the measured states."""
        before = self.without.problem.terms
        variables = replace(before.variables, states=(*before.variables.states, self.name))
        texts = [term.expression(before.variables.names) for term in before.terms]
        texts += [self._symbol, *(f"{self._symbol}*{quoted(x)}" for x in before.variables.states)]
        texts += [quoted(x) for x in before.variables.states]
        return Terms(variables, tuple(dict.fromkeys(parse_term(text, variables) for text in texts)))

    @property
    def _symbol(self) -> str:
        return quoted(self.name)

    def _index(self, text: str) -> int:
        written = text.format(u=self._symbol, x=quoted(self.followed))
        return self.terms.terms.index(parse_term(written, self.terms.variables))

    @cached_property
    def _known(self) -> Floats:
        """Known coefficients, shape (objects, equations, terms), NaN where they are estimated."""
        before = self.without.problem.known
        objects, equations, count = before.shape
        result = np.zeros((objects, equations + 1, len(self.terms)))
        result[:, :-1, :count] = before
        result[:, :-1, self._has_state] = np.nan
        if self.family.estimated:
            result[:, -1, self._index(self.family.estimated)] = np.nan
        if self.family.fixed:
            result[:, -1, self._index(self.family.fixed)] = 1.0
        return result

    @property
    def _initial_supports(self) -> list[Bools]:
        """Initial supports, shape (equations, terms): linear terms, and the terms of the law without the latent state.

        Both have the latent state in each equation, and its product with the state in its equation.
        """
        free = np.isnan(self._known[0])
        effects = [self._index("{u}")] + ([self._index("{u}*{x}")] if self.family.is_of_state else [])
        states = self.without.problem.terms.variables.states
        linear = [self.terms.terms.index(parse_term(quoted(x), self.terms.variables)) for x in states]
        supports = np.zeros((2, *free.shape), dtype=np.bool_)
        supports[0, :-1, linear] = True
        supports[1, :-1, : self.without.supports.shape[1]] = self.without.supports
        supports[:, :-1, effects] = True
        supports[:, -1] = True
        return list(supports & free)


LATENT_STATE = "latent state"
"""Stage of the history of a law."""


def drives(variables: Variables) -> tuple[ParametricTerm, ...]:
    """Return candidate forcing terms of laws of second order: solutions of u' = -r u and of u'' = -w^2 u."""
    t = variables.time
    return (parametric_term(f"exp(-r*{t})", variables), *terms_of_family("periodic", variables, (t,)))


def with_forcing_step(pool: Pool, offered: Sequence[ParametricTerm]) -> Pool:
    """Return a pool of laws of second order with needless terms of the best eliminated, and a step on its forcing.

    Forcing terms offered are those of `drives`.
    """
    fit, terms = pool.best, pool.best.problem.terms
    plain = terms.is_factor & ~np.array(terms.have_parameters, dtype=bool)
    while fit.problem.solver is None:  # Backward elimination
        fewer = list[Bools]()
        for j, k in np.argwhere(fit.supports & plain).tolist():
            fewer.append(fit.supports.copy())
            fewer[-1][j, k] = False
        refitted = (fit.refitted(supports) for supports in fewer)
        best = min((less for less in refitted if less.is_usable and less.has_converged), default=fit)
        if not best < fit:
            break
        fit = best

    def is_offered(k: int) -> bool:
        """Return whether a term is one of those offered, up to the names of its parameters."""
        variables = terms.variables
        columns = sorted(column for column in terms.terms[k].columns() if column >= len(variables.measured))
        names = [variables.names[column] for column in columns]
        term = parse_term(terms.terms[k].expression(variables.names), variables)
        same_size = (forcing for forcing in offered if len(forcing.shared_parameters) == len(names))
        expressions = (text for forcing in same_size for text in forcing.expressions(variables, names))
        return any(parse_term(text, variables) == term for text in expressions)

    chosen = np.flatnonzero(fit.supports.any(axis=0) & terms.is_factor).tolist()
    named = [terms.names[k] for k in chosen if is_offered(k)]
    without = min((rival.score for rival in pool.rivals if rival.problem.solver is not None), default=None)
    more = np.inf if without is None else without - fit.score
    gain = f"latent forcing; without it -2 log evidence is {more:.3g} more"
    why = gain if named else "no latent forcing increases the evidence"
    return pool.with_best(replace(fit, steps=(Step(LATENT_STATE, ", ".join(named) or "none", why),)))
