"""Figures: trials, libraries, coefficients, forecasts and laws, each as a matplotlib figure.

No function touches pyplot, a display, or matplotlib's settings. Show a figure in a notebook, change it with
matplotlib, or write it with `save_figure`. The layout is frozen; after adding to a figure,
``figure.set_layout_engine("constrained")`` makes room for what was added.
"""

from commonlaw.errors import CommonlawError

try:
    from matplotlib.figure import Figure
except ValueError as error:
    raise CommonlawError("matplotlib-failed", error=error) from None

from commonlaw.plots.forecast import ForecastPanels, plot_design, plot_forecast, plot_trials
from commonlaw.plots.law import IntervalPanels, plot_coefficients, plot_intervals, plot_law, plot_profile
from commonlaw.plots.library import plot_library, plot_path
from commonlaw.plots.phase_plane import plot_phase_plane
from commonlaw.plots.relations import plot_relations
from commonlaw.plots.residuals import ResidualPanels, plot_discrepancy, plot_errors, plot_residuals
from commonlaw.plots.style import figure_format, render, save_figure
from commonlaw.plots.textbook import plot_textbook
from commonlaw.runtime.notebooks import show_type

__all__ = [
    "Figure",
    "ForecastPanels",
    "IntervalPanels",
    "ResidualPanels",
    "figure_format",
    "plot_coefficients",
    "plot_design",
    "plot_discrepancy",
    "plot_errors",
    "plot_forecast",
    "plot_intervals",
    "plot_law",
    "plot_library",
    "plot_path",
    "plot_phase_plane",
    "plot_profile",
    "plot_relations",
    "plot_residuals",
    "plot_textbook",
    "plot_trials",
    "render",
    "save_figure",
]

# Notebooks show figures by themselves only once pyplot is there, which draws nothing here
show_type(Figure, lambda figure: render(figure, ".svg").decode())
