"""Dots by object, and axis labels of curves."""

import numpy as np
import pytest
from matplotlib.patches import Rectangle

from studies.falling_balls.plots import Curve, plot_by_object, plot_curves

PANELS = {
    "one way": {"drop 1": {"Ball": 0.2, "Cube": 0.1}, "drop 2": {"Ball": 0.3}},
    "another": {"drop 2": {"Cone": 0.5}},
}


def _dots(panel):
    return {line.get_color(): (line.get_xdata(), line.get_ydata()) for line in panel.lines}


def test_each_object_has_a_line_of_its_own_the_first_at_the_top():
    left, right = plot_by_object(PANELS, "noise (m)").axes
    assert [label.get_text() for label in left.get_yticklabels()] == ["Ball", "Cube", "Cone"]
    assert left.get_ylim()[0] > left.get_ylim()[1]
    first, second = _dots(left).values()
    assert (list(first[0]), list(first[1])) == ([0.2, 0.1], [0, 1])
    assert (list(second[0]), list(second[1])) == ([0.3], [0])
    ((cone, index),) = _dots(right).values()
    assert (list(cone), list(index)) == ([0.5], [2])


def test_a_series_looks_alike_in_every_panel_and_is_in_the_legend_with_the_spans():
    figure = plot_by_object(PANELS, "noise (m)", {"printed": (0.15, 0.25)})
    left, right = figure.axes
    assert list(_dots(right)) == [list(_dots(left))[1]]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["drop 1", "drop 2", "printed"]
    for panel in (left, right):
        (span,) = panel.patches
        assert isinstance(span, Rectangle)
        assert (span.get_x(), span.get_width()) == pytest.approx((0.15, 0.1))
        assert panel.get_xlim()[0] == 0


def test_axes_of_curves_may_be_labelled_by_panel():
    line = [Curve("path", np.arange(3), np.arange(3))]
    figure = plot_curves({"a": line, "b": line}, {"a": "x (m)", "b": "t (s)"}, "y (m)", share_x=False)
    assert [panel.get_xlabel() for panel in figure.axes] == ["x (m)", "t (s)"]
