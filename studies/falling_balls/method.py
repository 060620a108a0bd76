"""The authors' method, as library calls."""

from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np

from commonlaw.discovery import DerivativeRegression, discover
from commonlaw.law import Law
from commonlaw.law.law import object_index
from commonlaw.solvers import STLSQ, AbstractSolver
from commonlaw.trials import Trials
from studies.falling_balls.settings import DIFFERENTIATION, LIBRARY


def single_law(trials: Trials, threshold: float | None, library: str = LIBRARY, **others: Any) -> Law:
    """Return the law in which each object has its own terms: STLSQ, terms on the smoothed heights.

    Without a threshold the whole path is searched. Other settings are those of `DerivativeRegression`.
    """
    return _law(trials, library, STLSQ(threshold, shared=False), "smoothed", others)


def group_law(trials: Trials, threshold: float | None, library: str = LIBRARY, **others: Any) -> Law:
    """Return the law whose terms all objects share: group STLSQ, terms on the heights as measured.

    Without a threshold the whole path is searched. Other settings are those of `DerivativeRegression`.
    """
    return _law(trials, library, STLSQ(threshold), "measured", others)


METHODS: Mapping[str, Callable[..., Law]] = {"single": single_law, "group": group_law}


def coefficients_of(law: Law, ball: str) -> dict[str, float]:
    """Return the coefficients of the terms that are in a ball's equation, by term."""
    own = law.coefficients[object_index(law, ball)][0]
    return {law.terms.names[k]: float(own[k]) for k in np.flatnonzero(own)}


def _law(
    trials: Trials,
    library: str,
    solver: AbstractSolver,
    states: Literal["smoothed", "measured"],
    others: dict[str, Any],
) -> Law:
    settings = {"differentiation": DIFFERENTIATION, "library_states": states} | others
    return discover(trials, order=2, library=library, method=DerivativeRegression(solver=solver, **settings))
