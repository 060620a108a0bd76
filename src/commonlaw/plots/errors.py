"""What forecasts are off, all trials in one figure."""

import numpy as np
from matplotlib.figure import Figure

from commonlaw.forecast import Forecast
from commonlaw.plots.forecast import Curve, curves_of
from commonlaw.plots.style import COLORS, GREY, add_legend, axis_label, frozen_layout, key, styled

_MOST_POINTS = 1500
"""Of a panel; of more, each but every so many is drawn."""

_FAR = 3
"""Times the errors that all but a hundredth are below; those farther off are not shown."""


@styled()
def plot_errors(forecast: Forecast) -> Figure:
    """Plot forecast minus measured states against time, a panel for each state, all trials together.

    Errors outside of the 95 % band of their forecast, where it has one, are orange; axes show all but those of the
    farthest hundredth that are three times as large as all others.

    Parameters
    ----------
    forecast
        What `Law.predict` returned.
    """
    schema = forecast.trials.schema
    states, curves = schema.states, curves_of(forecast, forecast)
    figure = Figure(figsize=(5.2, 0.8 + 2.2 * len(states)), layout="constrained")
    panels = figure.subplots(len(states), 1, sharex=True, squeeze=False)[:, 0]
    some_outside = False
    for j, (panel, state) in enumerate(zip(panels, states, strict=True)):
        own = [curve for name in forecast.trials.objects for curve in curves[name, j]]
        times, errors, outside = np.concatenate([_errors(each) for each in own], axis=1)
        some_outside |= bool(outside.any())
        every = -(-len(times) // _MOST_POINTS) or 1
        panel.axhline(0, color=GREY, linewidth=0.8)
        for kind, color in ((outside == 0, COLORS[0]), (outside == 1, COLORS[1])):
            panel.plot(times[kind][::every], errors[kind][::every], "o", color=color, markersize=3, alpha=0.5, mew=0)
        if len(errors):
            usual, largest = np.quantile(np.abs(errors), [0.99, 1.0])
            bound = 1.1 * min(_FAR * usual, largest) or 1.0
            panel.set_ylim(-bound, bound)
        panel.set_ylabel(axis_label(f"error of {state}", schema.units.get(state, "")))
    panels[-1].set_xlabel(axis_label(schema.time, schema.units.get(schema.time, "")))
    if forecast.std is not None:
        dot = {"marker": "o", "linestyle": "", "markersize": 4}
        keys = [key("within the 95 % band", color=COLORS[0], **dot), key("outside", color=COLORS[1], **dot)]
        add_legend(figure, keys if some_outside else keys[:1], above=True)
    return frozen_layout(figure)


def _errors(curve: Curve) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, errors and whether the band did not hold them, each of shape (n,)."""
    low, high = (np.interp(curve.compared, curve.at, end - curve.forecast) for end in (curve.low, curve.high))
    known = bool((curve.high > curve.low).any())
    outside = ((-curve.error < low) | (-curve.error > high)) if known else np.zeros(len(curve.error))
    return curve.compared, curve.error, outside.astype(np.float64)
