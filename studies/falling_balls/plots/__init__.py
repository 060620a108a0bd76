"""Figures that only this study draws."""

from studies.falling_balls.plots.curves import Curve, plot_curves
from studies.falling_balls.plots.displacement import plot_displacement
from studies.falling_balls.plots.drag_regimes import plot_drag_regimes
from studies.falling_balls.plots.errors import plot_errors
from studies.falling_balls.plots.heat_maps import plot_heat_maps
from studies.falling_balls.plots.objects import plot_by_object
from studies.falling_balls.plots.properties import plot_property
from studies.falling_balls.plots.strobe import plot_strobe

__all__ = [
    "Curve",
    "plot_by_object",
    "plot_curves",
    "plot_displacement",
    "plot_drag_regimes",
    "plot_errors",
    "plot_heat_maps",
    "plot_property",
    "plot_strobe",
]
