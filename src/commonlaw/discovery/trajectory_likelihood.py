"""States and coefficients fitted together to what was measured, terms chosen by their evidence."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

from commonlaw.diagnostics import Diagnostic
from commonlaw.discovery.candidate_search import CandidateSearch
from commonlaw.discovery.method import AbstractMethod, parsed, refuse_what_does_not_fit
from commonlaw.discovery.model_structure import ModelStructure
from commonlaw.discovery.pipeline import law_of_best_order
from commonlaw.errors import CommonlawError
from commonlaw.law import Law
from commonlaw.library import order_of_each
from commonlaw.runtime.fit_options import FitOptions, documented
from commonlaw.runtime.parallel import threads
from commonlaw.runtime.progress import ProgressCallback
from commonlaw.solvers import parse_solver
from commonlaw.stream.proposals import Fitting, law_of_parts
from commonlaw.trials import Trials, TrialStream


@documented
@dataclass(frozen=True, kw_only=True)
class TrajectoryLikelihood(FitOptions, AbstractMethod):
    """Maximum likelihood of whole trajectories with free initial states; supports are compared by their evidence.

    The law knows how accurate it is. See `commonlaw.inference`, and docs/method for every formula.

    Parameters
    ----------
    {parameters}

    Raises
    ------
    CommonlawError
        If a text names nothing, or a value does not fit.
    """

    orders: ClassVar[tuple[int, ...]] = (1, 2)
    takes_mixed_orders: ClassVar[bool] = True
    takes_streams: ClassVar[bool] = True
    takes_noise_columns: ClassVar[bool] = True
    takes_parameters: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        solver = parsed(self.solver, parse_solver)
        if solver is not None and solver.hyperparameter is not None:
            raise CommonlawError("solver-with-value", solver=solver)
        object.__setattr__(self, "solver", solver)

    def find(self, trials: Trials | TrialStream, structure: ModelStructure, progress: ProgressCallback) -> Law:
        if isinstance(trials, TrialStream):
            return self._of_parts(trials, structure, progress)
        orders = order_of_each(structure.order, len(trials.schema.states))
        return self.find_order(trials, structure, [(each,) for each in orders], progress)

    def find_order(
        self,
        trials: Trials,
        structure: ModelStructure,
        possible: Sequence[Sequence[int]],
        progress: ProgressCallback,
    ) -> Law:
        """Return the law of largest evidence among those of several orders, see `law_of_best_order`."""
        refuse_what_does_not_fit(self, trials, structure)
        with threads(self.n_jobs):
            return law_of_best_order(CandidateSearch(trials, self, progress), structure, possible)

    def _of_parts(self, trials: TrialStream, structure: ModelStructure, progress: ProgressCallback) -> Law:
        """Return the law of objects that are fitted part by part, under white noise if nothing else is named."""
        refuse_what_does_not_fit(self, trials, structure)
        inside = structure.parametric(trials.schema) or structure.ratios(trials.schema)
        if inside or self.unmeasured:
            what = "unmeasured=1" if self.unmeasured else "a term with nonlinear parameters"
            raise CommonlawError("stream-with-option", what=what)
        errors = "white" if self.errors == "auto" else self.errors
        return law_of_parts(
            trials,
            partial(_found_in, replace(self, errors=errors, covariance="likelihood", partial_pooling=False), structure),
            Fitting(
                noise=self.noise,
                errors=errors,
                huber_threshold=self.huber_threshold,
                covariance=self.covariance,
                seed=self.seed,
            ),
            structure.universal_in,
            self.partial_pooling,
            progress,
        )


def with_unmeasured(method: AbstractMethod, count: int) -> AbstractMethod:
    """Return the method that looks for so many latent states, too."""
    if not count:
        return method
    if not isinstance(method, TrajectoryLikelihood):
        name = type(method).__name__
        remedy = Diagnostic("leave-out" if 0 in method.orders else "use-trajectory-likelihood")
        raise CommonlawError("latent-states-unsupported", count=count, method=name, remedy=remedy)
    return replace(method, unmeasured=count)


def _found_in(method: TrajectoryLikelihood, structure: ModelStructure, trials: Trials) -> Law:
    return method.find(trials, structure, lambda _: None)
