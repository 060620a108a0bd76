"""Laws that are found beside laws that are given, and what discovery makes of unusual trials."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.law import Uncertainty


def test_a_law_that_was_found_carries_its_neighbours_by_their_evidence():
    generator = np.random.default_rng(5)
    times = np.linspace(0, 3, 25)
    states = np.exp(-0.8 * times) + 0.05 * generator.standard_normal(len(times))
    trials = cl.Trials.from_arrays([times], [states[:, np.newaxis]], names=["x"])
    law = cl.discover(trials, order=1, library="poly:2")
    assert len(law.models) > 1
    assert sum(model.probability for model in law.models) == pytest.approx(1)
    assert all(one.probability >= other.probability for one, other in pairwise(law.models))
    table = law.comparison.set_index("terms")["score"]
    own = table[", ".join(np.array(law.terms.names)[law.support[0]])]
    for probability, other in law.uncertainty.other_laws:
        behind = table[", ".join(np.array(law.terms.names)[other.support[0]])] - own
        assert probability / law.models[0].probability == pytest.approx(np.exp(-behind / 2), rel=0.5)
        refitted = cl.refine(
            replace(other, uncertainty=Uncertainty()), trials, errors="white", noise={"x": law.uncertainty.noise[0]}
        )
        np.testing.assert_allclose(other.coefficients, refitted.coefficients, rtol=0.02, atol=1e-3)


def test_coefficients_and_errors_are_those_of_refining_the_same_terms():
    drops = cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.05)
    law = cl.fit("x'' = -g - k v", drops)
    found = cl.discover(drops, order=2, library="poly:1")
    refined = cl.refine(found, drops)
    assert law.terms.names == ("1", "v")
    np.testing.assert_allclose(law.coefficients, refined.coefficients[:, :, refined.support[0]], rtol=1e-6)
    np.testing.assert_allclose(law.uncertainty.covariance, refined.uncertainty.covariance, rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(law.uncertainty.noise, refined.uncertainty.noise, rtol=1e-12)


def test_discovery_takes_repeated_measurements():
    times = np.repeat([0.0, 5.0, 12.0, 20.0, 35.0, 60.0, 90.0], [3, 2, 3, 1, 4, 2, 3])
    measured = 2 / (1 + 0.1 * times) + 0.02 * np.random.default_rng(0).normal(size=18)
    frame = pd.DataFrame({"t": times, "a": measured})
    law = cl.discover(cl.Trials.from_frame(frame, time="t", states=["a"]), order=1, library="poly:3")
    assert [name for name, used in zip(law.terms.names, law.support[0], strict=True) if used] == ["a^2"]


@pytest.mark.slow
def test_growth_to_a_limit_is_not_taken_for_jumps_between_resting_points():
    generator, times = np.random.default_rng(0), np.linspace(0, 16, 200)
    grown = 80 / (1 + 1.9 * np.exp(-0.6 * times))[:, np.newaxis]
    measured = grown * (1 + 0.05 * generator.standard_normal(grown.shape))
    law = cl.discover(cl.Trials.from_arrays(times, measured, names=["x"]), library="poly:3 + trigonometric", order=1)
    assert not law.uncertainty.error_model.of_law
    assert law.simulate(times, [28.0])["object"].states[-1] == pytest.approx([80.0], rel=0.02)


def test_coefficients_do_not_depend_on_when_time_begins():
    drops = cl.datasets.linear_drag(noise=0.01)
    late = drops.with_trials([replace(drop, times=drop.times + 1.7e9) for drop in drops])
    method = cl.WeakRegression(solver="group-stlsq:0")
    early, later = (cl.discover(each, order=2, library="poly:1", method=method).coefficients for each in (drops, late))
    np.testing.assert_allclose(later, early, rtol=1e-6)


def test_the_structure_of_states_with_names_of_several_words_is_an_equation():
    times = np.linspace(0, 10, 40)
    level = 1 + 2 * np.exp(-0.5 * times) + 0.01 * np.random.default_rng(0).standard_normal(40)
    trials = cl.Trials.from_frame(pd.DataFrame({"time (s)": times, "water level (m)": level}))
    law = cl.discover(trials, order=1, library="poly:2", cache=False)
    assert law.structure == ("`water level`' = a + b `water level`",)
    assert cl.fit(law.structure, trials).structure == law.structure
