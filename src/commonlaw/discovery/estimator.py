"""From trials to a law: the estimator, and the function that most people call."""

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.differentiation import AbstractDifferentiator, default_differentiation, parse_differentiation
from commonlaw.discovery.known import Fixed, Key, known_coefficients, place_of
from commonlaw.discovery.rows import default_solvers, forecast_scores, sharing, some_trials
from commonlaw.errors import CommonlawError, unknown
from commonlaw.formulation import (
    AbstractFormulation,
    DiscreteForm,
    StrongForm,
    WeakForm,
    compress,
    reweighted,
)
from commonlaw.inference import OUTLIERS, PATH, find_law, known_noise
from commonlaw.law import Law
from commonlaw.library import AbstractLibrary, PolynomialLibrary, Terms, parse_library
from commonlaw.progress import ProgressCallback, on_terminal
from commonlaw.selection import (
    BLOCKS,
    Accuracy,
    chosen_law,
    fitted_law,
    ill_conditions,
    select,
)
from commonlaw.solvers import (
    AbstractSolver,
    parse_solver,
)
from commonlaw.trials import Schema, Trials, TrialStream

if TYPE_CHECKING:
    from sklearn.utils import Tags

    from commonlaw.forecast import Forecast

_MANY_CANDIDATES = 70
"""More terms for each equation make the likelihood of trajectories too slow to be the default."""

_MANY_SAMPLES = 50_000
"""More samples do so too, and rates are then good enough."""

FORMULATIONS = ("auto", "trajectories", "rates", "weak")
"""How measurements and laws are compared."""

_OF_RATES = ("differentiation", "library_states", "trim", "rule", "judge", "n_resamples")
"""Settings that only rates have."""

