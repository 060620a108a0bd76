"""Laws by least squares on the rows of any formulation: a solver at its value, or selection from solver paths."""

from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Literal

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.diagnostics import note
from commonlaw.differentiation import AbstractDifferentiator, default_differentiation, parse_differentiation
from commonlaw.discovery.method import AbstractMethod, ModelStructure, check_supported, parsed
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.formulation import (
    MAX_GROUPS,
    AbstractFormulation,
    CompressedTrials,
    DiscreteForm,
    GivenForm,
    ObjectRows,
    StrongForm,
    WeakForm,
    merged_rows,
    reweight,
    rows_by_object,
    some_trials,
)
from commonlaw.inference.data.noise import known_noise
from commonlaw.law import Law, Provenance
from commonlaw.library import Order, highest_order
from commonlaw.runtime.arguments import check_type, check_types, check_whole_number
from commonlaw.runtime.cluster import counting, current_cluster
from commonlaw.runtime.fit_options import documented, setting
from commonlaw.runtime.parallel import check_n_jobs
from commonlaw.runtime.progress import ProgressCallback, announce, check_memory
from commonlaw.selection.cross_validation import ForecastError, make_folds
from commonlaw.selection.rules import RULES
from commonlaw.selection.selecting import SEGMENTS, Accuracy, chosen_law, fitted_law, ill_conditions, select
from commonlaw.solvers import SR3, STLSQ, AbstractSolver, BestSubset, ConstrainedSolver, StepwiseSelection, parse_solver
from commonlaw.text import counted
from commonlaw.trials import Schema, Trials, TrialStream

RowsByObject = dict[str, ObjectRows]


