"""A law and trials in different units: converted where they meet, or refused."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.law import average_law
from commonlaw.trials.transformations import Conversion, in_units
from tests.refusals import refused


def in_other_units(drops):
    """Return the same drops in millimetres and milliseconds, written out by hand."""
    schema = replace(drops.schema, units={**drops.schema.units, "x": "mm", "t": "ms"})
    rows = tuple(replace(each, times=1000 * each.times, states=1000 * each.states) for each in drops)
    return replace(drops, trials=rows, schema=schema)


@pytest.fixture(scope="module")
def drops():
    return cl.datasets.linear_drag(drag=(-0.1, -0.3), trials=1, samples=40, noise=0.02)


@pytest.fixture(scope="module")
def law(drops):
    return cl.fit("x'' = -g - c v", drops, errors="white", noise={"x": 0.02})


def same(one, other):
    np.testing.assert_allclose(one, other, rtol=1e-6)


def test_a_printed_law_has_the_units_of_its_coefficients(law):
    head = str(law).splitlines()[2]
    assert head.split() == ["g", "[m/s²]", "c", "[1/s]"]
    bare = replace(law, schema=replace(law.schema, units={}))
    assert str(bare).splitlines()[2].split() == ["g", "c"]
    assert "g [m/s²] = " in str(average_law(law))


def test_forecasts_are_those_in_the_units_of_the_law(law, drops):
    other = in_other_units(drops)
    wanted = law.predict(drops, times=[5.0], from_time=1.5, return_std=True)
    found = law.predict(other, times=[5000.0], from_time=1500.0, return_std=True)
    assert found.trials.schema.units["x"] == "m"
    assert found.from_time == pytest.approx(1.5)
    for one, own in zip(found.trajectories, wanted.trajectories, strict=True):
        same(one.times, own.times)
        np.testing.assert_allclose(one.states, own.states, rtol=1e-6, atol=1e-6)
    same(found.score(), wanted.score())
    assert any("x from mm to m" in note for note in found.trials.notes)


def test_scores_verdicts_and_residuals_are_the_same(law, drops):
    other = in_other_units(drops)
    same(law.predict(other).score(), law.predict(drops).score())
    assert str(law.assess(other)) == str(law.assess(drops))
    assert str(law.residuals(other)) == str(law.residuals(drops))


def test_refined_and_adapted_coefficients_are_in_the_units_that_the_law_says(law, drops):
    other = in_other_units(drops)
    same(cl.refine(law, other, errors="white", noise={"x": 20.0}).coefficients, law.coefficients)
    one, wanted = (law.explain([]).update(each.until(t)) for each, t in ((other, 1000.0), (drops, 1.0)))
    np.testing.assert_allclose(one.coefficients, wanted.coefficients, rtol=1e-5)


def test_comparisons_are_of_the_same_numbers(law, drops):
    laws = {
        "one": law,
        "two": cl.Law.from_text("x'' = -g", {"g": dict.fromkeys(drops.objects, 9.8)}, units=law.schema.units),
    }
    one, other = (cl.compare(laws, each, errors="white") for each in (drops, in_other_units(drops)))
    np.testing.assert_allclose(one["2 log B"], other["2 log B"], rtol=1e-4, atol=1e-4)
    wrong = replace(laws["two"], schema=replace(law.schema, units={"x": "km", "t": "s"}))
    with refused("laws-in-other-units"):
        cl.compare({"one": law, "two": wrong}, drops)


def test_a_known_law_has_its_own_units_kept(law, drops):
    gravity = cl.Law.from_text("x'' = -g", {"g": dict.fromkeys(drops.objects, 9.8)}, units=law.schema.units)
    method = cl.DerivativeRegression(solver="stlsq:0.01")
    one, other = (
        cl.discover(each, order=2, library="poly:1", known=gravity, method=method)
        for each in (drops, in_other_units(drops))
    )
    same(one.coefficients, other.coefficients)
    assert other.schema.units["x"] == "m"


@pytest.mark.parametrize(
    "ask",
    [
        lambda law, trials: law.predict(trials),
        lambda law, trials: law.predict(trials).score(),
        lambda law, trials: law.assess(trials),
        lambda law, trials: law.residuals(trials),
        lambda law, trials: law.update(trials),
        lambda law, trials: law.discrepancy(trials),
        lambda law, trials: law.report(trials),
        lambda law, trials: cl.refine(law, trials),
        lambda law, trials: cl.compare({"law": law}, trials),
        lambda law, trials: cl.discover(trials, order=2, known=law, library="poly:3"),
    ],
)
def test_what_has_no_conversion_is_refused_by_everything_that_takes_law_and_trials(law, drops, ask):
    wrong = replace(drops, schema=replace(drops.schema, units={"x": "kg", "t": "s"}))
    with refused("units-incompatible", name="x", unit="kg", law_unit="m"):
        ask(law, wrong)


def test_inputs_properties_noise_and_zeros_of_scales_are_converted():
    trials = cl.Trials.from_arrays(
        [0.0, 1.0], [20.0, 30.0], inputs=[1.0, 2.0], noise=[0.1, 0.1], names=["T", "u"],
        units={"T": "degC", "u": "kW", "t": "min", "mass": "g"}, properties={"object": {"mass": 5.0}},
    )  # fmt: skip
    found = in_units(trials, {"T": "K", "u": "W", "t": "s", "mass": "kg"})
    same(found[0].states[:, 0], [293.15, 303.15])
    same(found[0].noise[:, 0], [0.1, 0.1])
    same(found[0].inputs[:, 0], [1000.0, 2000.0])
    same(found[0].times, [0.0, 60.0])
    assert found.properties == {"object": {"mass": pytest.approx(0.005)}}
    fahrenheit = in_units(trials, {"T": "degF"})[0]
    same(fahrenheit.states[:, 0], [68.0, 86.0])
    same(fahrenheit.noise[:, 0], [0.18, 0.18])


def test_what_has_no_unit_stays_as_it_is(law, drops):
    bare = replace(drops, schema=replace(drops.schema, units={}))
    assert in_units(bare, law.schema.units) is bare
    assert in_units(drops, {}) is drops
    assert in_units(drops, law.schema.units) is drops


def test_logarithms_are_shifted():
    trials = cl.Trials.from_arrays([0.0, 1.0], [2.0, 3.0], names=["N"], units={"N": "mg/L"})
    from commonlaw.trials.transformations import with_logarithms

    one = with_logarithms(in_units(trials, {"N": "g/L"}), ["N"])
    other = in_units(with_logarithms(trials, ["N"]), {"N": "g/L"})
    same(one[0].states, other[0].states)


@pytest.mark.parametrize(("given", "wanted"), [("m", "kg"), ("dB", "1"), ("m", "m/s")])
def test_units_without_a_straight_line_between_them_are_refused(given, wanted):
    with refused("units-incompatible"):
        Conversion.between("x", given, wanted)
