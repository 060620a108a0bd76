"""Simple functions of the coordinate that would say what a smooth function says, by their evidence."""

from collections.abc import Callable
from itertools import combinations

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.discrepancy.function import Description
from commonlaw.discrepancy.smooth_basis import SmoothBasis
from commonlaw.discrepancy.trajectories import FunctionFit

_FUNCTIONS: tuple[tuple[str, Callable[[Floats], Floats]], ...] = (
    ("1", np.ones_like),
    ("{0}", lambda u: u),
    ("{0}^2", np.square),
    ("{0}^3", lambda u: u**3),
    ("abs({0})", np.abs),
    ("{0} abs({0})", lambda u: u * np.abs(u)),
    ("sqrt(abs({0}))", lambda u: np.sqrt(np.abs(u))),
)

_NEW = 1e-3
"""Share of a function that the law's own terms do not say, nor a simpler function; less says nothing new."""

_SHOWN = 5


def descriptions(fitted: FunctionFit, basis: SmoothBasis, visited: Floats) -> tuple[Description, ...]:
    """Return simple functions, and pairs of these, the largest evidence first.

    Parameters
    ----------
    fitted
        With the smooth function.
    basis
        Of it.
    visited
        The coordinate at all samples, shape (n,).
    """
    values, rows = basis.values(visited), fitted.rows
    names, columns = list[str](), list[Floats]()
    for name, function in _FUNCTIONS:
        weights = np.linalg.lstsq(values, function(visited), rcond=1e-10)[0]
        column = rows.shared @ weights
        size = np.sqrt(column @ column + sum(np.sum((each.across @ weights) ** 2) for each in rows.objects))
        rests = [column, *(column - each * (each @ column) / (each @ each) for each in columns)]
        if min(np.linalg.norm(rest) for rest in rests) > _NEW * size:
            names.append(name)
            columns.append(column)
    groups = [*((i,) for i in range(len(names))), *combinations(range(len(names)), 2)]
    found = [
        _described(fitted, basis, [names[i] for i in group], np.array([columns[i] for i in group]).T)
        for group in groups
    ]
    return tuple(sorted(found, key=lambda each: -each.evidence)[:_SHOWN])


def _described(fitted: FunctionFit, basis: SmoothBasis, names: list[str], columns: Floats) -> Description:
    rows = fitted.rows
    factors, _, _, _ = np.linalg.lstsq(columns, rows.target, rcond=None)
    squares = np.array(rows.rest + np.sum((rows.target - columns @ factors) ** 2))
    price = len(names) * np.log(rows.numbers)
    value = float(rows.deviance(squares, fitted.noise_measurements)) + price
    variance = float(rows.variance(squares, fitted.noise_measurements))
    errors = np.sqrt(variance) * np.linalg.norm(np.linalg.pinv(columns), axis=1)
    of = basis.coordinate if basis.coordinate.isidentifier() else f"({basis.coordinate})"
    front = "" if basis.times == "1" else f"{basis.times} "
    texts = tuple((front + each.format(of)).removesuffix(" 1") for each in names)
    evidence = fitted.posterior.value - value
    return Description(texts, tuple(factors.tolist()), tuple(errors.tolist()), evidence)
