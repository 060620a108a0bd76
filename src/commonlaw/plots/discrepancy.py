"""What a law leaves unexplained, as a function of a coordinate."""

import numpy as np
from matplotlib.figure import Figure

from commonlaw.discrepancy.function import Discrepancy
from commonlaw.law import Law
from commonlaw.law.quantiles import two_sided
from commonlaw.plots.style import COLORS, GREY, add_legend, frozen_layout, key, plain, styled

_POINTS = 200
_BINS = 40
_BEYOND = 0.15
"""Share of the visited range that is drawn on both sides of it."""


@styled()
def plot_discrepancy(found: Discrepancy[Law]) -> Figure:
    """Plot the function with its 95 % band, and below it how many samples are where.

    Beyond what was visited, between the dotted lines, the band is that of a forecast.

    Parameters
    ----------
    found
        What `Law.discrepancy` returned.
    """
    basis, more = found.basis, _BEYOND * found.basis.range
    along = np.linspace(basis.low - more, basis.high + more, _POINTS)
    function, half = found(along), two_sided(0.95) * found.std(along)
    figure = Figure(figsize=(5.4, 4.4), layout="constrained")
    grid = figure.add_gridspec(2, 1, height_ratios=(4, 1))
    upper = figure.add_subplot(grid[0])
    lower = figure.add_subplot(grid[1], sharex=upper)
    upper.fill_between(along, function - half, function + half, color=COLORS[0], alpha=0.18, linewidth=0)
    upper.plot(along, function, color=COLORS[0])
    upper.axhline(0.0, color=GREY, linewidth=0.8)
    for end in (basis.low, basis.high):
        upper.axvline(end, color=GREY, linestyle=":", linewidth=0.8)
    upper.tick_params(labelbottom=False)
    left = found.equation if basis.times == "1" else f"{found.equation} over {basis.times}"
    upper.set_ylabel(plain(f"discrepancy of {left}", 40))
    upper.set_title(plain(f"2 log B = {found.evidence:.1f} against the law alone", 60), loc="left")
    lower.hist(found.visited, bins=_BINS, color=GREY)
    lower.set_ylabel("samples")
    lower.set_xlabel(plain(basis.coordinate, 60))
    keys = [key("function", color=COLORS[0]), key("95 % band", color=COLORS[0], linewidth=6, alpha=0.3)]
    add_legend(figure, keys, above=True)
    return frozen_layout(figure)
