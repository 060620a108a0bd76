"""Laws beside each other by their evidence."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import commonlaw as cl
from commonlaw.law import from_json, to_json
from tests.refusals import refused


@pytest.fixture(scope="module")
def decays():
    """Three objects that decay exponentially, in white noise."""
    times, noise = np.linspace(0.0, 4.0, 40), np.random.default_rng(2)
    states = [5 * np.exp(-rate * times) + noise.normal(0, 0.05, 40) for rate in (0.5, 0.7, 1.0)]
    return cl.Trials.from_arrays([times] * 3, states, object=["a", "b", "c"])


def test_evidence_is_for_the_law_that_made_the_measurements(decays):
    texts = "x' = -k x^2", "x' = -k x", "x' = a - k x"
    found = cl.compare({text: cl.fit(text, decays) for text in texts}, decays)
    assert found["law"].tolist() == ["x' = -k x", "x' = a - k x", "x' = -k x^2"]
    assert found["coefficients"].tolist() == [1, 2, 1]
    assert found["2 log B"].iloc[2] > 50
    assert found["probability"].sum() == pytest.approx(1)


def test_a_coefficient_that_is_known_costs_nothing(decays):
    one = decays.select(object="a")
    laws = {name: cl.fit(text, one) for name, text in (("known", "x' = -0.5 x"), ("free", "x' = -k x"))}
    found = cl.compare(laws, one, noise={"x": 0.05}).set_index("law")
    assert found.loc["known", "coefficients"] == 0
    # One free number costs log 40 and the bit of its factor, and gains a chi-squared of one degree of freedom
    assert 0 < found.loc["free", "2 log B"] < np.log(40) + 2 * np.log(2)


def test_laws_of_different_measurements_are_refused(decays):
    pair = cl.Law.from_text("x' = y; y' = -k x", {"k": 1.0})
    with refused("laws-of-other-states"):
        cl.compare([cl.fit("x' = -k x", decays), pair], decays)


def test_laws_of_different_orders_are_compared(decays):
    laws = {text: cl.fit(text, decays) for text in ("x' = -k x", "x'' = -k v", "x'' = -k x")}
    found = cl.compare(laws, decays).set_index("law")["2 log B"]
    assert list(found.index) == ["x' = -k x", "x'' = -k v", "x'' = -k x"]
    assert 6 < found["x'' = -k v"] < found["x'' = -k x"]  # Of second order, rates at starts are found besides


def test_laws_without_coefficients_are_compared(decays):
    texts = "x' = 0", "x' = -0.7 x", "x' = -k x"
    laws = {text: cl.fit(text, decays) for text in texts}
    found = cl.compare(laws, decays)
    assert found["law"].tolist() == list(texts[::-1])
    assert found["coefficients"].tolist() == [1, 0, 0]
    assert str(laws["x' = 0"]).splitlines()[0] == "x' = 0"
    assert from_json(to_json(laws["x' = 0"])).structure == ("x' = 0",)
    assert np.array_equal(cl.Law.from_text("x' = 0").simulate([0.0, 1.0], [2.0])["object"].states[:, 0], [2.0, 2.0])


def test_the_residuals_of_all_objects_tell_the_noise_of_few_samples_each():
    times, generator = np.array([0.0, 1.0, 2.0, 4.0, 7.0, 10.0]), np.random.default_rng(5)
    states = [a / (1 + 0.5 * a * times) + 0.03 * generator.standard_normal(6) for a in np.linspace(1.5, 4, 8)]
    vials = cl.Trials.from_arrays([times] * 8, states, object=list("abcdefgh"))
    laws = {"first": cl.fit("x' = -k x", vials), "second": cl.fit("x' = -k x^2", vials)}
    table = cl.compare(laws, vials).set_index("law")["2 log B"]

    def left(curve):
        """The sum of squares that a curve of two parameters leaves of all vials, by least squares."""
        fits = (least_squares(lambda p, own=own: curve(*p) - own, [own[0], 0.3]) for own in states)
        return 2 * sum(each.cost for each in fits)

    ratio = left(lambda a, k: a * np.exp(-k * times)) / left(lambda a, k: a / (1 + a * k * times))
    # With the noise integrated out, of 48 measurements and 16 parameters
    assert (48 - 16) * np.log(ratio) < table["first"] < 48 * np.log(ratio)
    assert table["second"] == 0
