"""Solvers: from one least-squares problem per object to sparse coefficients."""

from collections.abc import Callable, Mapping

from commonlaw.errors import CommonlawError, check_choice
from commonlaw.runtime.arguments import checks_types, parse_spec
from commonlaw.solvers.base import AbstractSolver, Candidate
from commonlaw.solvers.constrained import ConstrainedSolver, constrained_least_squares
from commonlaw.solvers.lasso import Lasso
from commonlaw.solvers.sr3 import SR3
from commonlaw.solvers.stlsq import L1, L2, STLSQ, AbstractImportance, Count, Mean, Median, Quantile
from commonlaw.solvers.subset_selection import BestSubset, StepwiseSelection

__all__ = [
    "IMPORTANCES",
    "L1",
    "L2",
    "SOLVERS",
    "SR3",
    "STLSQ",
    "AbstractImportance",
    "AbstractSolver",
    "BestSubset",
    "Candidate",
    "ConstrainedSolver",
    "Count",
    "Lasso",
    "Mean",
    "Median",
    "Quantile",
    "StepwiseSelection",
    "constrained_least_squares",
    "parse_solver",
]

IMPORTANCES: Mapping[str, Callable[..., AbstractImportance]] = {
    "l1": L1,
    "l2": L2,
    "mean": Mean,
    "median": Median,
    "quantile": Quantile,
    "count": Count,
}


def _stlsq(
    threshold: float | None = None, ridge: float = 0.0, max_iterations: int = 10, normalize: bool = False
) -> STLSQ:
    return STLSQ(threshold, shared=False, ridge=ridge, max_iterations=max_iterations, normalize=normalize)


def _group_stlsq(
    threshold: float | None = None,
    importance: str = "l1",
    level: float | None = None,
    ridge: float = 0.0,
    max_iterations: int = 10,
    normalize: bool = False,
) -> STLSQ:
    """Make an `STLSQ` with an importance given by its name, and the level of a quantile or of a vote."""
    check_choice("importance", importance, IMPORTANCES)
    if level is not None and importance not in ("quantile", "count"):
        raise CommonlawError("importance-without-level", importance=importance)
    measure = IMPORTANCES[importance]() if level is None else IMPORTANCES[importance](level)
    return STLSQ(threshold, True, measure, ridge, max_iterations, normalize)


def _forward(terms: int | None = None, shared: bool = True) -> StepwiseSelection:
    return StepwiseSelection(terms, "forward", shared)


def _backward(terms: int | None = None, shared: bool = True) -> StepwiseSelection:
    return StepwiseSelection(terms, "backward", shared)


SOLVERS: Mapping[str, Callable[..., AbstractSolver]] = {
    "stlsq": _stlsq,
    "group-stlsq": _group_stlsq,
    "best-subset": BestSubset,
    "forward": _forward,
    "backward": _backward,
    "lasso": Lasso,
    "sr3": SR3,
}
"""What makes a solver from the arguments of its text."""


@checks_types
def parse_solver(text: str) -> AbstractSolver:
    """Make a solver from text: ``stlsq:0.04``, ``best-subset:3``, ``group-stlsq:0.2:quantile:0.25``.

    Raises `CommonlawError` if there is no such solver, or its arguments do not fit.

    Examples
    --------
    >>> parse_solver("group-stlsq:1.5")
    STLSQ(threshold=1.5, shared=True, importance=L1(), ridge=0.0, max_iterations=10, normalize=False)
    """
    return parse_spec("solver", text, SOLVERS)
