"""What can be set in an experiment: shapes of inputs, known starts, doses; against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.library import Terms, Variables
from tests.known_laws import NOISE, falling, known, said
from tests.refusals import refused


def test_an_input_is_shaped_to_tell_its_coefficient():
    """x' = a u with a free start: the integral of the input has to change most, as a level that stays does."""
    law = known("x' = a u", {"a": 1.0}, [[1.0]], inputs=("u",))
    vary = {"x": 0, "duration": 2, "samples": 9, "u": "0..2", "u.shape": ["constant", "step", "sine"], "u.period": 2}
    found = cl.design(law, vary).experiments[0]
    assert (found.experiment.settings["u"], found.experiment.settings["u.shape"]) == (2.0, "constant")
    columns = 2 * np.linspace(0, 2, 9)
    information = np.sum((columns - columns.mean()) ** 2) / NOISE**2
    assert found.bits == pytest.approx(np.log2(1 + information) / 2, rel=1e-3)


@pytest.mark.parametrize("shapes", ["constant, step", ["constant", "step"], ("constant", "step")])
def test_shapes_are_a_list_however_they_are_written(shapes):
    law = known("x' = a u", {"a": 1.0}, [[1.0]], inputs=("u",))
    found = cl.design(law, {"x": 0, "duration": 2, "samples": 9, "u": 2, "u.period": 2, "u.shape": shapes})
    assert found.experiments[0].experiment.settings["u.shape"] == "constant"


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"u.shape": "1..5"}, Diagnostic("unknown-name", {"kind": "shape of an input", "name": "1..5"})),
        ({"object": "1..5"}, Diagnostic("unknown-name", {"name": "1..5"})),
    ],
)
def test_ranges_of_words_are_refused_by_name(setting, message):
    law = known("x' = a u", {"a": 1.0}, [[1.0]], inputs=("u",))
    with refused(message):
        cl.design(law, {"x": 0, "duration": 2, "samples": 9, "u": 2, **setting})


def test_states_on_a_logarithmic_scale_start_above_zero():
    random, times = np.random.default_rng(0), np.linspace(0, 5, 40)
    states = [5 * np.exp(-rate * times + 0.05 * random.normal(size=40)) for rate in (0.5, 0.8)]
    trials = cl.Trials.from_arrays([times, times], states, object=["a", "b"], names=["x"])
    law = cl.fit("x' = -k x", trials, positive=["x"])
    with refused("setting-not-positive"):
        cl.design(law, {"x": "0..10", "duration": 5, "rate": 5})
    found = cl.design(law, {"x": "1..10", "duration": "1..8", "rate": 5}, about="coefficients")
    assert found.experiments[0].experiment.times[-1] == 8.0


@pytest.mark.parametrize("off", [0.0, 0.02, 10.0])
def test_starts_that_are_known_count_as_measured_beforehand(off):
    times = np.linspace(0, 2, 5)
    settings = {"x": 10, "v": 0, "times": [times]}
    found = cl.design(falling(), settings, about="g", start_std={"x": off, "v": off})
    columns = np.column_stack([-(times**2) / 2, np.ones(5), times]) / NOISE
    with np.errstate(divide="ignore"):
        prior = np.diag(1 / np.array([1.0, max(off, 1e-9), max(off, 1e-9)]) ** 2)
    expected = np.sqrt(np.linalg.inv(columns.T @ columns + prior)[0, 0])
    assert found.experiments[0].std == pytest.approx(expected, rel=1e-3)


def test_repeats_begin_anew_with_errors_of_their_starts():
    """Height in 1 s is known to the error of the start, and that is another one each time."""
    settings = {"x": 0, "v": 0, "times": [[0, 1]], "repeats": 4}
    found = cl.design(falling(), settings, about="g", start_std={"x": 0, "v": 0.5})
    variance = (0.5**2 + NOISE**2) / 4 * 2**2  # g = -2 x(1)
    assert found.experiments[0].std == pytest.approx((1 + 1 / variance) ** -0.5, rel=1e-3)


def test_starts_on_a_logarithmic_scale_are_off_by_shares():
    law = known("x' = a x", {"a": -0.3}, [[0.01]], noise=0.05)
    terms = Terms(Variables(("x",), (), "t", logarithmic=("x",)), law.terms.terms)
    law = replace(law, terms=terms, schema=replace(law.schema, logarithmic=("x",)))
    found = cl.design(law, {"x": 4, "times": [[0, 2]]}, about="a", start_std={"x": 0.2})
    columns = np.array([[0, 1], [2, 1]]) / 0.05  # log x = log x(0) + a t
    expected = np.linalg.inv(columns.T @ columns + np.diag([100, (4 / 0.2) ** 2]))[0, 0] ** 0.5
    assert found.experiments[0].std == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("given", [{"start_std": {"x": "0.1"}}, {"start_std": {"x": None}}, {"cost": {"trial": "one"}}])
