"""From trials to a law: the estimator, and the function that most people call."""

import inspect
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from commonlaw.differentiation import AbstractDifferentiator, default_differentiation, parse_differentiation
from commonlaw.errors import CommonlawError, unknown
from commonlaw.formulation import (
    MOST_GROUPS,
    AbstractFormulation,
    Compressed,
    DiscreteForm,
    StrongForm,
    compress,
)
from commonlaw.law import Law
from commonlaw.library import AbstractLibrary, PolynomialLibrary, Terms, parse_library
from commonlaw.selection import (
    BLOCKS,
    Accuracy,
    ForecastError,
    chosen_law,
    fitted_law,
    ill_conditions,
    make_folds,
    select,
)
from commonlaw.solvers import (
    AbstractSolver,
    BackwardElimination,
    BestSubset,
    Constrained,
    ForwardSelection,
    GroupSTLSQ,
    parse_solver,
)
from commonlaw.trials import Trial, Trials, TrialStream

if TYPE_CHECKING:
    from sklearn.utils import Tags

    from commonlaw.forecast import Forecast

Floats = NDArray[np.float64]
Key = str | tuple[str, str]
"""A term, with the state of its equation before it when there are several."""

Fixed = Mapping[Key, float | Mapping[str, float]]

_MANY_TERMS = 60
"""More are too many for the solvers that look closely."""

_JUDGED = 4
"""Trials of an object that the accuracy of its rates is judged by."""


