"""Units of the coefficients of a law."""

from typing import TYPE_CHECKING

import numpy as np

from commonlaw.library import term_unit
from commonlaw.trials.units import parse_unit

if TYPE_CHECKING:
    from commonlaw.law.law import Law


def coefficient_units(law: "Law") -> dict[tuple[str, str], str]:
    """Return the unit of each coefficient in the law: that of the left-hand side over that of the term.

    Keys are equation and term, ``("x''", "v")``. Coefficients whose unit does not follow from the units of the
    variables are left out.
    """
    if not {*law.states, law.schema.time} <= law.schema.units.keys():
        return {}
    time = parse_unit(law.schema.units[law.schema.time])
    units = dict(law.schema.units)
    for state, rate in zip(law.states, law.rates, strict=False):
        units[rate] = f"{parse_unit(law.schema.units[state]) / time}"
    found = {}
    for j, k in np.argwhere(law.support):
        below = term_unit(law.terms.terms[k], law.terms.variables, units)
        if below is not None:
            left = parse_unit(law.schema.units[law.states[j]]) / time**law.order
            found[law.left_hand_sides[j], law.terms.names[k]] = f"{left / below:~P}"
    return found
