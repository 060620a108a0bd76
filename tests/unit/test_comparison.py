"""Laws beside each other by their evidence."""

import numpy as np
import pytest

import commonlaw as cl


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


def test_the_same_law_is_as_probable_however_it_was_found(decays):
    discovered = cl.discover(decays, library="poly:2", order=1)
    found = cl.compare({"discovered": discovered, "fitted": cl.fit("x' = -k x", decays)}, decays)
    assert discovered.equations("a")[0].endswith(" x")
    np.testing.assert_allclose(found["2 log B"], 0, atol=1e-3)


def test_laws_of_different_measurements_are_refused(decays):
    pair = cl.Law.from_text("x' = y; y' = -k x", {"k": 1.0})
    with pytest.raises(cl.CommonlawError, match="laws of x and of x, y explain different measurements"):
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
    assert cl.Law.from_json(laws["x' = 0"].to_json()).structure() == ("x' = 0",)
    assert np.array_equal(cl.Law.from_text("x' = 0").simulate([0.0, 1.0], [2.0])["object"].states[:, 0], [2.0, 2.0])
