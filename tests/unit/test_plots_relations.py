"""The figure of what decides coefficients."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from scipy.stats import t

import commonlaw as cl
from commonlaw.plots import plot_relations, relations, render
from commonlaw.plots.style import COLORS, MARKERS
from tests.refusals import refused

MASSES = (0.3, 0.15, 0.1, 0.06, 0.043)


@pytest.fixture(scope="module")
def law():
    """Drag by mass, and gravity that is universal."""
    drops = cl.datasets.linear_drag(drag=tuple(-0.03 / each for each in MASSES), noise=0.01)
    law = cl.fit("x'' = -g - c v", drops)
    return law.explain({name: {"mass": mass} for name, mass in zip(law.objects, MASSES, strict=True)})


def test_coefficients_stand_against_what_they_follow_with_their_intervals(law):
    gravity, drag = plot_relations(law).axes
    assert (gravity.get_title(loc="left"), drag.get_title(loc="left")) == (
        r"$1$ in $\ddot{x}$: universal",
        r"$v$ in $\ddot{x}$: power law",
    )
    assert (drag.get_xlabel(), drag.get_ylabel(), drag.get_xscale()) == ("mass", "−coefficient (1/s)", "log")
    own = law.uncertainty.unpooled
    points = np.array([each.get_xydata()[0] for each in drag.lines if each.get_marker() in MARKERS])
    np.testing.assert_allclose(points, np.column_stack([MASSES, -own.coefficients[:, 1]]))
    (line,) = [each for each in drag.lines if len(each.get_xdata()) > 2]
    np.testing.assert_allclose(
        line.get_ydata(), -law.uncertainty.explanation.relations[1].factors[0] / line.get_xdata()
    )
    bars = next(collection for collection in gravity.collections if isinstance(collection, LineCollection))
    reach = t.ppf(0.975, law.uncertainty.degrees_of_freedom[0])
    np.testing.assert_allclose(np.ptp(bars.get_segments()[0][:, 1]), 2 * reach * np.sqrt(own.covariance[0, 0, 0]))


def test_objects_collapse_onto_one_line_where_several_properties_decide(law):
    charges = np.array([1.0, 3.0, 2.0, 5.0, 4.0])
    changed = {
        name: {"mass": mass * charge, "charge": charge}
        for name, mass, charge in zip(law.objects, MASSES, charges, strict=True)
    }
    both = law.explain(changed)
    assert [str(exponent) for exponent in both.uncertainty.explanation.relations[1].exponents] == ["-1", "1"]
    figure = plot_relations(both)
    assert [panel.get_xlabel() for panel in figure.axes[1:]] == ["mass", "charge", "charge/mass"]
    lines = [sum(len(line.get_xdata()) > 2 for line in panel.lines) for panel in figure.axes[1:]]
    assert lines == [0, 0, 1]
    assert render(plot_relations(both), "svg") == render(plot_relations(both), "svg")


def test_each_objects_own_coefficients_have_the_range_of_their_scatter(law):
    own = law.explain([])
    panel = plot_relations(own).axes[1]
    relation = own.uncertainty.explanation.relations[1]
    (band,) = [collection for collection in panel.collections if isinstance(collection, PolyCollection)]
    ends = band.get_paths()[0].vertices[:, 1]
    expected = relation.factors[0] * np.exp(1.96 * relation.scatter * np.array([1, -1]))
    np.testing.assert_allclose([ends.min(), ends.max()], expected, rtol=1e-3)


def test_a_law_that_was_not_explained_is_refused():
    with refused("relations-missing-to-draw"):
        plot_relations(cl.datasets.linear_drag.truth())


def test_very_many_objects_are_not_told_apart(law, monkeypatch):
    monkeypatch.setattr(relations, "_NAMED", len(MASSES) - 1)
    figure = plot_relations(law)
    gravity = figure.axes[0]
    assert gravity.get_xlabel() == "objects"
    assert {line.get_color() for line in gravity.lines if len(line.get_xdata()) == 1} == {COLORS[0]}
    assert [each.get_text() for each in figure.legends[0].get_texts()] == ["relation"]
