"""The variables of a law over trials of some schema."""

from commonlaw.errors import CommonlawError
from commonlaw.library import Variables
from commonlaw.trials import Schema


def law_variables(schema: Schema, order: int) -> Variables:
    """Return the variables of a law: states, their rates if it is of order 2, inputs, time.

    Rates are ``v`` for a single state, ``v_x`` and ``v_y`` for several, and ``x_rate`` where such a name is taken; a
    rate that was measured has the name of its column.
    """
    if order < 2:
        return Variables(schema.states, schema.inputs, schema.time, schema.logarithmic)
    taken = {*schema.states, *schema.inputs, schema.time}
    pairs = zip(plain_rates(schema), schema.states, strict=True)
    rates = [f"{state}_rate" if name in taken else name for name, state in pairs]
    return Variables((*schema.states, *rates), schema.inputs, schema.time)


def plain_rates(schema: Schema) -> tuple[str, ...]:
    """Return the names of the rates of states: of their columns if they were measured, or the usual ones."""
    usual = ["v"] if len(schema.states) == 1 else [f"v_{state}" for state in schema.states]
    return tuple(schema.rates.get(state, name) for state, name in zip(schema.states, usual, strict=True))


def check_order(order: int) -> None:
    """Refuse an order of a law that is neither 1 nor 2."""
    if order not in (1, 2):
        raise CommonlawError(f"order {order!r} is not supported: give the number 1 (x' = ...) or 2 (x'' = ...)")
