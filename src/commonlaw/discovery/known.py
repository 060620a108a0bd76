"""Terms and states named by users: where they stand, and what is known of them."""

from collections.abc import Mapping, Sequence

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, unknown
from commonlaw.library import Terms

Key = str | tuple[str, str]
"""A term, with the state of its equation before it when there are several."""

Fixed = Mapping[Key, float | Mapping[str, float]]


def known_coefficients(fixed: Fixed, states: Sequence[str], objects: Sequence[str], terms: Terms) -> Floats:
    """Return the coefficients that are known, shape (objects, equations, terms), NaN where they are to be found."""
    known = np.full((len(objects), len(states), len(terms)), np.nan)
    for key, value in fixed.items():
        equation, index = place_of(key, states, terms)
        term = terms.names[index]
        values = value if isinstance(value, Mapping) else dict.fromkeys(objects, value)
        missing = [name for name in objects if name not in values]
        if missing:
            raise CommonlawError(
                f"fixed term {term!r} has no coefficient for {', '.join(missing)}; give one for each object"
            )
        known[:, equation, index] = [values[name] for name in objects]
    return known


def place_of(key: Key, states: Sequence[str], terms: Terms) -> tuple[int, int]:
    """Return the places of the equation and the term that a key names."""
    if not isinstance(key, tuple) and len(states) > 1:
        raise CommonlawError(f"term {key!r}: say of which equation, as ({states[0]!r}, {key!r})")
    state, term = key if isinstance(key, tuple) else (states[0], key)
    if state not in states:
        raise unknown("state", state, states)
    return states.index(state), terms.index(term)