_OF_TRAJECTORIES = ("noise", "outliers", "errors", "pool")
"""Settings that only trajectories have."""


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
        How rates are estimated, or its text such as ``"savgol:35:3"``. Default: `default_differentiation`.
    solver
        How terms are chosen, or its text such as ``"group-stlsq:1.5"``. A solver without its setting, ``STLSQ()``,
        offers its whole path, from which `rule` chooses. Default: the paths of ``STLSQ()`` and ``BestSubset()``.
    fixed
        Known terms: term to coefficient (``{"1": -9.8}``), or to coefficients by object; with several states the term
        is given with its equation's state (``{("x", "1"): -9.8}``). They are moved to the left-hand side.
    universal
        Terms that have one coefficient for all objects, such as gravity: ``("1",)``; named as in `fixed`.
    library_states
        Whether terms are evaluated on the ``"smoothed"`` or on the ``"measured"`` states, see `StrongForm`.
    trim
        Rows left out at each end of a trial, see `StrongForm`.
    n_jobs
        Processes that share the trials; each computes with one thread.
    rule
        How an equation is chosen from the candidates when the solver has no setting, see `commonlaw.selection.choose`.
    judge
        What candidates are judged by on held-out trials: the ``"rates"``, or their ``"forecasts"``, which takes longer.
    n_resamples
        Bootstrap resamples that judge how stable the candidates are.
    formulation
        How measurements and laws are compared. ``"trajectories"``: states and coefficients are fitted together to what
        was measured, and terms are chosen by their evidence; the law has standard errors (see `commonlaw.inference`).
        ``"rates"``: terms are fitted to estimated rates. ``"weak"``: to integrals against test functions. ``"auto"``:
        trajectories, unless a solver or another setting of rates is given, or there are more than 50 000 samples.
    noise
        Standard deviation of each state's measurement noise by name, for trajectories. Default: it is estimated.
    outliers
        Standard deviations of noise beyond which a measurement counts as an outlier, for trajectories; infinite for
        none.
    errors
        How standard errors by trajectories are found. ``"likelihood"``: from its curvature. ``"bootstrap"``: from the
        scatter of coefficients when stretches of the trials are drawn anew, for noise that is neither normal nor alike
        everywhere.
    pool
        Whether coefficients by trajectories are drawn to their mean over objects as far as these are alike, see
        `Law.partial_pooling`.
    progress
        Takes what is being done, step by step. Default: it is written to the terminal after two seconds.

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
        n_jobs: int = 1,
        rule: str = "one-standard-error",
        judge: Literal["rates", "forecasts"] = "rates",
        n_resamples: int = 20,
        formulation: Literal["auto", "trajectories", "rates", "weak"] = "auto",
        noise: Mapping[str, float] | None = None,
        outliers: float = OUTLIERS,
        errors: Literal["likelihood", "bootstrap"] = "likelihood",
        pool: bool = True,
        progress: ProgressCallback | None = None,
    ) -> None:
        self.order = order
        self.library = library
        self.differentiation = differentiation
        self.solver = solver
        self.fixed = fixed
        self.universal = universal
        self.library_states = library_states
        self.trim = trim
        self.n_jobs = n_jobs
        self.rule = rule
        self.judge = judge
        self.n_resamples = n_resamples
        self.formulation = formulation
        self.noise = noise
        self.outliers = outliers
        self.errors = errors
        self.pool = pool
        self.progress = progress

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
        if self.errors not in ("likelihood", "bootstrap"):
            raise unknown("kind of errors", self.errors, ("likelihood", "bootstrap"))
        way = self._way(trials)
        with threadpool_limits(1, "blas"):
            if way == "trajectories" and isinstance(trials, Trials):
                self.law_ = self._likely_law(trials)
            else:
                self.law_ = self._law_of_rows(trials, self._form(trials, way), self._solver())
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

    def _way(self, trials: Trials | TrialStream) -> str:
        """Return the formulation, chosen if that was left open.

        Raises
        ------
        CommonlawError
            If there is no such formulation, or another setting does not go with it.
        """
        if self.formulation not in FORMULATIONS:
            raise unknown("formulation", self.formulation, FORMULATIONS)
        of_rates = [name for name in _OF_RATES if getattr(self, name) != _DEFAULTS[name]]
        solver = self._solver()
        reasons = [
            *of_rates,
            *["a solver with its setting"] * (solver is not None and solver.hyperparameter is not None),
        ]
        reasons += ["order=0"] * (self.order == 0) + ["a stream"] * isinstance(trials, TrialStream)
        if self.formulation == "trajectories" and reasons:
            raise CommonlawError(
                f"{reasons[0]} does not go with formulation='trajectories': leave it out, or use formulation='rates'"
            )
        if self.formulation == "weak" and (self.order == 0 or isinstance(trials, TrialStream)):
            raise CommonlawError(f"{reasons[-1]} does not go with formulation='weak': use formulation='rates'")
        way: str = self.formulation
        if way == "auto":
            many = isinstance(trials, TrialStream) or sum(map(len, trials)) > _MANY_SAMPLES
            of_rates_then = reasons or solver is not None or many or len(self._terms(trials.schema)) > _MANY_CANDIDATES
            way = "rates" if of_rates_then else "trajectories"
        ignored = [name for name in _OF_TRAJECTORIES if getattr(self, name) != _DEFAULTS[name]]
        if ignored and way != "trajectories":
            raise CommonlawError(
                f"{ignored[0]} does not go with formulation={way!r}: leave it out, or use formulation='trajectories'"
            )
        return way

    def _likely_law(self, trials: Trials) -> Law:
        """Return the law of largest evidence, by the likelihood of its trajectories."""
        states, terms = trials.schema.states, self._terms(trials.schema)
        known = known_coefficients(self.fixed or {}, states, trials.objects, terms)
        law = Law(terms, trials.schema, self.order, trials.objects, np.nan_to_num(known), self._differentiation(trials))
        noise = None if self.noise is None else known_noise(self.noise, states)
        if not self.outliers > 0:
            raise CommonlawError(
                f"outliers is {self.outliers}: give how many standard deviations of noise a measurement must be off to "
                "be one, above zero"
            )
        progress = on_terminal() if self.progress is None else self.progress
        solver = self._solver() or PATH

        def by_rates() -> Bools:
            return np.asarray(self._law_of_rows(trials, self._rates_form(trials), None).support & np.isnan(known[0]))

        universal = np.zeros(known.shape[1:], dtype=bool)
        for key in self.universal:
            universal[place_of(key, states, terms)] = True
        return find_law(
            trials,
            law,
            known,
            by_rates=by_rates,
            solver=solver,
            noise=noise,
            outliers=self.outliers,
            errors=self.errors,
            universal=universal,
            pool=self.pool,
            progress=progress,
        )

    def _law_of_rows(
        self, trials: Trials | TrialStream, form: AbstractFormulation, solver: AbstractSolver | None
    ) -> Law:
        """Return the law that a solver finds, or that is chosen from solvers' paths, on the rows of a formulation."""
        terms = self._library().bind(form.variables(trials.schema))
        has_value = solver is not None and solver.hyperparameter is not None
        data = compress(trials, trials.schema, form, terms, parts=1 if has_value else BLOCKS, n_jobs=self.n_jobs)
        known = known_coefficients(self.fixed or {}, trials.schema.states, data.objects, terms)
        rates = None if self.order == 0 else self._differentiation(trials)
        law = Law(terms, trials.schema, self.order, data.objects, np.nan_to_num(known), rates)
        universal = [place_of(key, trials.schema.states, terms) for key in self.universal]
        if solver is not None and has_value:
            candidates = sharing(solver, universal).solve(data.subtract(law.coefficients).problems, np.isnan(known[0]))
            found = fitted_law(law, candidates, solver)
        else:
            accuracy = Accuracy(form, terms, some_trials(trials, data.objects))
            listed = default_solvers(len(terms)) if solver is None else (solver,)
            solvers = [sharing(each, universal) for each in listed]
            choose = partial(select, data, known, solvers, accuracy, rule=self.rule, n_resamples=self.n_resamples)
            found = chosen_law(law, choose())
            if self.judge == "forecasts":
                scores = forecast_scores(trials, data.subtract(law.coefficients), found, np.isnan(known[0]))
                found = chosen_law(law, choose(scores=scores))
        return replace(found, outcomes=(*found.outcomes, *ill_conditions(found, data.problems)))

    def _terms(self, schema: Schema) -> Terms:
        return self._library().bind(self._rates_form().variables(schema))

    def _form(self, trials: Trials | TrialStream, way: str) -> AbstractFormulation:
        if way == "weak" and isinstance(trials, Trials):
            return reweighted(trials, self._terms(trials.schema), WeakForm(self.order))[0]
        return self._rates_form(trials)

    def _rates_form(self, trials: Trials | TrialStream | None = None) -> AbstractFormulation:
        if self.order == 0:
            return DiscreteForm()
        return StrongForm(self._differentiation(trials), self.order, self.library_states, self.trim)

    def _library(self) -> AbstractLibrary:
        if self.library is None:
            return PolynomialLibrary(3)
        return parse_library(self.library) if isinstance(self.library, str) else self.library

    def _differentiation(self, trials: Trials | TrialStream | None) -> AbstractDifferentiator:
        if self.differentiation is None:
            samples = min(map(len, trials), default=np.inf) if isinstance(trials, Trials) else np.inf
            return default_differentiation(self.order, samples)
        if isinstance(self.differentiation, str):
            return parse_differentiation(self.differentiation)
        return self.differentiation

    def _solver(self) -> AbstractSolver | None:
        return parse_solver(self.solver) if isinstance(self.solver, str) else self.solver


_DEFAULTS = {name: each.default for name, each in inspect.signature(LawDiscovery).parameters.items()}
_PARAMETERS = tuple(_DEFAULTS)


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
    n_jobs: int = 1,
    rule: str = "one-standard-error",
    judge: Literal["rates", "forecasts"] = "rates",
    n_resamples: int = 20,
    formulation: Literal["auto", "trajectories", "rates", "weak"] = "auto",
    noise: Mapping[str, float] | None = None,
    outliers: float = OUTLIERS,
    errors: Literal["likelihood", "bootstrap"] = "likelihood",
    pool: bool = True,
    progress: ProgressCallback | None = None,
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
    settings = (order, library, differentiation, solver, fixed, universal, library_states, trim, n_jobs, rule, judge)
    return LawDiscovery(*settings, n_resamples, formulation, noise, outliers, errors, pool, progress).fit(trials).law_