@documented
@dataclass(frozen=True, kw_only=True)
class AbstractRegression(AbstractMethod):
    """Sparse regression: selection of terms and estimation of coefficients by least squares on rows.

    Parameters
    ----------
    {parameters}
    """

    solver: AbstractSolver | str | None = setting(
        default=None,
        label="Solver",
        metavar="SPEC",
        text="How terms are chosen, or its text: group-stlsq[:THRESHOLD[:IMPORTANCE[:LEVEL]]], "
        "best-subset[:TERMS], forward[:TERMS], backward[:TERMS], lasso[:PENALTY], sr3[:THRESHOLD] (one set of "
        "terms for all objects), stlsq[:THRESHOLD] (terms specific to each object). Without its value a solver "
        "offers its whole path, from which `rule` chooses; paths of thresholds depend on units. By default the "
        "paths of group-stlsq and best-subset, or of stepwise selection where there are more than 60 terms.",
    )
    rule: str = setting(
        default="one-standard-error",
        label="Selection rule",
        text="How an equation is chosen from the candidates when the solver has no value: one-standard-error or "
        "held-out (by the error on held-out trials), aic, aicc, bic, ebic.",
    )
    scoring: Literal["residuals", "forecasts"] = setting(
        default="residuals",
        label="Held-out error",
        text="What candidates are compared by on held-out trials: the residuals of their rows, or their forecasts, "
        "which takes longer.",
    )
    n_resamples: int = setting(
        default=20,
        label="Resamples",
        text="Number of bootstrap resamples to assess the stability of candidates.",
    )
    n_jobs: int = setting(
        default=1, label="Processes", text="Number of processes that share the trials; each computes with one thread."
    )
    seed: int = setting(default=0, label="Seed", text="Seed of the resamples.")

    def __post_init__(self) -> None:
        check_choice("rule", self.rule, RULES)
        check_choice("scoring", self.scoring, ("residuals", "forecasts"))
        check_whole_number("seed", self.seed, 0)
        check_whole_number("n_resamples", self.n_resamples, 0, 10_000)
        check_n_jobs(self.n_jobs)
        object.__setattr__(self, "solver", parsed(self.solver, parse_solver))
        self._check()
        check_types(type(self), vars(self))

    def _check(self) -> None:
        """Refuse values that do not fit, and parse texts."""

    @abstractmethod
    def formulation(self, trials: Trials | None, structure: ModelStructure) -> AbstractFormulation:
        """Return the formulation that makes rows of these trials, or of a stream if there are none in memory."""

    @abstractmethod
    def initial_rates(self, trials: Trials | None, order: Order) -> AbstractDifferentiator | None:
        """Return the differentiation that estimates initial rates for forecasts."""

    def find(self, trials: Trials, structure: ModelStructure, progress: ProgressCallback) -> Law:
        def compressed(rows: partial[RowsByObject], segments: int) -> CompressedTrials:
            data = CompressedTrials.of(rows(trials, segments=segments, n_jobs=self.n_jobs), trials.schema)
            return replace(data, samples=some_trials(trials, data.objects))

        return self._found(trials, trials.schema, compressed, structure, progress)

    def find_by_file(self, stream: TrialStream, structure: ModelStructure, progress: ProgressCallback) -> Law:
        def compressed(rows: partial[RowsByObject], segments: int) -> CompressedTrials:
            cluster, rows = current_cluster(), partial(rows, segments=segments, sampled=segments > 1)
            if cluster is None:
                return CompressedTrials.of(rows(stream, n_jobs=self.n_jobs), stream.schema)
            done = counting(progress, "compressing files", len(stream.files), cluster)
            return CompressedTrials.of(cluster.merged(rows, stream.files, merged_rows, done), stream.schema)

        return self._found(None, stream.schema, compressed, structure, progress)

    def _found(
        self,
        trials: Trials | None,
        schema: Schema,
        compressed: Callable[[partial[RowsByObject], int], CompressedTrials],
        structure: ModelStructure,
        progress: ProgressCallback,
    ) -> Law:
        """Return the law of compressed rows, of which some terms are chosen; of a stream no trials are in memory."""
        check_supported(self, schema, structure)
        terms = structure.terms(schema)
        solver = parsed(self.solver, parse_solver)
        segments = 1 if solver is not None and solver.hyperparameter is not None else SEGMENTS
        _check_effort(trials, len(schema.states), len(terms), segments)
        progress("building the regression problem")
        formulation = self.formulation(trials, structure)
        data = compressed(partial(rows_by_object, form=formulation, terms=terms), segments)
        known = structure.known_coefficients(schema, data.objects)
        law = Law(
            terms,
            schema,
            structure.order,
            data.objects,
            np.nan_to_num(known),
            provenance=Provenance(self.initial_rates(trials, structure.order)),
        )
        shared = structure.shared_coefficients(schema)
        progress("choosing terms")
        if solver is not None and solver.hyperparameter is not None:
            rest = data.subtract(law.coefficients).problems
            result = fitted_law(law, _sharing(solver, shared).solve(rest, np.isnan(known[0])), solver)
        else:
            listed: tuple[AbstractSolver, ...] = (solver,) if solver else (STLSQ(normalize=True), BestSubset())
            if solver is None and len(terms) > 60:
                listed = StepwiseSelection(direction="forward"), StepwiseSelection(direction="backward")
            solvers = [_sharing(offered, shared) for offered in listed]
            accuracy = Accuracy(formulation, terms, data.samples)
            choose = partial(
                select, data, known, solvers, accuracy, rule=self.rule, n_resamples=self.n_resamples, seed=self.seed
            )
            result = chosen_law(law, choose())
            if self.scoring == "forecasts":
                if trials is None or any(len(trials.of_object(name)) > MAX_GROUPS for name in trials.objects):
                    raise CommonlawError("scoring-of-stream", limit=MAX_GROUPS)
                progress("comparing forecasts of held-out trials")
                folds, free = make_folds(data.subtract(law.coefficients).groups), np.isnan(known[0])
                scores = [ForecastError(folds, j, result, free, trials) for j in range(len(schema.states))]
                result = chosen_law(law, choose(scores=scores))
        outcomes = (*result.diagnostics, *ill_conditions(result, data.problems))
        if isinstance(solver, STLSQ | SR3) and not solver.normalize and solver.hyperparameter is None:
            outcomes = (*outcomes, note("units-of-candidates"))
        return replace(result, provenance=replace(result.provenance, outcomes=outcomes))


