"""Small figures of many objects, and their coefficients with intervals."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.plots import ForecastPanels, plot_errors, plot_forecast, plot_intervals, plot_law


@pytest.fixture(scope="module")
def drops():
    return cl.datasets.linear_drag(drag=(-0.1, -0.5), trials=2, noise=0.05)


@pytest.fixture(scope="module")
def law(drops):
    return cl.fit("x'' = -g - c v", drops, errors="white")


def test_objects_drawn_one_by_one_have_the_axes_that_they_have_side_by_side(law, drops):
    forecast = law.predict(drops, return_std=True)
    panels = ForecastPanels(forecast)
    together = plot_forecast(forecast).axes
    for name in drops.objects:
        above, below = panels.draw(name).axes
        assert above.get_ylim() == pytest.approx(together[0].get_ylim())
        assert below.get_ylim() == pytest.approx(together[1].get_ylim())
        assert above.get_ylabel() == "x (m)"
        measured = [line for line in above.lines if line.get_marker() == "o"]
        expected = [trial.states[:, 0] for trial in drops if trial.object == name]
        np.testing.assert_array_equal([line.get_ydata() for line in measured], expected)
        assert {line.get_markevery() for line in measured} == {2}


def test_many_objects_stand_in_the_order_of_their_coefficients(law):
    count = 60
    names = tuple(f"ball {i}" for i in range(count))
    some = np.random.default_rng(0).integers(0, 2, count)
    uncertainty = cl.law.Uncertainty(law.uncertainty.covariance[some], noise=law.uncertainty.noise)
    many = replace(law, objects=names, coefficients=law.coefficients[some], uncertainty=uncertainty, properties={})
    figure = plot_intervals(many)
    for panel in figure.axes:
        values = panel.lines[0].get_xdata()
        assert len(values) == count
        assert (np.diff(values) >= 0).all()
    assert [label.get_text() for label in plot_intervals(law).axes[0].get_yticklabels()] == list(law.objects)


def test_a_figure_of_many_objects_shows_some_from_the_best_to_the_worst():
    drags = [-0.1 - 0.02 * i for i in range(14)]
    drops, law = (
        cl.datasets.linear_drag(drag=drags, trials=1, noise=0.05),
        cl.datasets.linear_drag.truth(drag=drags),
    )
    forecast = law.predict(drops)
    ranked = forecast.errors().set_index("object")["rms error"].sort_values().index
    figure = plot_law(law, forecast)
    assert figure.get_figheight() < 15
    shown = [panel.get_title() for panel in figure.axes if panel.get_title().startswith("Ball")]
    assert len(shown) == 12
    assert {ranked[0], ranked[-1]} <= set(shown)
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == shown
    assert figure.legends[0].get_title().get_text().startswith("12 of 14 objects")
    named = plot_forecast(forecast, drops.objects)
    assert sum(panel.get_title().startswith("Ball") for panel in named.axes) == 14


def test_the_farthest_error_is_shown_unless_it_is_far_off(law, drops):
    forecast = law.predict(drops)
    for farther, shown in ((2.0, True), (50.0, False)):
        errors = forecast.to_frame()["x error"].abs()
        first = drops[0].states.copy()
        first[20] += farther * errors.quantile(0.99)
        changed = replace(forecast, trials=drops.with_trials([replace(drops[0], states=first), *drops[1:]]))
        largest = changed.to_frame()["x error"].abs().max()
        (low, high) = plot_errors(changed).axes[0].get_ylim()
        assert low == -high
        assert (high > largest) == shown