def test_errors_of_starts_and_prices_that_are_no_numbers_are_refused(given):
    with refused("setting-negative"):
        cl.design(falling(), {"x": 0, "v": 0, "duration": 1, "rate": 10}, **given)


def test_errors_of_starts_that_cannot_be_are_refused():
    settings = {"x": 0, "v": 0, "duration": 1, "rate": 10}
    with refused("unknown-name", name="y"):
        cl.design(falling(), settings, start_std={"y": 0})
    with refused("setting-negative", name="the start of x is off by", value=-1):
        cl.design(falling(), settings, start_std={"x": -1})


@pytest.fixture
def eliminated():
    """A law by which a dose leaves, and its true trials."""
    law = known("c' = -k c + dose", {"k": 0.5}, np.diag([0.01, 0]), inputs=("dose",))
    return replace(law, schema=replace(law.schema, doses=("dose",), input_between="linear"))


def test_a_dose_that_leaves_is_best_measured_after_its_mean_stay(eliminated):
    """Box and Lucas 1959: of D exp(-k t) one sample tells k best at t = 1/k."""
    settings = {"c": 0, "dose": 3, "times": [[0, t] for t in (0.5, 1, 2, 3, 4)]}
    found = cl.design(eliminated, settings, about="k", start_std={"c": 0})
    assert found.experiments[0].experiment.settings["times"] == (0, 2)
    slope = 2 * 3 * np.exp(-0.5 * 2) / NOISE
    assert found.experiments[0].std == pytest.approx((100 + slope**2) ** -0.5, rel=1e-3)
    assert "dose of 3 after 0, 2 samples over 2" in found.experiments[0].text


def test_doses_are_given_when_and_as_often_as_is_set(eliminated):
    settings = {
        "object": "ball",
        "c": 0.0,
        "dose": 3.0,
        "dose.at": 1.0,
        "dose.every": 2.0,
        "times": (0.0, 0.5, 2.0, 4.5),
    }
    found = said(eliminated, settings)
    expected = [0, 0, 3 * np.exp(-0.5), 3 * np.exp(-0.5 * 3.5) + 3 * np.exp(-0.5 * 1.5)]
    np.testing.assert_allclose(found.mean, expected, atol=1e-3)


def test_a_dose_after_the_last_sample_is_none(eliminated):
    found = cl.design(eliminated, {"c": 0, "dose": 3, "dose.at": 5, "duration": 5, "rate": 2})
    assert "no dose" in found.experiments[0].text
    assert found.experiments[0].bits == pytest.approx(0)


def test_doses_are_those_of_trials_by_default():
    times = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 8.0])
    random = np.random.default_rng(0)
    states, doses, since = [], [], times - 1
    for amount in (2.0, 4.0):
        doses.append(np.where(times == 1, amount, 0.0)[:, np.newaxis])
        clean = np.where(since > 0, amount * np.exp(-0.5 * since), 0.0)
        states.append((clean + 0.02 * random.normal(size=6))[:, np.newaxis])
    trials = cl.Trials.from_arrays([times] * 2, states, inputs=doses, names=["c", "dose"])
    law = cl.fit("c' = -k c + dose", trials, doses="dose")
    found = cl.design(law, {"c": 0}, trials=trials)
    settings = found.experiments[0].experiment.settings
    assert 2 <= settings["dose"] <= 4
    assert settings["dose.at"] == 1
    assert (settings["duration"], settings["samples"]) == (8, 6)


@pytest.mark.parametrize(
    ("vary", "message"),
    [
        ({"dose.shape": "ramp"}, Diagnostic("unknown-name", {"name": "dose.shape"})),
        ({"dose.every": 0}, Diagnostic("setting-too-small", {"name": "dose.every", "value": 0.0, "least": 0.0})),
        ({"dose.every": 1e-9}, Diagnostic("experiment-too-many-doses", {"count": 5000000000.0, "name": "dose"})),
        ({"dose.at": -1}, Diagnostic("setting-negative", {"name": "dose.at is", "value": -1.0})),
    ],
)
def test_doses_have_no_shape_and_take_time(eliminated, vary, message):
    with refused(message):
        cl.design(eliminated, {"c": 0, "dose": 3, "duration": 5, "rate": 2, **vary})
