"""The variables of a law over trials of some schema."""

from commonlaw.errors import CommonlawError
from commonlaw.library import Order, Variables, with_rates
from commonlaw.trials import Schema


def law_variables(schema: Schema, order: Order) -> Variables:
    """Return the variables of a law: states, the rates of those of order 2, inputs, time.

    Rates are ``v`` for a single state, ``v_x`` and ``v_y`` for several, and ``x_rate`` where such a name is taken; a
    rate that was measured has the name of its column.
    """
    second = with_rates(order, len(schema.states))
    if not len(second):
        return Variables(schema.states, schema.inputs, schema.time, schema.logarithmic)
    taken, plain = {*schema.states, *schema.inputs, schema.time}, plain_rates(schema)
    rates = [f"{schema.states[j]}_rate" if plain[j] in taken else plain[j] for j in second]
    orders = order if isinstance(order, tuple) else ()
    return Variables((*schema.states, *rates), schema.inputs, schema.time, orders=orders)


def plain_rates(schema: Schema) -> tuple[str, ...]:
    """Return the names of the rates of states: of their columns if they were measured, or the usual ones."""
    usual = ["v"] if len(schema.states) == 1 else [f"v_{state}" for state in schema.states]
    return tuple(schema.rates.get(state, name) for state, name in zip(schema.states, usual, strict=True))


def check_order(order: int) -> None:
    """Refuse an order of an equation that is neither 1 nor 2."""
    if order not in (1, 2):
        raise CommonlawError("order-one-or-two", order=order)
