"""What a law of textbooks leaves unexplained."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from commonlaw.array_types import thinned
from commonlaw.discovery.textbook import TextbookLaw
from commonlaw.discrepancy.residual_tests import Residuals
from commonlaw.law.quantiles import two_sided
from commonlaw.plots.forecast import trial_colors
from commonlaw.plots.style import COLORS, GREY, add_legend, axis_label, fitting, frozen_layout, key, plain, styled
from commonlaw.runtime.arguments import checks_types


@styled()
@checks_types
def plot_textbook(textbook: TextbookLaw) -> Figure:
    """Plot what a law of textbooks leaves of each state, against the time since the start of the trial.

    Residuals, measured minus fitted states, of the chosen law and of that of textbooks; one line for each trial, in
    the colour of its object if there are several. 95 % of the noise by the chosen law lies in the grey band.
    """
    schema, elapsed = textbook.residuals[1].trials.schema, textbook.residuals[1].trials.schema.time
    pairs = [("chosen law", textbook.residuals[1])]
    if not textbook.is_chosen:
        pairs.append((textbook.title, textbook.residuals[0]))
    states = [schema.states.index(name) for name in schema.measured]
    figure = Figure(figsize=fitting(1.0 + 3.6 * len(pairs), 0.9 + 2.4 * len(states)), layout="constrained")
    grid = figure.subplots(len(states), len(pairs), sharex=True, sharey="row", squeeze=False)
    for row, j in zip(grid, states, strict=True):
        for panel, (title, residuals) in zip(row, pairs, strict=True):
            half = two_sided(0.95) * _noise(textbook.residuals[1], j)
            panel.axhspan(-half, half, color=GREY, alpha=0.25, linewidth=0)
            panel.axhline(0.0, color="black", linewidth=0.8)
            _draw(panel, residuals, j)
            panel.set_title(plain(title), loc="left")
        row[0].set_ylabel(axis_label(f"residual of {schema.states[j]}", schema.units.get(schema.states[j], "")))
    for panel in grid[-1]:
        panel.set_xlabel(axis_label(f"{elapsed} since the start", schema.units.get(elapsed, "")))
    add_legend(figure, [key("95 % of the noise", color=GREY, linewidth=6, alpha=0.3)], "above")
    return frozen_layout(figure)


def _draw(panel: Axes, residuals: Residuals, j: int) -> None:
    objects, colors = residuals.trials.objects, trial_colors(residuals.trials)
    for trial, fitted in zip(residuals.trials, residuals.fitted, strict=True):
        missed = trial.states[:, j] - fitted[:, j]
        seen = np.flatnonzero(np.isfinite(missed))
        every = seen[thinned(len(seen), 400)]
        color = COLORS[objects.index(trial.object) % len(COLORS)] if len(objects) > 1 else colors[trial.name]
        panel.plot(trial.elapsed[every], missed[every], ".-", color=color, markersize=3, linewidth=0.7)


def _noise(residuals: Residuals, j: int) -> float:
    """Return the standard deviation of the noise of a state, in which standardized residuals are."""
    pairs = zip(residuals.trials, residuals.fitted, residuals.standardized, strict=True)
    both = [(trial.states[:, j] - fitted[:, j], z[:, j]) for trial, fitted, z in pairs]
    squares, standardized = (sum(float(np.nansum(part**2)) for part in column) for column in zip(*both, strict=True))
    return float(np.sqrt(squares / standardized)) if standardized else 0.0
