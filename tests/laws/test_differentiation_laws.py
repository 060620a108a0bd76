"""What holds for every differentiation method that has a name."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from commonlaw.differentiation import METHODS, format_differentiation, parse_differentiation

SETTINGS = {"tv": "tv:1e-4"}
"""Texts of the methods that have no default settings."""

methods = pytest.mark.parametrize("text", [SETTINGS.get(name, name) for name in METHODS])
seeds, orders = st.integers(0, 2**16), st.sampled_from([1, 2])
few = settings(max_examples=8)


def _trial(seed):
    """Return the times and two states, waves with noise, of a uniform trial; read-only, as those of a `Trial` are."""
    rng = np.random.default_rng(seed)
    times = rng.uniform(-5, 5) + rng.uniform(0.01, 10) * np.arange(rng.integers(36, 80))
    phase = np.linspace(0, rng.uniform(1, 9), len(times))[:, np.newaxis]
    states = np.sin(phase * [1, 0.7] + rng.uniform(0, 6, 2)) + 0.05 * rng.standard_normal((len(times), 2))
    times.flags.writeable = states.flags.writeable = False
    return times, states


def _assert_same(found, expected):
    """Compare to 1e-5 of the largest value: a strength that is searched for is found to as much."""
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-5 * np.abs(other).max() + 1e-300)


def _rates(text, times, states, order):
    return parse_differentiation(text).differentiate(times, states, order)


@methods
@few
@given(seeds, orders, st.floats(1e-3, 1e3), st.sampled_from([-1, 1]), st.floats(-100, 100), st.floats(1e-3, 1e3))
def test_rates_follow_the_units_of_states_and_time_and_not_the_origin_of_time(
    text, seed, order, size, sign, shift, unit
):
    times, states = _trial(seed)
    rates = _rates(text, times, states, order)
    other = _rates(text, times / unit + shift, sign * size * states, order)
    factors = sign * size * unit ** np.arange(1, order + 1)
    _assert_same(other.derivatives, [each * factor for each, factor in zip(rates.derivatives, factors, strict=True)])
    _assert_same([other.states], [sign * size * rates.states])


@methods
@few
@given(seeds, orders)
def test_each_state_is_differentiated_by_itself(text, seed, order):
    times, states = _trial(seed)
    together = _rates(text, times, states * [1, 1000], order)
    apart = [_rates(text, times, column, order) for column in (states[:, :1], 1000 * states[:, 1:])]
    for k in range(order):
        _assert_same([together.derivatives[k]], [np.hstack([each.derivatives[k] for each in apart])])


@methods
@few
@given(seeds)
def test_derivatives_have_the_shape_of_the_trial_and_do_not_depend_on_the_order_asked_for(text, seed):
    times, states = _trial(seed)
    first, second = (_rates(text, times, states, order) for order in (1, 2))
    assert [each.shape for each in (second.states, *second.derivatives)] == [states.shape] * 3
    assert np.all(np.isfinite(second.derivatives))
    (rates,) = first.derivatives
    np.testing.assert_array_equal(rates, second.derivatives[0])


@methods
def test_text_is_read_back(text):
    method = parse_differentiation(text)
    assert parse_differentiation(format_differentiation(method)) == method
