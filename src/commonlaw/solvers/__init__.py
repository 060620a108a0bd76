"""Solvers: from one system per object to sparse coefficients."""

from collections.abc import Callable, Mapping

from commonlaw.errors import CommonlawError, unknown
from commonlaw.solvers.backward import BackwardElimination
from commonlaw.solvers.base import AbstractSolver, Candidate, Fit
from commonlaw.solvers.best_subset import BestSubset
from commonlaw.solvers.constrained import Constrained, constrained_least_squares
from commonlaw.solvers.forward import ForwardSelection
from commonlaw.solvers.group_stlsq import GroupSTLSQ
from commonlaw.solvers.importance import L1, L2, AbstractImportance, Count, Mean, Median, Quantile
from commonlaw.solvers.lasso import Lasso
from commonlaw.solvers.sr3 import SR3
from commonlaw.solvers.stlsq import STLSQ
from commonlaw.spec import parse_spec

__all__ = [
    "IMPORTANCES",
    "L1",
    "L2",
    "SOLVERS",
    "SR3",
    "STLSQ",
    "AbstractImportance",
    "AbstractSolver",
    "BackwardElimination",
    "BestSubset",
    "Candidate",
    "Constrained",
    "Count",
    "Fit",
    "ForwardSelection",
    "GroupSTLSQ",
    "Lasso",
    "Mean",
    "Median",
    "Quantile",
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


def _group_stlsq(
    threshold: float | None = None,
    importance: str = "l1",
    level: float | None = None,
    ridge: float = 0.0,
    max_iterations: int = 10,
    normalize: bool = False,
) -> GroupSTLSQ:
    """Make a `GroupSTLSQ` with an importance given by its name, and the level of a quantile or of a vote."""
    if importance not in IMPORTANCES:
        raise unknown("importance", importance, IMPORTANCES)
    if level is not None and importance not in ("quantile", "count"):
        raise CommonlawError(f"importance {importance!r} takes no level")
    measure = IMPORTANCES[importance]() if level is None else IMPORTANCES[importance](level)
    return GroupSTLSQ(threshold, measure, ridge, max_iterations, normalize)


SOLVERS: Mapping[str, Callable[..., AbstractSolver]] = {
    "stlsq": STLSQ,
    "group-stlsq": _group_stlsq,
    "best-subset": BestSubset,
    "forward": ForwardSelection,
    "backward": BackwardElimination,
    "lasso": Lasso,
    "sr3": SR3,
}


def parse_solver(text: str) -> AbstractSolver:
    """Make a solver from text: ``stlsq:0.04``, ``best-subset:3``, ``group-stlsq:0.2:quantile:0.25``.

    >>> parse_solver("group-stlsq:1.5")
    GroupSTLSQ(threshold=1.5, importance=L1(), ridge=0.0, max_iterations=10, normalize=False)
    """
    return parse_spec("solver", text, SOLVERS)
