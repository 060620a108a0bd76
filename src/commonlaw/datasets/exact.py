"""Exact trajectories and exact laws of simulated data sets."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.datasets.experiment import NormalSource, Path
from commonlaw.errors import CommonlawError
from commonlaw.trials import Schema

if TYPE_CHECKING:
    from commonlaw.law import Law


_TOLERANCE = 1e-11


def trajectory(field: Callable[[float, Floats], Floats], initial: ArrayLike, times: Floats, name: str) -> Floats:
    """Return the states at `times`, shape (n, d), of the object `name` that moves by ``y' = field(t, y)``."""
    from commonlaw.integration import integrate

    result = integrate(field, np.asarray(initial, dtype=np.float64), times, relative_tolerance=_TOLERANCE, where=name)
    if result.outcome is not None:
        raise CommonlawError("simulation-failed", name=name, reason=result.outcome.text)
    return result.states


def heights(acceleration: Callable[[float], float], start: float, times: Floats, name: str) -> Floats:
    """Return the heights at `times`, shape (n, 1), of what moves by ``x'' = acceleration(x')`` from rest."""

    def field(_: float, y: Floats) -> Floats:
        return np.array([y[1], acceleration(y[1])])

    return trajectory(field, (start, 0.0), times, name)[:, :1]


def path(
    derivatives: Callable[[tuple[float, ...], Floats], Sequence[float]],
    start: Callable[[tuple[float, ...], NormalSource], Floats],
    coefficients: tuple[float, ...],
    times: Floats,
    name: str,
) -> Path:
    """Return what draws a start and runs from there by ``y' = derivatives(coefficients, y)``."""

    def field(_: float, y: Floats) -> Floats:
        return np.array(derivatives(coefficients, y))

    return lambda source: trajectory(field, start(coefficients, source), times, name)


def law(
    schema: Schema,
    terms: Sequence[str],
    coefficients: Mapping[str, Sequence[Sequence[float]]],
    rates: Sequence[str] = (),
) -> "Law":
    """Return a law that is known, from its terms as expressions, and by object a row of numbers for each equation.

    Of second order it is if there are names of the states' rates.
    """
    from commonlaw.law import Law
    from commonlaw.library import Terms, Variables, parse_term

    variables = Variables((*schema.states, *rates), time=schema.time)
    parsed = Terms(variables, tuple(parse_term(each, variables) for each in terms))
    values = np.array(list(coefficients.values()))
    return Law(parsed, schema, 2 if rates else 1, tuple(coefficients), values)
