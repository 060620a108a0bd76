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
    """Return the states at `times`, shape (n, d), of the object `name` that moves by ``y' = field(t, y)``.

    Raises
    ------
    CommonlawError
        If the object runs away.
    """
    from commonlaw.integration import integrate

    result = integrate(field, np.asarray(initial, dtype=np.float64), times, relative_tolerance=_TOLERANCE, where=name)
    if result.outcome is not None:
        raise CommonlawError(
            f"cannot simulate {name}: {result.outcome.text}; choose other coefficients or a shorter time"
        )
    return result.states


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
    """Return a law that is known.

    Parameters
    ----------
    schema
        Names and units of the states and the time.
    terms
        The terms as expressions: ``"v**2"``.
    coefficients
        By object, a row for each equation and in it a number for each term.
    rates
        Names of the states' rates if the law is of second order, else none.
    """
    from commonlaw.law import Law
    from commonlaw.library import Terms, Variables, parse_term

    variables = Variables((*schema.states, *rates), time=schema.time)
    parsed = Terms(variables, tuple(parse_term(each, variables) for each in terms))
    values = np.array(list(coefficients.values()))
    return Law(parsed, schema, 2 if rates else 1, tuple(coefficients), values)
