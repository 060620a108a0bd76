"""What may be counted in any unit without a change of what is measured: the scale of a state that nobody measured."""

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.integration import VectorField
from commonlaw.library import Terms

_POINTS = 12
"""Points, for each coefficient, at which the derivatives of a law are compared."""

_TOLD = 1e-6
"""Of a change, what coefficients do not make up for; less is rounding."""


def may_be_rescaled(terms: Terms, known: Floats, states: Bools) -> Bools:
    """Return which of some states, shape (states,), could be counted in another unit with other coefficients.

    That is so if scaling the state turns the law into one of the same terms (a Lie symmetry of the equations): twice
    the state, and other coefficients, leave the others as they are. Other states among these may change their units,
    too.

    Parameters
    ----------
    terms
        Over states of a law of first order.
    known
        Coefficients that are known, shape (equations, terms), NaN where they are to be found.
    states
        Of these, each of which starts at zero.
    """
    indices, free = np.flatnonzero(states), np.isnan(known)
    if not len(indices):
        return np.zeros(len(states), dtype=np.bool_)
    random = np.random.default_rng(0)
    coefficients = np.where(free, random.uniform(0.5, 1.5, known.shape), known)
    field = VectorField(terms, coefficients, free=free)
    points = random.uniform(0.5, 1.5, (_POINTS * (1 + int(free.sum())), len(terms.variables.measured)))
    linear = field.linearize(points)
    changes = -linear.by_states * points[:, np.newaxis, : len(states)]
    changes[:, range(len(states)), range(len(states))] += linear.derivatives
    blocks = linear.by_parameters, changes[:, :, indices]
    columns = np.column_stack([each.reshape(-1, each.shape[2]) for each in blocks])
    norms = np.linalg.norm(columns, axis=0)
    columns = columns / np.where(norms > 0, norms, 1.0)
    found = np.zeros(len(states), dtype=np.bool_)
    for i, index in enumerate(indices):
        own = free.sum() + i
        others = np.delete(columns, own, axis=1)
        left = columns[:, own] - others @ np.linalg.lstsq(others, columns[:, own])[0]
        found[index] = bool(np.linalg.norm(left) < _TOLD)
    return found
