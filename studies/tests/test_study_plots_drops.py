"""Figures of drops and drag: what they show is what they are given."""

from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from commonlaw import datasets
from commonlaw.datasets.sphere_drag import MAX_REYNOLDS, drag_coefficient
from commonlaw.trials import Schema, Trial, Trials
from studies.falling_balls.plots import plot_displacement, plot_drag_regimes, plot_property, plot_strobe
from tests.refusals import refused

TIMES = np.arange(20) / 15
TRIALS = datasets.linear_drag(drag=(-0.1, -0.5, -0.7), trials=2)
VALUES = {"drop 1": {"Ball 1": 1.0, "Ball 2": 2.0, "Ball 3": 3.0}, "drop 2": {"Ball 1": 4.0, "Ball 3": 5.0}}


def legend_of(figure: Figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def points(panel: Axes) -> list[tuple[list[float], list[float]]]:
    return [(np.asarray(line.get_xdata()).tolist(), np.asarray(line.get_ydata()).tolist()) for line in panel.lines]


def with_property(name: str, values: dict[str, float | str]) -> Trials:
    trials = tuple(Trial(ball, "1", TIMES, -4.9 * TIMES**2) for ball in ("Ball 1", "Ball 2", "Ball 3"))
    return Trials(
        trials, Schema(("x",), units={name: "kg/m^3"}), {ball: {name: value} for ball, value in values.items()}
    )


def test_the_strobe_has_a_column_for_each_trial_with_a_marker_at_every_few_samples() -> None:
    (panel,) = plot_strobe(TRIALS, every=5).axes
    columns = [line for line in panel.lines if line.get_marker() != "None"]
    assert len(columns) == len(TRIALS)
    for i, (line, trial) in enumerate(zip(columns, TRIALS, strict=True)):
        np.testing.assert_array_equal(line.get_xdata(), np.full(10, i))
        np.testing.assert_array_equal(line.get_ydata(), trial.states[::5, 0])
    assert panel.get_ylabel() == "x (m)"
    assert panel.get_title(loc="left") == "every 5th sample"
    assert [label.get_text() for label in panel.get_xticklabels()][:2] == ["Ball 1,\ntrial 1", "Ball 1,\ntrial 2"]


def test_lines_of_the_strobe_join_the_same_sample_of_all_trials_and_end_with_the_shortest() -> None:
    trials = Trials(tuple(Trial(name, "1", TIMES[:n], TIMES[:n]) for name, n in (("a", 9), ("b", 3))), Schema(("x",)))
    (panel,) = plot_strobe(trials, every=2).axes
    joined = [np.asarray(line.get_ydata()) for line in panel.lines if line.get_marker() == "None"]
    assert len(joined) == 5
    np.testing.assert_array_equal(np.transpose(joined)[0], TIMES[:9:2])
    np.testing.assert_array_equal(np.transpose(joined)[1], [*TIMES[:3:2], np.nan, np.nan, np.nan])
    assert [label.get_text() for label in panel.get_xticklabels()] == ["a", "b"]


def test_the_strobe_refuses_what_cannot_be_drawn() -> None:
    with refused("other"):
        plot_strobe(TRIALS, every=0)
    with refused("unknown-name", kind="state", name="y"):
        plot_strobe(TRIALS, state="y")


def test_displacement_is_logarithmic_and_free_fall_runs_along_the_guide_of_slope_two() -> None:
    trials = datasets.linear_drag(drag=[0.0], noise=0.0, trials=1)
    (panel,) = plot_displacement(trials).axes
    assert panel.get_xscale() == panel.get_yscale() == "log"
    assert panel.get_ylabel() == "|x − x(start)| (m)"
    times, states = trials[0].times, trials[0].states[:, 0]
    np.testing.assert_array_equal(points(panel)[0], (times[1:], np.abs(states - states[0])[1:]))
    slopes = [np.polyfit(*np.log(points(panel)[i]), 1)[0] for i in range(3)]
    np.testing.assert_allclose(slopes, [2, 1, 2], rtol=1e-6)


def test_the_displacement_of_a_state_that_does_not_change_is_said_in_words() -> None:
    still = Trials((Trial("stone", "1", np.arange(3.0), np.ones(3)),), Schema(("x",)))
    (panel,) = plot_displacement(still).axes
    assert [text.get_text() for text in panel.texts] == ["x does not change"]


def test_objects_stand_at_their_property_with_a_panel_for_each_title() -> None:
    trials = with_property("density", {"Ball 1": 70.0, "Ball 3": 1000.0})
    figure = plot_property(trials, "density", VALUES, "landing time (s)")
    assert [panel.get_title() for panel in figure.axes] == ["drop 1", "drop 2"]
    assert points(figure.axes[0]) == [([70.0], [1.0]), ([1000.0], [3.0])]
    assert points(figure.axes[1]) == [([70.0], [4.0]), ([1000.0], [5.0])]
    assert legend_of(figure) == ["Ball 1", "Ball 3"]
    assert [panel.get_xlabel() for panel in figure.axes] == ["density (kg/m³)"] * 2
    assert figure.axes[0].get_ylabel() == "landing time (s)"
    assert {line.get_markerfacecolor() for panel in figure.axes for line in panel.lines} == {"none"}


@pytest.mark.parametrize(("largest", "scale"), [(9.0, "linear"), (10.0, "log")])
def test_the_axis_of_a_property_is_logarithmic_from_a_decade_on(largest: float, scale: str) -> None:
    trials = with_property("density", {"Ball 1": 1.0, "Ball 2": largest})
    assert {panel.get_xscale() for panel in plot_property(trials, "density", VALUES, "y").axes} == {scale}


def test_a_property_that_no_axis_can_show_is_refused_by_name() -> None:
    with refused("unknown-name", kind="property", name="dens"):
        plot_property(with_property("density", {"Ball 1": 1.0}), "dens", VALUES, "y")
    with refused("other"):
        plot_property(with_property("density", {"Ball 1": "high"}), "density", VALUES, "y")


def test_the_drag_curve_is_dashed_where_the_correlation_does_not_hold() -> None:
    (panel,) = plot_drag_regimes().axes
    assert panel.get_xscale() == panel.get_yscale() == "log"
    sure, beyond, stokes = panel.lines
    assert (sure.get_linestyle(), beyond.get_linestyle()) == ("-", "--")
    assert np.max(sure.get_xdata()) == pytest.approx(MAX_REYNOLDS) == np.min(beyond.get_xdata())
    np.testing.assert_allclose(sure.get_ydata(), drag_coefficient(np.asarray(sure.get_xdata())))
    np.testing.assert_allclose(np.asarray(stokes.get_ydata()) * np.asarray(stokes.get_xdata()), 24)


def test_each_object_has_a_bar_over_its_reynolds_numbers_below_the_curve() -> None:
    ranges = {"Golf Ball": (2e3, 8e4), "Blue Basketball": (1e4, 4e5)}
    upper, lower = plot_drag_regimes(ranges).axes
    assert points(lower) == [([2e3, 8e4], [0, 0]), ([1e4, 4e5], [1, 1])]
    assert [label.get_text() for label in lower.get_yticklabels()] == list(ranges)
    assert lower.get_ylim()[0] > lower.get_ylim()[1]
    assert upper.get_xlim() == lower.get_xlim()
    assert lower.get_xlabel() == "Reynolds number"


@pytest.mark.parametrize(
    "draw",
    [
        lambda: plot_strobe(TRIALS),
        lambda: plot_displacement(TRIALS),
        lambda: plot_property(with_property("density", {"Ball 1": 7.0, "Ball 2": 100.0}), "density", VALUES, "y (s)"),
        plot_drag_regimes,
        lambda: plot_drag_regimes({"A ball with a very long name indeed": (1.0, 1e6)}),
    ],
)
def test_nothing_is_clipped(draw: Callable[[], Figure]) -> None:
    figure = draw()
    figure.draw_without_rendering()
    box, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    assert min(box.x0, box.y0, width - box.x1, height - box.y1) > -0.02
