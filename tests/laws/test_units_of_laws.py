"""Laws in other units and at other scales, and bounds of absent terms."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t

import commonlaw as cl
from commonlaw.inference import bounds
from commonlaw.law import average_law
from commonlaw.law.parameters import named_parameters
from commonlaw.law.quantiles import upper_bound
from commonlaw.trials.transformations import in_units, with_logarithms
from commonlaw.trials.units import Conversion
from tests.refusals import refused
from tests.simulations import solved


def in_other_units(drops):
    """Return the same drops in millimetres and milliseconds, written out by hand."""
    schema = replace(drops.schema, units={**drops.schema.units, "x": "mm", "t": "ms"})
    rows = tuple(replace(drop, times=1000 * drop.times, states=1000 * drop.states) for drop in drops)
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
    for trajectory, own in zip(found.trajectories, wanted.trajectories, strict=True):
        same(trajectory.times, own.times)
        np.testing.assert_allclose(trajectory.states, own.states, rtol=1e-6, atol=1e-6)
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
    one = with_logarithms(in_units(trials, {"N": "g/L"}), ["N"])
    other = in_units(with_logarithms(trials, ["N"]), {"N": "g/L"})
    same(one[0].states, other[0].states)


@pytest.mark.parametrize(("given", "wanted"), [("m", "kg"), ("dB", "1"), ("m", "m/s")])
def test_units_without_a_straight_line_between_them_are_refused(given, wanted):
    with refused("units-incompatible"):
        Conversion.between("x", given, wanted)


TINY, HUGE = 2.0**-27, 2.0**27
"""Eight orders of magnitude down and up; powers of two scale without rounding."""


def reacting(scales=(1.0, 1.0, 1.0), seed=0):
    """C decays into D, of three objects: C' = -k C, D' = 0.6 C, with the scales of t, C and D."""
    source, times, rows = np.random.default_rng(seed), np.linspace(0, 8, 33), []
    for name, k in (("a", 0.5), ("b", 0.4), ("c", 0.6)):
        for trial, start in ((1, 1.0), (2, 2.0)):
            c = start * np.exp(-k * times)
            d = 0.6 * (start - c) / k
            c, d = (own + 0.005 * source.standard_normal(len(times)) for own in (c, d))
            own = {"object": name, "trial": trial, "t": scales[0] * times, "C": scales[1] * c, "D": scales[2] * d}
            rows.append(pd.DataFrame(own))
    return cl.Trials.from_frame(pd.concat(rows), time="t", states=["C", "D"])


def test_discovery_is_the_same_over_sixteen_orders_of_magnitude():
    law, other = (
        cl.discover(reacting(scales), order=1, library="poly:2") for scales in ((1, 1, 1), (TINY, TINY, HUGE))
    )
    assert law.structure == other.structure == ("C' = a C", "D' = b C")
    np.testing.assert_allclose(other.comparison["score"], law.comparison["score"], rtol=1e-6, atol=1e-6)
    factors = np.array([1, HUGE / TINY]) / TINY
    expected = law.coefficients[:, law.support].reshape(3, 2) * factors
    np.testing.assert_allclose(other.coefficients[:, other.support].reshape(3, 2), expected, rtol=1e-9)


def test_a_fit_with_a_constant_inside_is_the_same_whatever_the_scale():
    times, found = np.linspace(0, 10, 40), []
    exact = solved(lambda _, s: -s / (0.5 + s), [2.0], times)[:, 0]
    measured = exact + 0.01 * np.random.default_rng(1).standard_normal(40)
    for scale in (1.0, TINY, HUGE):
        law = cl.fit("s' = -V s/(K + s)", cl.Trials.from_arrays(times, scale * measured, names=["s"]), errors="white")
        found.append(named_parameters(law).values[0] / scale)
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=1e-6)


def test_a_law_of_second_order_with_an_input_is_the_same_whatever_the_scale():
    times, found = np.linspace(0, 12, 60), []
    motion = solved(lambda t, z: [z[1], np.sin(0.7 * t) - 2 * z[0] - 0.3 * z[1]], [1.0, 0.0], times)[:, 0]
    motion += 0.01 * np.random.default_rng(2).standard_normal(60)
    for scale in (1.0, TINY, HUGE):
        push = np.sin(0.7 * times) / scale
        trials = cl.Trials.from_arrays(times, scale * motion, inputs=push, names=["x", "u"])
        law = cl.fit("x'' = a u - k x - c v", trials, errors="white")
        values = dict(zip(named_parameters(law).names, named_parameters(law).values[0], strict=True))
        found.append([values["a"] / scale**2, values["k"], values["c"]])
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=1e-6)


DROPS = cl.datasets.linear_drag(drag=(-0.1, -0.5), trials=1, noise=0.05)


def test_a_bound_holds_the_share_that_it_says():
    found = upper_bound([0.3, -2.0, 0.0], [1.0, 0.5, 2.0], [5.0, np.inf, 30.0], 0.9)
    for bound, center, scale, degrees in zip(found, (0.3, -2.0, 0.0), (1.0, 0.5, 2.0), (5.0, 1e9, 30.0), strict=True):
        between = t.cdf([(-bound - center) / scale, (bound - center) / scale], degrees)
        assert between[1] - between[0] == pytest.approx(0.9, abs=1e-6)


def test_a_curvature_is_bounded_as_by_least_squares():
    """Heights of a falling body with a free start: a jerk term t beside gravity is a cubic in time."""
    random, times = np.random.default_rng(0), np.linspace(0, 2, 60)
    heights = 10 - 4.9 * times**2 + 0.1 * random.normal(size=60)
    trials = cl.Trials.from_arrays([times], [heights], object=["ball"], names=["x"])
    found = bounds(cl.fit("x'' = -g", trials, noise={"x": 0.1}), trials, ["t"]).bounds[0]
    columns = np.column_stack([times**3 / 6, np.ones(60), times, times**2 / 2])
    wanted, *_ = np.linalg.lstsq(columns, heights)
    assert found.coefficient == pytest.approx(wanted[0], rel=0.02)
    assert found.error == pytest.approx(0.1 * np.sqrt(np.linalg.inv(columns.T @ columns)[0, 0]), rel=0.02)
    assert found.effect == pytest.approx(2 * found.at_most)


def test_a_term_that_is_there_is_seen():
    drops = cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.05, quadratic=-0.02)
    found = bounds(cl.fit("x'' = -g - c v", drops), drops, ["v^2"])
    assert any(bound.seen for bound in found.bounds)
    assert "excludes zero" in str(found)
    assert len(found.to_frame()) == len(drops.objects)


def test_all_absent_terms_of_the_library_are_bounded_by_default():
    law = cl.discover(DROPS, order=2, library="poly:2")
    found = bounds(law, DROPS)
    assert {bound.term for bound in found.bounds} == {*law.terms.names} - {"1", "v"}
    assert "Terms that are not in the law" in found._repr_html_()


def test_terms_in_the_law_and_terms_that_cannot_be_read_are_refused():
    law = cl.fit("x'' = -g - c v", DROPS)
    with refused("limit-of-present-term", term="v"):
        bounds(law, DROPS, ["v"])
    with refused("unknown-name"):
        bounds(law, DROPS, ["w^2"])


@pytest.mark.parametrize("unit", [1e-9, 1e9, 1e12])
def test_intervals_and_draws_do_not_depend_on_the_unit(unit):
    """Of coefficients that lie many decades apart, as of growth in cells per millilitre."""
    times, source = np.arange(0, 12, 0.5), np.random.default_rng(1)
    grown = 1 / (1 + 49 * np.exp(-0.9 * times)) + 0.01 * source.standard_normal(len(times))
    laws = [
        cl.fit("N' = r N (1 - N/K)", cl.Trials.from_arrays([times], [size * grown], names=["N"]), errors="white")
        for size in (1.0, unit)
    ]
    frames = [law.quantities().set_index("quantity").loc[["carrying capacity", "maximum growth"]] for law in laws]
    one, other = (frame[["estimate", "standard error", "low", "high"]].to_numpy(float) for frame in frames)
    np.testing.assert_allclose(other, unit * one, rtol=1e-6)
    one, other = (
        law.uncertainty.draws(law.coefficients[:, law.support], 400, 0).std(axis=0) / law.coefficients[:, law.support]
        for law in laws
    )
    np.testing.assert_allclose(abs(other), abs(one), rtol=0.2)
