"""Everything that can be set about a fit of trajectories."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from commonlaw.discovery.method import parsed
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.inference import MAX_SAMPLES, CovarianceKind, ErrorKind
from commonlaw.integration import BETWEEN
from commonlaw.likelihood import HUBER_THRESHOLD, ObservationModel
from commonlaw.runtime.arguments import check_whole_number
from commonlaw.runtime.parallel import check_n_jobs
from commonlaw.solvers import AbstractSolver, parse_solver


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """What can be set about a fit of trajectories, see `TrajectoryLikelihood`, whose fields these are.

    Raises
    ------
    CommonlawError
        If a text names nothing, or a value does not fit.
    """

    positive: Sequence[str] = ()
    input_between: str = "auto"
    noise: Mapping[str, float] | None = None
    errors: ErrorKind | Literal["auto"] = "auto"
    huber_threshold: float = HUBER_THRESHOLD
    covariance: CovarianceKind = "likelihood"
    partial_pooling: bool = True
    solver: AbstractSolver | str | None = None
    max_samples: int = MAX_SAMPLES
    unmeasured: int = 0
    seed: int = 0
    n_jobs: int = field(default=-1, compare=False)

    def __post_init__(self) -> None:
        check_whole_number("seed", self.seed, 0)
        check_n_jobs(self.n_jobs)
        check_whole_number("unmeasured", self.unmeasured, 0, 1)
        check_whole_number("max_samples", self.max_samples, 100, 10**9)
        check_choice("covariance", self.covariance, get_args(CovarianceKind))
        check_choice("errors", self.errors, ("auto", *get_args(ErrorKind)))
        check_choice("input_between", self.input_between, ("auto", *BETWEEN))
        ObservationModel(np.ones(1), self.huber_threshold)  # Refuses thresholds that do not fit
        solver = parsed(self.solver, parse_solver)
        if solver is not None and solver.hyperparameter is not None:
            raise CommonlawError("solver-with-value", solver=solver)
        object.__setattr__(self, "solver", solver)
