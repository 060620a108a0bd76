"""An object that was measured in other units is noted, and scatter between objects is not."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.trials import Schema


def decays(rates):
    """Return one trial of each of some objects that decay at these rates."""
    times, rng = np.linspace(0, 3, 15), np.random.default_rng(0)
    courses = [5 * np.exp(-rate * times) + 0.01 * rng.standard_normal(15) for rate in rates]
    trials = (cl.Trial(f"c{i}", "1", times, course[:, np.newaxis]) for i, course in enumerate(courses))
    return cl.Trials(tuple(trials), Schema(("x",)))


def cups(scales, noise=(0.5, 0.5, 0.5, 0.5), rates=(0.3, 0.5, 0.8, 0.6), seed=0):
    """Return two trials of each of some cups that cool to 20 degrees, in units of their own."""
    times, random, trials = np.linspace(0, 6, 40), np.random.default_rng(seed), list[cl.Trial]()
    for i, (scale, level, rate) in enumerate(zip(scales, noise, rates, strict=True)):
        for trial, start in enumerate((80.0, 50.0)):
            values = 20 + (start - 20) * np.exp(-rate * times) + level * random.standard_normal(40)
            trials.append(cl.Trial(f"c{i}", str(trial), times, scale * values[:, np.newaxis]))
    return cl.Trials(tuple(trials), Schema(("T",)))


def with_offset(trials, offset, unit):
    """Return the trials in this unit with an offset of the last object."""
    shifted = [replace(trial, states=trial.states + offset * (trial.object == "c3")) for trial in trials]
    return cl.Trials(tuple(shifted), Schema(("T",), units={"T": unit} if unit else {}))


def noted(law):
    return [outcome for outcome in law.diagnostics if outcome.code == "object-in-other-units"]


@pytest.mark.parametrize("equations", ["x' = -k x", "x' = -k x; x(0) = x0"])
def test_an_object_in_other_units_is_noted(equations):
    (found,) = noted(cl.fit(equations, decays([0.05, 0.06, 0.055, 3.3])))
    assert all(part in found.text for part in ("k of c3", "60"))


def test_a_discovered_law_has_the_note():
    law = cl.discover(decays([0.31, 0.33, 0.29, 3.2]), order=1, library="poly:1")
    assert "10 between" in noted(law)[0].text


@pytest.mark.parametrize("rates", [(0.1, 0.2, 0.5, 1.0), (0.3, 0.32, 0.29, 0.9), (0.3, 3.0)])
def test_scatter_between_objects_is_not_noted(rates):
    assert not noted(cl.fit("x' = -k x", decays(rates)))


@pytest.mark.parametrize(
    ("factor", "words"), [(1000.0, "1000"), (0.01, "0.01"), (180 / np.pi, "57.3"), (9.81, "9.81"), (60.0, "60")]
)
def test_a_column_in_other_units_is_named_with_its_object_and_factor(factor, words):
    law = cl.fit("T' = a - k T", cups((1.0, 1.0, 1.0, factor)))
    (found,) = [outcome for outcome in law.diagnostics if outcome.code.endswith("in-other-units")]
    assert (found.code, found.where) == ("column-in-other-units", "c3")
    assert all(words in text for text in (found.text, found.remedy))


@pytest.mark.parametrize(
    ("scales", "noise"),
    [
        ((1.0, 1.0, 1.0, 1.0), (0.5, 0.5, 0.5, 0.5)),
        ((1.0, 1.0, 1.0, 1.0), (0.05, 0.05, 0.05, 5.0)),  # Noise alone is a hundred times as large
        ((1.0, 2.0, 5.0, 10.0), (0.5, 0.25, 0.1, 0.05)),  # Larger objects of one noise
        ((1.0, 3.0, 10.0, 30.0), (0.5, 0.5, 0.5, 0.5)),
    ],
)
def test_objects_that_differ_are_in_one_unit(scales, noise):
    law = cl.fit("T' = a - k T", cups(scales, noise))
    assert "column-in-other-units" not in [outcome.code for outcome in law.diagnostics]


@pytest.mark.parametrize(("offset", "unit"), [(273.15, ""), (-273.15, "K"), (273.15, "degC")])
def test_kelvin_among_degrees_celsius_are_named(offset, unit):
    trials = with_offset(cups((1.0,) * 4), offset, unit)
    (found,) = [outcome for outcome in cl.fit("T' = a - k T", trials).diagnostics if outcome.kind == "units"]
    assert (found.code, found.where) == ("column-with-offset", "c3")
    assert f"{offset:+g}" in found.text


@pytest.mark.parametrize(("offset", "unit"), [(40.0, ""), (230.0, ""), (400.0, "K"), (273.15, "m")])
def test_other_offsets_are_those_of_objects(offset, unit):
    law = cl.fit("T' = a - k T", with_offset(cups((1.0,) * 4), offset, unit))
    assert "column-with-offset" not in [outcome.code for outcome in law.diagnostics]


def test_a_strange_object_in_kelvin_is_named_with_its_offset():
    times, random = np.linspace(0, 3, 60), np.random.default_rng(5)
    curves = [25 / np.sqrt(1 + 2 * 25**2 * rate * times) for rate in (0.001, 0.0012, 0.0009, 0.0011, 0.0010)]
    values = [curve + 0.05 * random.standard_normal(60) + 273.15 * (i == 4) for i, curve in enumerate(curves)]
    trials = cl.Trials.from_arrays([times] * 5, values, object=list("abcde"), names=["T"])
    law = cl.discover(trials, order=1, library="poly:3")
    assert law.objects == ("a", "b", "c", "d")
    (found,) = [outcome for outcome in law.diagnostics if outcome.code.startswith("strange-object")]
    assert found.code == "strange-object-units"
    assert "T is +273.15 apart" in found.text
