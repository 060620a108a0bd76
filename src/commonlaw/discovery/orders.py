"""The order of a law: as given, by measured rates, or by evidence."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from numbers import Integral
from typing import Literal, NamedTuple, TypeVar

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.diagnostics import Outcome, note
from commonlaw.discovery.candidate_search import Candidate
from commonlaw.discovery.measured_rates import is_computed, measured_rates, without_measured_rates
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.inference import settings
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.search.pool import Pool
from commonlaw.law import Law, Step
from commonlaw.law.text import order_in_words
from commonlaw.library import Order, one_order, with_rates
from commonlaw.trials import Trials
from commonlaw.trials.transformations import rates_in_words, without_rates

Given = TypeVar("Given")
Found = TypeVar("Found")

AskedOrder = Order | Literal["auto"] | Mapping[str, int]
"""1, 2, or 0 in discrete time; 1 or 2 for each state; ``"auto"`` to choose by measured rates and evidence."""


class Orders(NamedTuple):
    """Trials without columns of rates, the possible orders of each state, and their steps and outcomes."""

    trials: Trials
    of_each: tuple[tuple[int, ...], ...]
    steps: tuple[Step, ...] = ()
    outcomes: tuple[Outcome, ...] = ()


def possible_orders(trials: Trials, asked: AskedOrder) -> Orders:
    """Return the possible orders of each state.

    Raises `CommonlawError` if an order does not exist, or orders by state do not match the states.
    """
    if asked == "auto":
        return _orders_from_measured_rates(trials)
    by_state = order_by_state(asked, trials.schema.states)
    second = [name for name, order in by_state.items() if order == 2]
    named = () if isinstance(asked, Integral) else by_state
    trials, outcomes = without_measured_rates(trials, second, named)
    return Orders(trials, single_orders(by_state, trials.schema.states), outcomes=outcomes)


def order_by_state(asked: Order | Mapping[str, int], states: Sequence[str]) -> Mapping[str, int]:
    """Return the order of each state that has one.

    Raises `CommonlawError` if an order does not exist, or orders by state are not of these states.
    """
    if isinstance(asked, tuple):
        if len(asked) != len(states):
            raise CommonlawError("order-per-state", order=asked, states=states)
        asked = dict(zip(states, asked, strict=True))
    if not isinstance(asked, Mapping):
        if not (isinstance(asked, Integral) and asked in (0, 1, 2)):
            raise CommonlawError("order-not-offered", order=asked)
        return dict.fromkeys(states, int(asked))
    for name, order in asked.items():
        check_choice("state", name, states)
        if not (isinstance(order, Integral) and order in (1, 2)):  # 2.0 is none
            raise CommonlawError("order-of-state", order=order, name=name)
    return asked


def single_orders(by_state: Mapping[str, int], states: Sequence[str]) -> tuple[tuple[int, ...], ...]:
    """Return the only possible order of each state; raise `CommonlawError` if a state has none."""
    if missing := [name for name in states if name not in by_state]:
        raise CommonlawError("order-missing", states=missing)
    return tuple((by_state[name],) for name in states)


def _orders_from_measured_rates(trials: Trials) -> Orders:
    """Return the possible orders, where a state and its independently measured rate are of first order.

    A column of rates that was computed from the state is not a measurement: it is left out, and the state is of second
    order.
    """
    rates = measured_rates(trials)
    if not rates:
        return Orders(trials, ((1, 2),) * len(trials.schema.states))
    left_out = {state: rate for state, rate in rates.items() if is_computed(trials, state, rate)}
    second = {state: rate for state, rate in left_out.items() if state not in rates.values()}
    first = {name for pair in rates.items() if pair[0] not in left_out for name in pair}
    trials = without_rates(trials, left_out)
    of_each = tuple((2,) if name in second else (1,) if name in first else (1, 2) for name in trials.schema.states)
    known = {name: orders[0] for name, orders in zip(trials.schema.states, of_each, strict=True) if len(orders) == 1}
    missing = [name for name in trials.schema.states if name not in known]
    why = rates_in_words(rates) + (f"; the rate of {', '.join(missing)} was not measured" if missing else "")
    is_one = not missing and len(set(known.values())) == 1
    choice = str(of_each[0][0]) if is_one else ", ".join(f"{name} {order}" for name, order in known.items())
    return Orders(trials, of_each, (Step("order", choice, why),))


def search_orders(
    find: Callable[[Order, Candidate | None], Candidate], possible: Sequence[Sequence[int]]
) -> tuple[list[Candidate], list[CommonlawError]]:
    """Return the best law of each tried order, and the errors of orders without one.

    The lowest order of all states is tried first, and if its law does not suffice, the highest; if none of them is
    simple, or the highest is better, also orders that differ from the best in one state, as long as the best improves.
    `find` takes an order, and the best law so far if it is simple.

    Raises `CommonlawError` if no order has a law: the last reason.
    """
    lowest, highest = tuple(map(min, possible)), tuple(map(max, possible))
    tried, failures = dict[tuple[int, ...], Candidate | None](), list[CommonlawError]()
    listed, best, simple = [lowest], tuple[int, ...](), None
    while True:
        for orders in listed:
            laws, failed = attempt_each(partial(find, one_order(orders)), [simple])
            tried |= {orders: laws[0] if laws else None}
            failures += failed
        every = {orders: law for orders, law in tried.items() if law is not None}
        if highest not in tried and not (every and every[lowest].suffices):
            listed, simple = [highest], every[lowest] if every and every[lowest].is_simple else None
            continue
        if not every:
            raise failures[-1]
        before, best = best, min(every, key=every.__getitem__)
        simple = every[best] if every[best].is_simple else None
        near = [
            (*best[:j], order, *best[j + 1 :])
            for j, of_state in enumerate(possible)
            for order in of_state
            if order != best[j]
        ]
        listed = [orders for orders in near if orders not in tried]
        if highest not in tried or best == before or not listed or (best == lowest and simple):
            return list(every.values()), failures


def attempt_each(find: Callable[[Given], Found], given: Iterable[Given]) -> tuple[list[Found], list[CommonlawError]]:
    """Return the results of a function, and the errors where it fails."""
    result, failures = list[Found](), list[CommonlawError]()
    for argument in given:
        try:
            result.append(find(argument))
        except CommonlawError as error:
            failures.append(error)
    return result, failures


def apply_to_each(step: Callable[[Found], Found], given: Sequence[Found]) -> tuple[list[Found], list[CommonlawError]]:
    """Return the results of a step, and the errors where it fails; raise the last one if it fails for all."""
    result, failed = attempt_each(step, given)
    if not result:
        raise failed[-1]
    return result, failed


def with_order_step(law: Law, others: Sequence[tuple[Order, float]], failures: Sequence[Exception]) -> Law:
    """Return a law with a step of the history, and notes, on the choice of its order.

    They contain 2 log B of the law against the best ones of other orders, or why there is none.
    """
    states = law.schema.states
    named = [(order_in_words(order, states), evidence) for order, evidence in others]
    against = [
        f"2 log B is {evidence:.3g} against the best law of order {order}"
        if evidence >= 0
        else f"it was chosen by forecasts; order {order} has the larger evidence (2 log B {evidence:.3g})"
        for order, evidence in named
    ]
    choice = order_in_words(law.order, states)
    reasons = [*against, *(f"no law of another order was found: {failure}" for failure in failures)]
    step = Step("order", choice, "; ".join(reasons) or "a law of this order fits within the noise")
    close = [f"{order} (2 log B is {evidence:.2g})" for order, evidence in named if 0 <= evidence < settings.STRONG]
    notes = tuple(note("order-not-identifiable", choice=choice, other=evidence) for evidence in close)
    provenance = law.provenance
    provenance = replace(provenance, history=(step, *provenance.history), outcomes=(*provenance.outcomes, *notes))
    return replace(law, provenance=provenance)


def is_implied_by_lower_order(pool: Pool) -> bool:
    """Return whether a law of second order is implied by one of first order: x' = f(x) has x'' = f'(x) x'.

    Then each term has a rate as a factor, and a state at rest remains at rest. So is x'' = K (f(x) - x') for any K,
    whose coefficients are not identifiable.
    """
    if not pool.is_determined:
        return True
    terms, supports = pool.best.problem.terms, pool.best.supports
    states = len(supports)
    second = with_rates(pool.best.problem.order, states)
    rates = {*range(states, states + len(second))}
    chosen = np.flatnonzero((supports[second] & terms.is_factor).any(axis=0))
    return len(chosen) > 0 and all(terms.terms[k].columns() & rates for k in chosen)


def is_first_order_possible(fit: Fit) -> bool:
    """Return whether rates may be a function of states and inputs: no object has two rates at the same state.

    An oscillator, which passes a state in both directions, or balls that are thrown from one place at two speeds, are
    of higher order. Estimated states are compared between trials, and between times of one trial.
    """
    from scipy.spatial import cKDTree

    states = len(fit.problem.noise)
    same_state, other_time, other_rate, by_noise = settings.TWO_RATES
    for model, estimate in zip(fit.problem.models, fit.estimates, strict=True):
        listed = list[Floats]()  # Times, as shares of trials, states, inputs and rates
        for mesh, curve in zip(model.meshes, estimate.states, strict=True):
            for points in np.split(np.arange(len(mesh.times)), np.flatnonzero(~mesh.contiguous) + 1):
                if len(points) > 1:
                    path, shares = curve[points, :states], 2 * len(listed) + np.linspace(0, 1, len(points))
                    rates = np.gradient(path, mesh.times[points], axis=0)
                    listed.append(np.column_stack([shares, path, mesh.inputs[points], rates]))
        if not listed:
            continue
        rows = np.concatenate(listed)
        few = rows[np.isfinite(rows).all(axis=1)][:: -(-len(rows) // settings.MAX_PAIRS)]
        above = few[:, 1:] - few[:, 1:].min(axis=0)  # Zero where a column is constant
        scaled = above / np.maximum(above.max(axis=0), np.finfo(float).tiny)
        first, second = cKDTree(scaled[:, :-states]).query_pairs(same_state, output_type="ndarray").T
        later = np.abs(few[first, 0] - few[second, 0]) > other_time
        apart = np.abs(scaled[first[later], -states:] - scaled[second[later], -states:]).max(axis=1)
        if len(apart) > 0 and bool((apart > other_rate).mean() > by_noise):
            return False
    return True
