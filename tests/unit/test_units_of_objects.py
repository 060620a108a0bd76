"""An object that was measured in other units is noted, and scatter between objects is not."""

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
