"""What the equations of a law are called, and their right-hand sides."""

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.integration import VectorField
from commonlaw.law import text
from commonlaw.law.law import Law, object_index, shares_terms
from commonlaw.library import with_rates


def left_hand_sides(law: Law) -> tuple[str, ...]:
    """Return what each equation gives: ``x'``, ``x''``, or ``x[k+1]`` in discrete time."""
    return text.left_hand_sides(law.schema.states, law.order)


def rate_names(law: Law) -> tuple[str, ...]:
    """Return the names of the rates of the states of second order."""
    return law.terms.variables.states[len(law.schema.states) :]


def state_rates(law: Law) -> tuple[tuple[str, str], ...]:
    """Return the names of the states of second order, each with that of its rate."""
    second = (law.schema.states[j] for j in with_rates(law.order, len(law.schema.states)))
    return tuple(zip(second, rate_names(law), strict=True))


def vector_field(law: Law, name: str) -> VectorField:
    """Return the right-hand side of one object as forecasts follow it, ready to integrate."""
    free = law.support if shares_terms(law) else None
    return VectorField(law.terms, _followed_coefficients(law, name), law.order, free=free)


def right_hand_side(law: Law, name: str, values: ArrayLike) -> Floats:
    """Return the highest derivatives of one object, see `Law.rhs`."""
    coefficients, variables = _followed_coefficients(law, name), law.terms.variables
    points, names = np.asarray(values, dtype=np.float64), variables.measured
    time = variables.index(variables.time)
    if points.ndim == 2 and points.shape[1] == len(names) - 1:
        used = np.flatnonzero(law.support.any(axis=0))
        if not any(time in law.terms.terms[k].columns() for k in used):
            points = np.insert(points, time, 0.0, axis=1)
    if points.ndim != 2 or points.shape[1] != len(names):
        raise CommonlawError("variables-shape", shape=points.shape, names=names)
    return np.asarray(law.terms.evaluate(law.terms.at(points, coefficients)) @ coefficients.T)


def _followed_coefficients(law: Law, name: str) -> Floats:
    """Return the coefficients that forecasts of an object follow: pooled ones if the law has them."""
    pooled, index = law.uncertainty.pooled, object_index(law, name)
    coefficients: Floats = law.coefficients[index].copy()
    if pooled is not None:
        coefficients[law.support] = pooled.coefficients[index]
    return coefficients