def _check_effort(trials: Trials | None, states: int, terms: int, segments: int) -> None:
    """Refuse terms whose matrices exceed the memory, and announce a long selection."""
    listed = trials or ()
    counts = Counter(trial.object for trial in listed) or {"": 1}
    what = f"{counted(terms, 'term')} for {counted(states, 'equation')} and {counted(len(counts), 'object')}"
    # Factors of each trial's segments and three mergers, and matrices of terms that are held at a time
    kept = sum(min(count, MAX_GROUPS) for count in counts.values()) * (segments + 3)
    rows = 4 * terms * max(map(len, listed), default=1)
    check_memory(f"regression with {what}", 8 * (kept * (terms + states) ** 2 + rows), "take a smaller library")
    if segments > 1:
        announce(
            f"choosing from {what}",
            states * len(counts) * (4e-3 + 1e-6 * terms**3),
            "take a smaller library or fewer objects, or a solver with its value such as 'group-stlsq:1'",
        )


def _sharing(solver: AbstractSolver, shared: Bools) -> AbstractSolver:
    """Return the solver with shared coefficients where `shared`, shape (equations, terms)."""
    for equation in np.flatnonzero(shared.any(axis=1)):
        equal = tuple(int(term) for term in np.flatnonzero(shared[equation]))
        solver = ConstrainedSolver(solver, equal, equation=int(equation))
    return solver


@documented
@dataclass(frozen=True, kw_only=True)
class DiscreteTimeRegression(AbstractRegression):
    """Regression of the next sample on terms of the present one: ``x[k+1] = f(x[k])``. Supports streams.

    Raises `CommonlawError` if a text names nothing, or a value does not fit.

    Parameters
    ----------
    {parameters}
    """

    orders: ClassVar[tuple[int, ...]] = (0,)

    def formulation(self, trials: Trials | None, structure: ModelStructure) -> DiscreteForm:
        return DiscreteForm()

    def initial_rates(self, trials: Trials | None, order: Order) -> None:
        return None


@documented
@dataclass(frozen=True, kw_only=True)
class DerivativeRegression(AbstractRegression):
    """Regression of derivatives, estimated from the samples, on terms (SINDy; Brunton, Proctor, Kutz 2016).

    With a group solver this is the method of de Silva, Higdon, Brunton and Kutz (2020). It takes streams.

    Raises `CommonlawError` if a text names nothing, or a value does not fit.

    Parameters
    ----------
    {parameters}

    Examples
    --------
    >>> from commonlaw import DerivativeRegression, datasets, discover
    >>> from commonlaw.law import average_law
    >>> drops = datasets.linear_drag(noise=0.0)
    >>> method = DerivativeRegression(differentiation="finite:6", solver="group-stlsq:1")
    >>> average_law(discover(drops, order=2, library="poly:1", method=method)).equations()
    ("x'' = -9.8 - 0.38 v",)
    """

    orders: ClassVar[tuple[int, ...]] = (1, 2)
    takes_mixed_orders: ClassVar[bool] = True
    takes_derivatives: ClassVar[bool] = True

    differentiation: AbstractDifferentiator | str | None = setting(
        default=None,
        label="Differentiation",
        metavar="SPEC",
        text="How derivatives are estimated, or its text: savgol:WINDOW:POLYNOMIAL, centered, forward, "
        "finite:ACCURACY, spline, median:WINDOW, wiener:WINDOW, spectral, tv:STRENGTH, robust. By default finite:2 "
        "for order 1, savgol:35:3 for order 2, shorter where trials are short, and robust where neither suits.",
    )
    library_states: Literal["smoothed", "measured"] = setting(
        default="smoothed",
        label="Evaluated states",
        text="Whether terms are evaluated on the smoothed or on the measured states, see `StrongForm`.",
    )
    trim: int = setting(
        default=0,
        label="Trimmed rows",
        text="Number of rows left out at each end of a trial, where smoothing is least accurate.",
    )

    def _check(self) -> None:
        object.__setattr__(self, "differentiation", parsed(self.differentiation, parse_differentiation))
        if self.differentiation is not None:
            check_type("differentiation", self.differentiation, AbstractDifferentiator, "a differentiation or its text")
        self._form(self.initial_rates(None, 1), 1)  # Refuses states and trims that do not fit

    def formulation(self, trials: Trials | None, structure: ModelStructure) -> StrongForm | GivenForm:
        if structure.derivatives is not None:
            return GivenForm(structure.derivatives)
        return self._form(self.initial_rates(trials, structure.order), structure.order)

    def initial_rates(self, trials: Trials | None, order: Order) -> AbstractDifferentiator:
        return parsed(self.differentiation, parse_differentiation) or suitable_differentiation(trials, order)

    def _form(self, differentiation: AbstractDifferentiator, order: Order) -> StrongForm:
        return StrongForm(differentiation, order, self.library_states, self.trim)


