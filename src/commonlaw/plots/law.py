"""A law at a glance: its equations, its coefficients, and how well it fits."""

import numpy as np
from matplotlib.figure import Figure

from commonlaw.forecast import Forecast, fitted
from commonlaw.law import Law
from commonlaw.law.alignment import has_bands
from commonlaw.plots.coefficients import DotPlot, HeatMaps
from commonlaw.plots.equations import equation_lines
from commonlaw.plots.forecast import (
    ROW_HEIGHT,
    draw_forecast,
    forecast_grid,
    forecast_keys,
    of_objects,
    omission,
    representative,
)
from commonlaw.plots.style import add_legend, fitting, frozen_layout, styled
from commonlaw.trials import Trials


@styled()
def plot_law(law: Law, trials: Trials | Forecast, truth: Law | None = None) -> Figure:
    """Plot a law: its equations, its fit to trials with residuals, and its coefficients.

    Curves start at initial conditions estimated from all samples of each trial. If the covariance is known,
    coefficients have 95 % intervals and curves 95 % bands. Laws in discrete time are shown by forecasts. If there are
    many objects, those shown are evenly spaced by the rank of their RMS error; `plot_forecast` shows others.

    Raises `CommonlawError` if the law cannot be fitted to the trials, see `Law.predict`.

    Parameters
    ----------
    law
        The law.
    trials
        Measurements to fit, or a forecast to draw instead.
    truth
        The true law of simulated data; its coefficients are open markers.
    """
    if isinstance(trials, Forecast):
        forecast = trials
    else:
        forecast = law.predict(trials) if law.order == 0 else fitted(law, trials, has_bands(law))
    names = representative(forecast)
    shown, left_out = of_objects(forecast, names), omission(forecast, names)
    if left_out and (known := [name for name in law.objects if name in names]):
        law = law.select(known)
    true = () if truth is None else [truth.terms.names[k] for k in np.flatnonzero(truth.support.any(axis=0))]
    dots = DotPlot(law, truth)
    maps = HeatMaps(law, law.support.any(axis=0) | np.isin(law.terms.names, true), truth)
    coefficients = dots if 0 < len(dots.coefficients) <= 12 else maps
    columns, lines = forecast_grid(shown)
    equations = equation_lines(law)
    heights = (ROW_HEIGHT * lines, 0.4 + coefficients.height)
    width = max(coefficients.width, 1.2 + 2.4 * max(columns, 2))
    size = fitting(width, 1.4 + 0.3 * equations.count("\n") + sum(heights))
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle(equations)
    indices = figure.add_gridspec(2, 1, height_ratios=heights)
    coefficients.draw(figure, indices[1])
    draw_forecast(figure, indices[0], shown, columns)
    add_legend(figure, [*coefficients.keys(), *forecast_keys(shown)], "below", left_out)
    return frozen_layout(figure)
