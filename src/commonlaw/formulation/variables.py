"""The variables of a law over trials of some schema."""

from commonlaw.library import Variables
from commonlaw.trials import Schema


def law_variables(schema: Schema, order: int) -> Variables:
    """Return the variables of a law: states, their rates if it is of order 2, inputs, time."""
    rates = rate_names(schema) if order == 2 else ()
    return Variables((*schema.states, *rates), schema.inputs, schema.time)


def rate_names(schema: Schema) -> tuple[str, ...]:
    """Return the names of the states' rates: ``v`` for a single state, ``v_x`` and ``v_y`` for several."""
    plain = ["v"] if len(schema.states) == 1 else [f"v_{state}" for state in schema.states]
    taken = {*schema.states, *schema.inputs, schema.time}
    return tuple(f"{state}_rate" if name in taken else name for name, state in zip(plain, schema.states, strict=True))
