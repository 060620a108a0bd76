"""The order of a law where none is given: told by measured rates, or by the evidence for laws of each."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal, TypeVar

from commonlaw.discovery.measured_rates import measured_rates
from commonlaw.errors import CommonlawError
from commonlaw.law import Law, Step
from commonlaw.outcomes import Outcome, OutcomeKind
from commonlaw.trials import Trials
from commonlaw.trials.measured_rates import rates_in_words

Given = TypeVar("Given")
Found = TypeVar("Found")

Order = int | Literal["auto"]
"""Of a law: 1, 2, or 0 in discrete time; ``"auto"`` for the one of 1 and 2 that the measurements tell."""

_STRONG = 6.0
"""2 log B from which evidence is strong (Kass and Raftery 1995)."""


def orders_by_rates(trials: Trials) -> tuple[tuple[int, ...], tuple[Step, ...]]:
    """Return the orders among which the evidence chooses, and what is said where measured rates leave one.

    With every state beside its rate the law is one of second order. With the rates of some states the columns are all
    that laws of first order need, and laws of second order would leave measurements out that these have to explain.
    """
    rates = measured_rates(trials)
    if not rates:
        return (1, 2), ()
    lacking = [name for name in trials.schema.states if name not in rates and name not in rates.values()]
    why = rates_in_words(rates) + (f"; of {', '.join(lacking)} no rate was measured" if lacking else "")
    order = 1 if lacking else 2
    return (order,), (Step("order", str(order), why),)


def of_each_order(find: Callable[[Given], Found], given: Sequence[Given]) -> tuple[list[Found], list[CommonlawError]]:
    """Return what is found for each order, and why nothing is found for others.

    Raises
    ------
    CommonlawError
        If nothing is found for any: the last reason.
    """
    found, refused = list[Found](), list[CommonlawError]()
    for each in given:
        try:
            found.append(find(each))
        except CommonlawError as error:
            refused.append(error)
    if not found:
        raise refused[-1]
    return found, refused


def with_order_said(law: Law, others: Mapping[int, float], refused: Sequence[Exception]) -> Law:
    """Return a law whose order was chosen, saying so.

    Parameters
    ----------
    law
        Of the largest evidence.
    others
        2 log B of the law against the best ones of other orders, by these.
    refused
        Why no law of other orders was found.
    """
    against = [f"2 log B is {each:.3g} against the best law of order {order}" for order, each in others.items()]
    step = Step("order", str(law.order), "; ".join([*against, *(f"of the other none was found: {e}" for e in refused)]))
    close = [f"{order} (2 log B is {each:.2g})" for order, each in others.items() if each < _STRONG]
    said = tuple(
        Outcome(
            OutcomeKind.NOT_IDENTIFIABLE,
            "",
            f"the law is of order {law.order}, and one of order {each} explains the trials about as well",
            "trials from other starts would tell, or give the order",
        )
        for each in close
    )
    provenance = law.provenance
    provenance = replace(provenance, history=(step, *provenance.history), outcomes=(*provenance.outcomes, *said))
    return replace(law, provenance=provenance)
