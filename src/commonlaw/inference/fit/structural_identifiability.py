"""Structural identifiability of latent states by Lie symmetries of the equations (Yates, Evans and Chappell 2009).

A transformation ``x -> x + eps xi(x)`` of latent states is a symmetry of ``x' = f(x, theta)`` if other coefficients
undo it, to first order: if for some delta

    xi' f - f' xi + (df/dtheta) delta = 0    at all x,

which is tested for linear dependence at generic points. Scale (xi = x_i), origin (xi = 1) or mixture with another state
(xi = x_j) of such a latent state are not identifiable.
"""

from dataclasses import replace
from typing import Literal

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.formulation import column_scales
from commonlaw.inference.settings import GENERIC_POINTS, MAX_RELATIVE_DIFFERENCE, MIN_SINGULAR_VALUE, ROUNDING
from commonlaw.integration import VectorField
from commonlaw.integration.vector_field import LinearizedField
from commonlaw.library import Terms, highest_columns, with_rates
from commonlaw.library.sizes import likely_sizes


def has_symmetry(
    kind: Literal["scaling", "translation", "mixing"], terms: Terms, known: Floats, states: Bools, sizes: Floats
) -> Bools:
    """Return which of the states to test have a symmetry, shape (states,), alone or with others of them.

    Coefficients undo the addition of a share of the state itself, a constant, or a share of any state or a constant.
    Initial values of states to be rescaled are zero or free, of others free. Fixed coefficients have shape (equations,
    terms), NaN for free ones. Sizes of measured variables, shape (variables,), are NaN where they follow from the
    equations: generic points are where all terms matter, whatever the units.
    """
    free, width, changes = np.isnan(known), len(terms.variables.states), list[tuple[int, int | None]]()
    for i in np.flatnonzero(states).tolist():
        added = {"scaling": (i,), "translation": (None,), "mixing": (None, *range(width))}
        changes += [(i, by) for by in added[kind]]
    invariant = np.zeros(len(known), dtype=np.bool_)
    if not changes:
        return invariant
    linear, points = _at_generic_points(terms, known, sizes, len(changes))
    columns = [linear.by_parameters.reshape(len(points) * width, -1 if free.any() else 0)]
    for i, by in changes:
        tangent = -linear.by_states[:, :, i] * (1.0 if by is None else points[:, [by]])
        if by is not None:
            tangent[:, i] += linear.derivatives[:, by]
        columns.append(tangent.reshape(-1, 1))
    matrix = np.column_stack(columns)
    norms = np.linalg.norm(matrix, axis=0)
    matrix = matrix / np.where(norms > 0, norms, 1.0)
    for k, (i, _) in enumerate(changes):
        tangent = matrix[:, free.sum() + k]
        others = np.delete(matrix, free.sum() + k, axis=1)
        residual = tangent - others @ np.linalg.lstsq(others, tangent)[0]
        invariant[i] |= bool(np.linalg.norm(residual) < ROUNDING)
    return invariant


def are_confounded(terms: Terms, known: Floats, sizes: Floats) -> Bools:
    """Return the coefficients that are identifiable in combination only, shape (equations, terms), as f and k in f k.

    They are those in null directions of the derivatives of the rates at generic points.
    """
    linear, points = _at_generic_points(terms, known, sizes)
    free = np.isnan(known)
    columns = linear.by_parameters.reshape(len(points) * len(terms.variables.states), -1)
    _, singular, directions = np.linalg.svd(columns / column_scales(columns), full_matrices=False)
    combined = np.zeros(known.shape, dtype=np.bool_)
    combined[free] = np.linalg.norm(directions[singular < MIN_SINGULAR_VALUE], axis=0) > MAX_RELATIVE_DIFFERENCE
    return combined


def _at_generic_points(terms: Terms, known: Floats, sizes: Floats, changes: int = 0) -> tuple[LinearizedField, Floats]:
    """Return the equations, linearized at random points where all terms matter, and these, shape (n, variables)."""
    random, free = np.random.default_rng(0), np.isnan(known)
    typical, values = _typical_sizes(terms, known, sizes)
    coefficients = np.where(free, random.uniform(0.5, 1.5, known.shape) * typical, known)
    natural = replace(terms, variables=replace(terms.variables, logarithmic=()))
    field = VectorField(natural, coefficients, terms.variables.order_of(len(known)), free=free)
    points = values * random.uniform(0.5, 1.5, (GENERIC_POINTS * (changes + int(free.sum())), len(values)))
    return field.linearize(points), points


def _typical_sizes(terms: Terms, known: Floats, sizes: Floats) -> tuple[Floats, Floats]:
    """Return typical sizes of coefficients, shape (equations, terms), and of measured variables, shape (variables,)."""
    first, count, states = len(sizes), len(terms.variables.names), len(known)
    order, names = terms.variables.order_of(states), [f"v{i}" for i in range(count)]
    free = np.isnan(known) & terms.is_factor
    before = {(j, k): f"v{count + i}" for i, (j, k) in enumerate(np.argwhere(free).tolist())}
    written = ["0.0"] * states
    for j, k in np.argwhere(known != 0).tolist():
        if terms.is_factor[k]:
            written[j] += f" + ({before.get((j, k), repr(float(known[j, k])))})*({terms.terms[k].expression(names)})"
    equations = list(zip(written, highest_columns(order, states).tolist(), strict=True))
    equations += [(f"v{states + i}", j) for i, j in enumerate(with_rates(order, states).tolist())]
    inside = known[:, list(terms.parameters)].sum(axis=0)
    given = dict(enumerate(np.abs([*sizes, *inside]).tolist()))
    usable = {i: size for i, size in given.items() if 0 < size < np.inf}
    solved = likely_sizes(equations, usable, count + len(before), usable.get(first - 1, 1.0))
    typical = np.ones(known.shape)
    typical[free] = solved[count:]
    typical[:, list(terms.parameters)] = solved[first:count]
    return typical, solved[:first]