class LawDiscovery:
    """Finds the law that objects share, in scikit-learn's conventions.

    Parameters
    ----------
    order
        Order of the law: 1 for ``x' = f(x)``, 2 for ``x'' = f(x, x')``; 0 for a law in discrete time,
        ``x[k+1] = f(x[k])``, which takes the states as measured and needs no rates.
    library
        Candidate terms, or their text such as ``"poly:3"``. Default: polynomials of degree 3.
    differentiation
        How rates are estimated, or its text such as ``"savgol:35:3"``. Default: `default_differentiation` of the order.
    solver
        How terms are chosen, or its text such as ``"group-stlsq:1.5"``. A solver without its setting, ``GroupSTLSQ()``,
        offers its whole path, from which `rule` chooses. Default: the paths of ``GroupSTLSQ()`` and ``BestSubset()``.
    fixed
        Known terms: term to coefficient (``{"1": -9.8}``), or to coefficients by object; with several states the term
        is given with its equation's state (``{("x", "1"): -9.8}``). They are moved to the left-hand side.
    universal
        Terms that have one coefficient for all objects, such as gravity: ``("1",)``; named as in `fixed`.
    library_states
        Whether terms are evaluated on the ``"smoothed"`` or on the ``"measured"`` states, see `StrongForm`.
    trim
        Rows left out at each end of a trial, see `StrongForm`.
    jobs
        Processes that share the trials; each computes with one thread.
    rule
        How an equation is chosen from the candidates when the solver has no setting, see `commonlaw.selection.choose`.
    judge
        What candidates are judged by on held-out trials: the ``"rates"``, or their ``"forecasts"``, which takes longer.
    resamples
        Bootstrap resamples that judge how stable the candidates are.

    Attributes
    ----------
    law_
        The law that was found.

    Examples
    --------
    >>> from commonlaw import LawDiscovery, datasets
    >>> drops = datasets.linear_drag(noise=0.0)
    >>> model = LawDiscovery(order=2, library="poly:1", differentiation="finite:6", solver="group-stlsq:1").fit(drops)
    >>> model.law_.average().equations()
    ("x'' = -9.8 - 0.38 v",)
    """

    law_: Law

    def __init__(
        self,
        order: int = 1,
        library: AbstractLibrary | str | None = None,
        differentiation: AbstractDifferentiator | str | None = None,
        solver: AbstractSolver | str | None = None,
        fixed: Fixed | None = None,
        universal: Sequence[Key] = (),
        library_states: Literal["smoothed", "measured"] = "smoothed",
        trim: int = 0,
        jobs: int = 1,
        rule: str = "one-standard-error",
        judge: Literal["rates", "forecasts"] = "rates",
        resamples: int = 20,
    ) -> None:
        self.order = order
        self.library = library
        self.differentiation = differentiation
        self.solver = solver
        self.fixed = fixed
        self.universal = universal
        self.library_states = library_states
        self.trim = trim
        self.jobs = jobs
        self.rule = rule
        self.judge = judge
        self.resamples = resamples

    def fit(self, trials: Trials | TrialStream, y: None = None) -> Self:
        """Find the law of these trials.

        A stream is gone through once, and a second time to judge the accuracy of rates when a law is to be chosen.

        Raises
        ------
        CommonlawError
            If the trials cannot be used as they are; the message names the object and trial and says what to do.
        """
        from threadpoolctl import threadpool_limits

        if not isinstance(trials, Trials | TrialStream):
            raise CommonlawError(
                f"trials are given as {type(trials).__name__}; make them with Trials.from_frame, Trials.from_arrays or "
                "Trials.read"
            )
        if self.judge not in ("rates", "forecasts"):
            raise unknown("judge", self.judge, ("rates", "forecasts"))
        form, solver = self._formulation(), self._solver()
        terms = self._library().bind(form.variables(trials.schema))
        is_set = solver is not None and solver.is_set
        with threadpool_limits(1, "blas"):
            data = compress(trials, trials.schema, form, terms, parts=1 if is_set else BLOCKS, jobs=self.jobs)
            known = _known_coefficients(self.fixed or {}, trials.schema.states, data.objects, terms)
            rates = None if self.order == 0 else self._differentiation()
            law = Law(terms, trials.schema, self.order, data.objects, np.nan_to_num(known), rates)
            universal = [_place(key, trials.schema.states, terms) for key in self.universal]
            if solver is not None and is_set:
                fit = _sharing(solver, universal).solve(data.subtract(law.coefficients).systems, np.isnan(known[0]))
                law = fitted_law(law, fit, solver)
            else:
                accuracy = Accuracy(form, terms, _some_trials(trials, data.objects))
                listed = _default_solvers(len(terms)) if solver is None else (solver,)
                solvers = [_sharing(each, universal) for each in listed]
                choose = partial(select, data, known, solvers, accuracy, rule=self.rule, resamples=self.resamples)
                found = chosen_law(law, choose())
                if self.judge == "forecasts":
                    scores = _forecast_scores(trials, data.subtract(law.coefficients), found, np.isnan(known[0]))
                    found = chosen_law(law, choose(scores=scores))
                law = found
            self.law_ = replace(law, outcomes=(*law.outcomes, *ill_conditions(law, data.systems)))
        return self

    def predict(self, trials: Trials) -> "Forecast":
        """Forecast each trial from its own initial state, see `Law.predict`."""
        return self._fitted().predict(trials)

    def score(self, trials: Trials, y: None = None) -> float:
        """Return the R^2 of the forecasts of these trials, see `Law.score`."""
        return self._fitted().score(trials)

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the parameters by name."""
        return {name: getattr(self, name) for name in _PARAMETERS}

    def set_params(self, **parameters: Any) -> Self:
        """Set parameters by name and return the estimator.

        Raises
        ------
        CommonlawError
            If a name is not a parameter.
        """
        for name, value in parameters.items():
            if name not in _PARAMETERS:
                raise unknown("parameter", name, _PARAMETERS)
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        given = ", ".join(f"{name}={value!r}" for name, value in self.get_params().items() if value is not None)
        return f"LawDiscovery({given})"

    def __sklearn_tags__(self) -> "Tags":
        from sklearn.utils import InputTags, Tags, TargetTags

        inputs = InputTags(two_d_array=False)
        return Tags(estimator_type=None, target_tags=TargetTags(required=False), input_tags=inputs)

    def _fitted(self) -> Law:
        if not hasattr(self, "law_"):
            raise CommonlawError("no law was found yet: call fit first")
        return self.law_

    def _formulation(self) -> AbstractFormulation:
        if self.order == 0:
            return DiscreteForm()
        return StrongForm(self._differentiation(), self.order, self.library_states, self.trim)

    def _library(self) -> AbstractLibrary:
        if self.library is None:
            return PolynomialLibrary(3)
        return parse_library(self.library) if isinstance(self.library, str) else self.library

    def _differentiation(self) -> AbstractDifferentiator:
        if self.differentiation is None:
            return default_differentiation(self.order)
        if isinstance(self.differentiation, str):
            return parse_differentiation(self.differentiation)
        return self.differentiation

    def _solver(self) -> AbstractSolver | None:
        return parse_solver(self.solver) if isinstance(self.solver, str) else self.solver


_PARAMETERS = tuple(inspect.signature(LawDiscovery).parameters)


def discover(
    trials: Trials | TrialStream,
    *,
    order: int = 1,
    library: AbstractLibrary | str | None = None,
    differentiation: AbstractDifferentiator | str | None = None,
    solver: AbstractSolver | str | None = None,
    fixed: Fixed | None = None,
    universal: Sequence[Key] = (),
    library_states: Literal["smoothed", "measured"] = "smoothed",
    trim: int = 0,
    jobs: int = 1,
    rule: str = "one-standard-error",
    judge: Literal["rates", "forecasts"] = "rates",
    resamples: int = 20,
) -> Law:
    """Find the law that the objects of these trials share.

    Parameters are those of `LawDiscovery`.

    Raises
    ------
    CommonlawError
        If the trials cannot be used as they are, or settings do not fit; the message says where and what to do.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(noise=0.0)
    >>> law = cl.discover(drops, order=2, differentiation="finite:6", solver="group-stlsq:1")
    >>> print(law.average())
    x'' = -9.8 - 0.38 v
    <BLANKLINE>
    with v = x'
    """
    settings = (order, library, differentiation, solver, fixed, universal, library_states, trim, jobs, rule, judge)
    return LawDiscovery(*settings, resamples).fit(trials).law_


def _known_coefficients(fixed: Fixed, states: Sequence[str], objects: Sequence[str], terms: Terms) -> Floats:
    """Return the coefficients that are known, shape (objects, equations, terms), NaN where they are to be found."""
    known = np.full((len(objects), len(states), len(terms)), np.nan)
    for key, value in fixed.items():
        equation, place = _place(key, states, terms)
        term = terms.names[place]
        values = value if isinstance(value, Mapping) else dict.fromkeys(objects, value)
        missing = [name for name in objects if name not in values]
        if missing:
            raise CommonlawError(
                f"fixed term {term!r} has no coefficient for {', '.join(missing)}; give one for each object"
            )
        known[:, equation, place] = [values[name] for name in objects]
    return known


def _place(key: Key, states: Sequence[str], terms: Terms) -> tuple[int, int]:
    """Return the places of the equation and the term that a key names."""
    if not isinstance(key, tuple) and len(states) > 1:
        raise CommonlawError(f"term {key!r}: say of which equation, as ({states[0]!r}, {key!r})")
    state, term = key if isinstance(key, tuple) else (states[0], key)
    if state not in states:
        raise unknown("state", state, states)
    return states.index(state), terms.index(term)


def _sharing(solver: AbstractSolver, universal: Sequence[tuple[int, int]]) -> AbstractSolver:
    """Return the solver with one coefficient for all objects at these equations and terms."""
    for equation in dict.fromkeys(equation for equation, _ in universal):
        solver = Constrained(solver, tuple(term for j, term in universal if j == equation), equation=equation)
    return solver


def _default_solvers(terms: int) -> tuple[AbstractSolver, ...]:
    """Return the solvers whose paths list the candidates when none is named.

    Thresholding keeps what matters by size, best subset what fits best; each misses laws that the other lists. Both
    are too slow for hundreds of terms, where adding and deleting terms one by one takes their place.
    """
    return (GroupSTLSQ(), BestSubset()) if terms <= _MANY_TERMS else (ForwardSelection(), BackwardElimination())


def _some_trials(trials: Iterable[Trial], objects: Sequence[str]) -> list[list[Trial]]:
    """Return the first few trials of each object, by which the accuracy of its rates is judged."""
    found: dict[str, list[Trial]] = {name: [] for name in objects}
    for trial in trials:
        if len(found[trial.object]) < _JUDGED:
            found[trial.object].append(trial)
    return list(found.values())


def _forecast_scores(
    trials: Trials | TrialStream, data: Compressed, law: Law, free: NDArray[np.bool_]
) -> list[ForecastError]:
    """Return what scores the supports of each equation on forecasts of held-out trials, the others as in `law`."""
    if not isinstance(trials, Trials) or any(len(trials.of(name)) > MOST_GROUPS for name in trials.objects):
        raise CommonlawError(
            f"forecasts judge candidates only on trials in memory, at most {MOST_GROUPS} of an object; judge on rates"
        )
    folds = make_folds(data.groups)
    return [ForecastError(folds, target, law, free, trials) for target in range(len(law.states))]
