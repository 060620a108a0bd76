"""Figures: trials, libraries, coefficients, forecasts and laws, each as a matplotlib figure.

No function touches pyplot, a display, or matplotlib's settings. Show a figure in a notebook, change it with
matplotlib, or write it with `save_figure`. The layout is settled; after adding to a figure,
``figure.set_layout_engine("constrained")`` makes room for what was added.
"""

from matplotlib.figure import Figure

from commonlaw.plots.coefficients import plot_coefficients
from commonlaw.plots.curves import Curve, plot_curves
from commonlaw.plots.drag_regimes import plot_drag_regimes
from commonlaw.plots.errors import plot_errors
from commonlaw.plots.forecast import plot_forecast
from commonlaw.plots.heat_maps import plot_heat_maps
from commonlaw.plots.law import plot_law
from commonlaw.plots.library import plot_library
from commonlaw.plots.objects import plot_by_object
from commonlaw.plots.path import plot_path
from commonlaw.plots.properties import plot_property
from commonlaw.plots.render import render, save_figure
from commonlaw.plots.strobe import plot_strobe
from commonlaw.plots.trials import plot_trials

__all__ = [
    "Curve",
    "Figure",
    "plot_by_object",
    "plot_coefficients",
    "plot_curves",
    "plot_drag_regimes",
    "plot_errors",
    "plot_forecast",
    "plot_heat_maps",
    "plot_law",
    "plot_library",
    "plot_path",
    "plot_property",
    "plot_strobe",
    "plot_trials",
    "render",
    "save_figure",
]
