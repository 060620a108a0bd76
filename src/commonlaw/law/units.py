"""Units of the coefficients of a law."""

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.library import Terms, term_unit
from commonlaw.trials import Schema
from commonlaw.trials.units import parse_unit


def coefficient_units(terms: Terms, schema: Schema, order: int, support: Bools) -> dict[tuple[int, int], str]:
    """Return the unit of each coefficient in the support: that of the left-hand side over that of the term.

    By the indices of equation and term; coefficients whose unit does not follow from those of variables are left out.
    """
    states = schema.states
    if not {*states, schema.time} <= schema.units.keys():
        return {}
    time = parse_unit(schema.units[schema.time])
    units = dict(schema.units)
    for state, rate in zip(states, terms.variables.states[len(states) :], strict=False):
        units[rate] = f"{parse_unit(schema.units[state]) / time}"
    found = {}
    for j, k in np.argwhere(support):
        below = term_unit(terms.terms[k], terms.variables, units)
        if below is not None:
            left = parse_unit(schema.units[states[j]]) / time**order
            found[int(j), int(k)] = f"{left / below:~P}"
    return found
