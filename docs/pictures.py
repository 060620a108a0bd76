"""Draws the picture of the first page and of the README, by `make pictures`."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import commonlaw as cl
from commonlaw.law import to_frame
from commonlaw.plots.style import COLORS, GREY, frozen_layout, styled

PICTURE = Path(__file__).parent / "first-page.png"


@styled()
def picture() -> Figure:
    """Return forecasts of simulated held-out drops, and the estimated and true coefficients."""
    drops = cl.datasets.linear_drag(noise=0.05, seed=1)
    law = cl.discover(drops.select(trial=1))
    figure = Figure(figsize=(7.6, 3.5), layout="constrained")
    grid = figure.add_gridspec(2, 3, width_ratios=[1.7, 1, 1], height_ratios=[2.2, 1])
    heights, errors = (figure.add_subplot(grid[row, 0]) for row in (0, 1))
    _draw_forecasts(heights, errors, law, law.predict(drops.select(trial=2), return_std=True))
    gravity, drag = (figure.add_subplot(grid[:, column]) for column in (1, 2))
    truth = cl.datasets.linear_drag.truth(noise=0.05, seed=1)
    _draw_coefficients(gravity, law, truth, "1", "gravity $a$ (m/s²)")
    _draw_coefficients(drag, law, truth, "v", "drag $b$ (1/s)")
    gravity.set_yticks(range(len(law.objects)), law.objects)
    figure.suptitle(r"$\ddot{x} = a + b\,\dot{x}$", fontsize=15)
    return frozen_layout(figure)


def _draw_forecasts(heights: Axes, errors: Axes, law: cl.Law, forecast: cl.Forecast) -> None:
    for color, trial, path, std in zip(COLORS, forecast.trials, forecast.trajectories, forecast.std, strict=False):
        measured, expected = trial.states[:, 0], path.states[:, 0]
        heights.plot(trial.times, measured, ".", ms=4, color=GREY)
        heights.plot(trial.times, expected, color=color, lw=1.2)
        errors.plot(trial.times, measured - expected, ".", ms=2.5, color=color)
        band = 1.96 * np.hypot(std[:, 0], law.uncertainty.noise[0])
        errors.fill_between(trial.times, -band, band, color=GREY, alpha=0.08, lw=0)
    heights.tick_params(labelbottom=False)
    heights.set(ylabel="height (m)", title="held-out drops")
    errors.set(xlabel="time (s)", ylabel="error (m)", ylim=(-0.25, 0.25))


def _draw_coefficients(axes: Axes, law: cl.Law, truth: cl.Law, term: str, name: str) -> None:
    table = law.params
    for y, row in enumerate(table[table["term"] == term].itertuples()):
        axes.plot([row.low, row.high], [y, y], color=COLORS[y], lw=2, solid_capstyle="round")
        axes.plot(row.estimate, y, "o", color=COLORS[y])
        axes.plot(to_frame(truth).loc[row.object, term], y, "|", color="black", ms=16)
    axes.set(yticks=[], ylim=(len(law.objects) - 0.5, -0.5), xlabel=name, title="95 % intervals, | true")


if __name__ == "__main__":
    cl.plots.save_figure(picture(), PICTURE)
