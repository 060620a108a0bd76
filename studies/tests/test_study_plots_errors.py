"""Dots by category show every number, do not cover each other, and say when a number is infinite."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from commonlaw.plots import render
from studies.falling_balls.plots import plot_errors

NAMES = [f"Ball {i}" for i in range(1, 11)]


def errors(seed: int = 1) -> dict[str, dict[str, dict[str, float]]]:
    """Ten objects with errors so close that dots on a line would cover each other."""
    draw = np.random.default_rng(seed)
    return {
        title: {model: dict(zip(NAMES, 1 + 0.02 * draw.random(10), strict=True)) for model in ("small", "large")}
        for title in ("first", "second")
    }


def dots(panel: Axes) -> list[Line2D]:
    return [line for line in panel.get_lines() if line.get_marker() != "None"]


def medians(panel: Axes) -> list[float]:
    return [float(line.get_ydata()[0]) for line in panel.get_lines() if line.get_marker() == "None"]


def legend(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_each_number_is_a_dot_in_its_category_and_each_median_a_line() -> None:
    data = errors()
    figure = plot_errors(data, "error (m)")
    assert [panel.get_title() for panel in figure.axes] == list(data)
    assert figure.axes[0].get_ylabel() == "error (m)"
    assert legend(figure) == [*NAMES, "median"]
    for panel, groups in zip(figure.axes, data.values(), strict=True):
        shown = [(round(float(dot.get_xdata()[0])), dot.get_label(), float(dot.get_ydata()[0])) for dot in dots(panel)]
        assert shown == [(i, *each) for i, group in enumerate(groups.values()) for each in group.items()]
        assert medians(panel) == [np.median(list(group.values())) for group in groups.values()]
        assert panel.get_ylim()[0] == 0


def test_dots_do_not_cover_each_other() -> None:
    for panel in plot_errors(errors(), "error (m)").axes:
        inches = panel.transData.transform([dot.get_xydata()[0] for dot in dots(panel)]) / panel.figure.dpi
        apart = np.hypot(*(inches[:, None] - inches[None]).T)
        size = dots(panel)[0].get_markersize() / 72
        assert np.min(apart + np.eye(len(apart))) > size


def test_an_object_looks_alike_everywhere_and_no_two_look_alike() -> None:
    looks = {
        (dot.get_label(), dot.get_color(), dot.get_marker())
        for panel in plot_errors(errors(), "error (m)").axes
        for dot in dots(panel)
    }
    assert len(looks) == len({look[1:] for look in looks}) == len(NAMES)


def test_an_infinite_number_is_an_open_mark_at_the_upper_edge() -> None:
    data = errors()
    data["first"]["large"]["Ball 3"] = np.inf
    figure = plot_errors(data, "error (m)")
    panel = figure.axes[0]
    (lost,) = [dot for dot in dots(panel) if dot.get_markerfacecolor() == "none"]
    assert (lost.get_label(), lost.get_ydata()[0]) == ("Ball 3", panel.get_ylim()[1])
    assert np.isfinite(panel.get_ylim()).all()
    assert legend(figure)[-1] == "infinite"
    assert medians(panel)[1] == np.median(list(data["first"]["large"].values()))


def test_a_median_that_is_infinite_is_not_drawn() -> None:
    data = {"": {"all lost": dict.fromkeys(NAMES, np.inf)}}
    assert medians(plot_errors(data, "error (m)").axes[0]) == []


def test_the_same_numbers_give_the_same_bytes() -> None:
    first, second = (render(plot_errors(errors(), "error (m)"), ".svg") for _ in range(2))
    assert first == second