def suitable_differentiation(trials: Trials | None, order: Order) -> AbstractDifferentiator:
    """Return the default differentiation, by the lengths and gaps of trials."""
    given = trials or ()
    method = default_differentiation(highest_order(order), min(map(len, given), default=np.inf))
    suits = all(method.takes(trial.times, trial.states) for trial in given)
    return method if suits else parse_differentiation("robust")


@documented
@dataclass(frozen=True, kw_only=True)
class WeakRegression(AbstractRegression):
    """Regression in weak form: terms are integrated against test functions (weak SINDy; Messenger and Bortz 2021).

    Rows are whitened by their covariance (Bortz, Messenger and Dukic 2023), see `WeakForm`.

    Raises `CommonlawError` if a text names nothing, or a value does not fit.

    Parameters
    ----------
    {parameters}
    """

    orders: ClassVar[tuple[int, ...]] = (1, 2)

    radii: tuple[float, ...] | None = setting(
        default=None,
        label="Radii [samples]",
        text="Radii of the test functions in samples; by default one for each trial, by its spectrum.",
    )
    noise: Mapping[str, float] | None = setting(
        default=None,
        label="Measurement noise",
        metavar="STATE=VALUE",
        text="Known standard deviation of each state's measurement noise; estimated for each trial by default.",
    )
    differentiation: AbstractDifferentiator | str | None = setting(
        default=None,
        label="Smoothing",
        metavar="SPEC",
        text="How states are smoothed before terms are evaluated on them, and where the rates of laws of second "
        "order come from, or its text, such as spline.",
    )

    def _check(self) -> None:
        object.__setattr__(self, "differentiation", parsed(self.differentiation, parse_differentiation))
        check_types(WeakRegression, vars(self))
        WeakForm(radii=self.radii)  # Refuses radii that do not fit

    def find_by_file(self, stream: TrialStream, structure: ModelStructure, progress: ProgressCallback) -> Law:
        raise CommonlawError("stream-unsupported", method=type(self).__name__)

    def formulation(self, trials: Trials | None, structure: ModelStructure) -> WeakForm:
        assert trials is not None
        levels = known_noise(self.noise, trials)
        noise = None if levels is None else tuple(levels.tolist())
        differentiation = parsed(self.differentiation, parse_differentiation)
        form = WeakForm(highest_order(structure.order), self.radii, noise, differentiation)
        return reweight(trials, structure.terms(trials.schema), form)[0]

    def initial_rates(self, trials: Trials | None, order: Order) -> AbstractDifferentiator:
        return parsed(self.differentiation, parse_differentiation) or suitable_differentiation(trials, order)
