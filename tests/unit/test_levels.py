"""Columns that are held at levels, exactly or within noise, are inputs."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from commonlaw.trials import Trials

TIMES = np.arange(0.0, 60.0, 0.5)
RANDOM = np.random.default_rng(0)
SQUARE = np.where(TIMES // 10 % 2 == 0, 90.0, 10.0)


@pytest.mark.parametrize("noise", [0.0, 0.5, 3.0])
def test_a_square_wave_is_an_input_also_within_noise(noise):
    heated = 20 + np.cumsum(SQUARE) / 100 + RANDOM.normal(0, 0.1, 120)
    wave = SQUARE + noise * RANDOM.standard_normal(120)
    assert Trials.from_frame({"t": TIMES, "heated": heated, "wave": wave}).schema.inputs == ("wave",)


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize(
    "rates",
    [
        lambda _, y: [y[1], 5 * (1 - y[0] ** 2) * y[1] - y[0]],
        lambda _, y: [y[0] - y[0] ** 3 / 3 - y[1] + 0.5, 0.08 * (y[0] + 0.7 - 0.8 * y[1])],
        lambda _, y: [-2 * y[0], 2 * y[0] - 0.05 * y[1]],
        lambda t, y: [-y[0] * y[1], y[0] * y[1] * (t < 30) - 0.01 * y[1]],
    ],
    ids=["relaxation oscillator", "nerve", "fast decay", "outbreak"],
)
def test_states_that_change_fast_are_no_inputs(rates, noise):
    x, y = solve_ivp(rates, (0, 60), [2.0, 0.1], t_eval=TIMES, rtol=1e-8).y
    table = {"t": TIMES, "x": x + noise * RANDOM.standard_normal(120), "y": y + noise * RANDOM.standard_normal(120)}
    assert Trials.from_frame(table).schema.states == ("x", "y")


@pytest.mark.parametrize("words", [("ON", "OFF"), ("True", "False"), ("open", "closed")])
def test_words_of_a_switch_that_changes_are_an_input_and_those_of_objects_a_property(words):
    switch = np.where(SQUARE > 50, *words)
    table = {"t": np.tile(TIMES, 2), "x": RANDOM.standard_normal(240), "valve": np.tile(switch, 2)}
    table |= {"room": np.repeat(["A", "B"], 120), "cover": np.repeat(words, 120)}
    trials = Trials.from_frame(table)
    assert trials.schema.inputs == ("valve",)
    assert trials[0].inputs[:, 0].tolist() == (SQUARE > 50).tolist()
    assert trials.properties == {"A": {"cover": words[0]}, "B": {"cover": words[1]}}


def test_levels_that_change_at_multiples_of_an_interval_are_set_also_where_few_are_skipped():
    levels = np.repeat([44.1, 47.1, 50.1, 56.1, 53.1, 50.1, 47.1, 44.1], 15)
    ramp = np.repeat(np.arange(8.0), 15)
    height = np.cumsum(np.cumsum(levels - 50)) + RANDOM.normal(0, 0.1, 120)
    table = {"t": TIMES, "height": height, "a": levels, "b": ramp}
    assert Trials.from_frame(table).schema.inputs == ("a",)
    assert Trials.from_frame({"t": TIMES, "height": height, "throttle": height[::-1]}).schema.inputs == ("throttle",)
