"""A law as figures: its coefficients, and with its equations how well it fits."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.markers import CARETLEFT, CARETRIGHT
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator

from commonlaw.array_types import Bools, Floats, evenly_spaced
from commonlaw.errors import check_choice
from commonlaw.estimation import likelihood_profile
from commonlaw.forecast import Forecast, fitted
from commonlaw.hierarchy import informative
from commonlaw.law import Law, select_objects
from commonlaw.law.parameters import equation_label, left_hand_sides, named_parameters, tabulated_parameters
from commonlaw.law.text import MANY, one_sided_text, with_error
from commonlaw.library.notation import latex_name
from commonlaw.plots.equations import equation_labels, equation_lines, parameter_label, term_labels
from commonlaw.plots.forecast import draw_forecast, forecast_grid, forecast_keys, of_objects, omission, representative
from commonlaw.plots.style import (
    ABSENT,
    COLORS,
    GREY,
    add_legend,
    fitting,
    frozen_layout,
    key,
    math,
    number_text,
    plain,
    powers_of_ten,
    styled,
    unit_text,
)
from commonlaw.runtime.arguments import checks_types
from commonlaw.runtime.forking import cached_property
from commonlaw.summary import true_coefficients
from commonlaw.trials import Trials

_DOT: Mapping[str, Any] = {"color": COLORS[0], "marker": "o", "linestyle": ""}
_TICK: Mapping[str, Any] = {**_DOT, "marker": "|", "markersize": 11, "markeredgewidth": 1.6}
"""An estimate, so thin that its interval can be seen."""
_BAR: Mapping[str, Any] = {"color": COLORS[0], "alpha": 0.4, "linewidth": 6}
_FRAME = {"markersize": 9, "markerfacecolor": "none", "markeredgewidth": 1.2}
_OPEN: Mapping[str, Any] = {**_DOT, "color": "black", **_FRAME}


@dataclass(frozen=True)
class Coefficient:
    """One coefficient of every object: equation, left-hand side, term, labels; values, shape (objects,), and intervals.

    It is a coefficient by its name where the law was given as equations. Unknown names and units are empty, unknown
    values NaN, and unknown standard errors zero. Where only a limit is known there is no estimate, and one end.
    """

    equation: int
    left: str
    name: str
    term: str
    parameter: str
    unit: str
    learned: Floats
    true: Floats
    errors: Floats
    low: Floats
    high: Floats

    @property
    def label(self) -> str:
        """Its parameter and unit, as far as there are any."""
        return " ".join(filter(None, (self.parameter, f"({self.unit})" if self.unit else "")))

    @property
    def limits(self) -> Floats:
        """The ends of intervals that have one only, NaN elsewhere, shape (objects,)."""
        is_limited = np.isnan(self.learned) & (np.isfinite(self.low) ^ np.isfinite(self.high))
        return np.where(is_limited, np.where(np.isfinite(self.low), self.low, self.high), np.nan)

    @property
    def numbers(self) -> Floats:
        """Its estimates, true values, standard errors and ends of intervals, shape (5, objects)."""
        return np.array([self.learned, self.true, self.errors, self.low, self.high])


@dataclass(frozen=True, eq=False)
class DotPlot:
    """The coefficients of a law, and of the true one if it is known, as dots.

    Several objects have a line each in a panel for each coefficient, a single one a line for each in that of its
    equation.
    """

    law: Law
    truth: Law | None = None

    @cached_property
    def coefficients(self) -> list[Coefficient]:
        """All coefficients that are in the law or in the truth, equation by equation."""
        law, known, result = self.law, _true_terms(self.law, self.truth), list[Coefficient]()
        labels, lefts, is_named = term_labels(law.terms), left_hand_sides(law), self._by_parameter
        support = law.support if known is None else np.ones_like(law.support)
        parameters = tabulated_parameters(law, None if is_named else support)
        low, high = (parameters.values,) * 2 if law.uncertainty.covariance is None else parameters.intervals()
        errors = np.where(parameters.limited, 0.0, np.nan_to_num(parameters.errors))
        for i, (definition, unit) in enumerate(zip(parameters.definitions, parameters.units, strict=True)):
            j, k, name = definition.equation, definition.term, definition.name
            learned = parameters.values[:, i] if is_named else absent_as_nan(parameters.values[:, i])
            true = np.full_like(learned, np.nan) if known is None else definition.of(known)
            if is_named:
                label = math(latex_name(name), name)
                where = j, equation_label(law, j, k), name, label, label
            else:
                # The equations of an explained law have parameters of their own
                name = parameter_label(law, j, k) if law.uncertainty.explanation is None else ""
                where = j, lefts[j], law.terms.names[k], labels[k], name
            learned = np.where(parameters.limited[:, i], np.nan, learned)
            if np.any(np.isfinite([learned, true])) or parameters.limited[:, i].any():
                numbers = learned, true, errors[:, i], low[:, i], high[:, i]
                result.append(Coefficient(*where, unit_text(unit or ""), *numbers))
        return result

    @property
    def _by_parameter(self) -> bool:
        """Whether the law's own parameters are shown, if it has any; the equations of an explained law have others."""
        is_explained = self.law.uncertainty.explanation is not None
        return bool(self.law.provenance.equations and named_parameters(self.law).names) and not is_explained

    @property
    def several(self) -> bool:
        """Whether there are several objects."""
        return len(self.law.objects) > 1

    @property
    def columns(self) -> int:
        """Number of panels side by side."""
        count = len(self.coefficients)
        return (2 if count == 4 else max(1, min(count, 3))) if self.several else 1

    @property
    def lines(self) -> int:
        """Number of lines of panels."""
        return max(1, -(-len(self.coefficients) // self.columns)) if self.several else len(self.law.schema.states)

    @property
    def width(self) -> float:
        """Width in inches."""
        return 1.6 + 1.9 * self.columns if self.several else 4.5 if self.law.uncertainty.covariance is None else 5.5

    @property
    def height(self) -> float:
        """Least height in inches."""
        marks = len(self.law.objects) * self.lines if self.several else len(self.coefficients)
        return 0.9 * self.lines + 0.24 * marks

    def draw(self, figure: Figure, index: SubplotSpec) -> None:
        """Draw into a part of a figure."""
        if self.several:
            grid = index.subgridspec(self.lines, self.columns)
            for i, coefficient in enumerate(self.coefficients):
                panel = figure.add_subplot(grid[i])
                self.draw_panel(panel, coefficient)
                panel.tick_params(labelleft=i % self.columns == 0)
                panel.set_title(self.title(coefficient))
        else:
            self._draw_lines(index)

    def title(self, each: Coefficient) -> str:
        """Return what stands above the panel of a coefficient: its term, and its equation if there are several."""
        if self._by_parameter:
            return each.term
        lefts = equation_labels(self.law)
        where = f"{lefts[each.equation]}: " if len(lefts) > 1 else ""
        return where + ("constant term" if each.term == "$1$" else f"{each.term} term")

    def keys(self) -> list[Line2D]:
        """Return what belongs into the legend."""
        known = [key("true", **_OPEN)] if any(np.isfinite(dot.true).any() for dot in self.coefficients) else []
        bars = [] if self.law.uncertainty.covariance is None else [key("95 % interval", **_BAR)]
        return [key("estimate", **_TICK), *bars, *known] if known or bars else []

    def draw_panel(self, panel: Axes, each: Coefficient) -> None:
        """Draw a coefficient of several objects."""
        _draw_dots(panel, each.numbers)
        panel.set_yticks(range(len(self.law.objects)), [plain(name, 22) for name in self.law.objects])
        panel.set_ylim(len(self.law.objects) - 0.5, -0.5)
        panel.margins(x=0.15)
        if (each.errors > 0).all():  # Those that say next to nothing reach beyond the panel
            says = informative(each.learned[:, np.newaxis], each.errors[:, np.newaxis] ** 2)[:, 0]
            ends = np.concatenate([each.low[says], each.high[says]])
            if not says.all() and np.isfinite(ends).all():
                panel.set_xlim(ends.min() - 0.15 * np.ptp(ends), ends.max() + 0.15 * np.ptp(ends))
        panel.locator_params(axis="x", nbins=4)
        panel.set_xlabel(each.label)

    def _draw_lines(self, index: SubplotSpec) -> None:
        groups = [[dot for dot in self.coefficients if dot.equation == j] for j in range(self.lines)]
        ratios = [1 + len(group) for group in groups]
        panels = index.subgridspec(self.lines, 1, height_ratios=ratios).subplots(sharex=True, squeeze=False)[:, 0]
        for panel, group, label in zip(panels, groups, equation_labels(self.law), strict=True):
            _draw_dots(panel, np.array([coefficient.numbers[:, 0] for coefficient in group]).reshape(-1, 5).T)
            for height, coefficient in enumerate(group):  # Its value, right of its dot and interval
                value, error = coefficient.learned[0], coefficient.errors[0]
                limit = one_sided_text(coefficient.low[0], coefficient.high[0])
                if np.isnan(value) and limit:
                    at = (coefficient.limits[0], height)
                    text = f"{limit} {coefficient.unit}".rstrip()
                    panel.annotate(text, at, (8, 0), textcoords="offset points", va="center", fontsize=9)
                elif np.isfinite(value):
                    number = powers_of_ten(with_error(value, error)) if error else number_text(value, 4)
                    at = (np.fmax(value, coefficient.high[0]), height)
                    text = f"{number} {coefficient.unit}".rstrip()
                    panel.annotate(text, at, (8, 0), textcoords="offset points", va="center", fontsize=9)
            panel.set_yticks(range(len(group)), [coefficient.term for coefficient in group])
            panel.set_ylim(len(group) - 0.4, -0.6)
            what = "parameters" if self._by_parameter else "terms"
            panel.set_title(f"{what} of {label}", loc="left")
            panel.margins(x=0.4 if self.law.uncertainty.covariance is None else 0.7)  # room for the printed values
        panels[-1].locator_params(axis="x", nbins=5)
        numbers = [[*coefficient.learned, *coefficient.true, *coefficient.limits] for coefficient in self.coefficients]
        values = np.abs(np.array(numbers, dtype=np.float64))
        values = values[np.isfinite(values) & (values > 0)]
        high = values.max(initial=0.0)
        low = max(values.min(initial=np.inf), high / 1e15)  # Matplotlib's scale overflows beyond
        panel, what = panels[-1], "coefficient"
        if high / 100 > low:
            what = "coefficient, on a logarithmic scale"
            panel.set_xscale("symlog", linthresh=low)
            # Matplotlib's own ticks for this scale run into each other around zero
            decades = 10.0 ** np.round(np.log10([np.sqrt(low) * np.sqrt(high), high]))
            panel.get_xlim()  # Has them set
            ticks = [0, *decades[::-1], *-decades[::-1]]
            at = (panel.transScale + panel.transLimits).transform([(tick, 0) for tick in ticks])[:, 0]
            apart = [tick for i, tick in enumerate(ticks) if (np.abs(at[i] - at[:i]) > 0.12).all()]
            panel.xaxis.set_major_locator(FixedLocator(apart))
            panel.xaxis.set_major_formatter("{x:g}")
            panel.xaxis.set_minor_locator(NullLocator())
        panel.set_xlabel(what)


def _draw_dots(panel: Axes, numbers: Floats) -> None:
    """Draw `Coefficient.numbers` below each other, with 95 % intervals where errors are known, or their only ends."""
    learned, true, errors, low, high = numbers
    heights = np.arange(len(learned))
    panel.plot(learned, heights, **_TICK)
    panel.plot(true, heights, **_OPEN)
    for end, opposite, marker in ((low, high, CARETRIGHT), (high, low, CARETLEFT)):
        alone = np.isnan(learned) & np.isfinite(end) & ~np.isfinite(opposite)
        if alone.any():
            panel.plot(end[alone], heights[alone], **{**_DOT, "marker": marker})
    if errors.any():
        both = np.isfinite(low) & np.isfinite(high)
        panel.hlines(heights[both], low[both], high[both], **_BAR)


@styled()
@checks_types
def plot_intervals(law: Law) -> Figure:
    """Plot the coefficients of all objects as ticks on bars of their 95 % intervals (a forest plot).

    Each object has a line; more than fifty objects are sorted by each coefficient, without names.
    """
    dots = DotPlot(law)
    if len(law.objects) > MANY:  # Each coefficient in the order of its size
        figure = Figure(figsize=(dots.width, 0.6 + 2.6 * dots.lines), layout="constrained")
        panels = figure.subplots(dots.lines, dots.columns, squeeze=False)
        for panel in panels.flat[len(dots.coefficients) :]:
            panel.set_visible(False)
        for panel, coefficient in zip(panels.flat, dots.coefficients, strict=False):
            _draw_in_order(panel, coefficient)
            panel.set_title(dots.title(coefficient))
        return frozen_layout(figure)
    figure = Figure(figsize=(dots.width, 0.8 + dots.height), layout="constrained")
    dots.draw(figure, figure.add_gridspec(1, 1)[0])
    add_legend(figure, dots.keys(), "above")
    return frozen_layout(figure)


@dataclass(frozen=True, eq=False)
class IntervalPanels:
    """Panels of `plot_intervals` for a law of several objects, each as a small figure.

    Examples
    --------
    >>> import commonlaw as cl
    >>> panels = IntervalPanels(cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.05, trials=1)))
    >>> panels.draw(0), len(panels.captions)
    (<Figure size ...>, 2)
    """

    law: Law

    @cached_property
    def captions(self) -> list[str]:
        """Captions of the panels."""
        before = "" if self.law.provenance.equations and self.law.uncertainty.explanation is None else "before "
        return [f"{before}{coefficient.name} in {coefficient.left}" for coefficient in self._dots.coefficients]

    @styled()
    def draw(self, panel: int) -> Figure:
        """Return the figure of a panel."""
        coefficient, named = self._dots.coefficients[panel], len(self.law.objects) <= MANY
        figure = Figure(figsize=(3.6, 0.8 + 0.2 * len(self.law.objects) if named else 2.8), layout="constrained")
        draw = self._dots.draw_panel if named else _draw_in_order
        draw(figure.add_subplot(), coefficient)
        return frozen_layout(figure)

    @cached_property
    def _dots(self) -> DotPlot:
        return DotPlot(self.law)


def _draw_in_order(panel: Axes, each: Coefficient) -> None:
    order = np.argsort(each.learned)
    # There are no more points across a page
    ranks = np.array(evenly_spaced(len(order), 1000))
    values, low, high = (numbers[order[ranks]] for numbers in (each.learned, each.low, each.high))
    panel.fill_betweenx(ranks, low, high, color=COLORS[0], alpha=0.25, linewidth=0)
    panel.plot(values, ranks, color=COLORS[0], linewidth=2)
    panel.set_xlabel(each.label)
    panel.locator_params(axis="x", nbins=4)
    panel.set_ylabel("objects in order")


@styled()
@checks_types
def plot_coefficients(law: Law, terms: Literal["all", "support"] = "all") -> Figure:
    """Plot a heat map of the magnitudes of the coefficients, objects by terms, for each equation.

    Colours are logarithmic, grey cells are absent terms, and values are printed if they fit (de Silva et al. 2020).

    Raises `CommonlawError` if `terms` is neither of these.

    Parameters
    ----------
    law
        The law.
    terms
        ``"all"`` candidate terms, or the ``"support"``: terms in one of the equations.
    """
    check_choice("choice of terms", terms, ("all", "support"))
    maps = HeatMaps(law, law.support.any(axis=0) | np.full(len(law.terms), terms == "all"))
    figure = Figure(figsize=(maps.width, maps.height), layout="constrained")
    maps.draw(figure, figure.add_gridspec(1, 1)[0])
    return frozen_layout(figure)


@dataclass(frozen=True, eq=False)
class HeatMaps:
    """Magnitudes of coefficients, objects by terms, one panel for each equation.

    The `chosen` terms, shape (terms,), default all, get a column; terms of the true law get a frame.
    """

    law: Law
    chosen: Bools
    truth: Law | None = None

    @cached_property
    def shown(self) -> Bools:
        """Which terms get a column: those chosen, or all of them to show that none is there."""
        return self.chosen if self.chosen.any() else np.ones_like(self.chosen)

    @cached_property
    def cell(self) -> float:
        """Width of a cell in inches."""
        return float(np.clip(6.5 / self.shown.sum(), 0.12, 0.66))

    @property
    def fits(self) -> bool:
        """Whether a number fits into a cell."""
        return self.cell > 0.6

    @cached_property
    def names(self) -> list[str]:
        """The objects as labels."""
        return [plain(name, 34) for name in self.law.objects]

    @property
    def width(self) -> float:
        """Width in inches."""
        margin = 0.5 + 0.08 * max(len(line) for name in self.names for line in name.split("\n"))
        return float(margin + max(self.cell * self.shown.sum(), 3.5))

    @property
    def height(self) -> float:
        """Height in inches."""
        return 1 + len(self.law.schema.states) * (0.7 + 0.34 * len(self.names))

    def draw(self, figure: Figure, index: SubplotSpec) -> None:
        """Draw into a part of a figure."""
        panels = index.subgridspec(len(self.law.schema.states), 1).subplots(squeeze=False)[:, 0]
        norm, known = scale(self.law.coefficients), _true_terms(self.law, self.truth)
        labels = [label for label, shown in zip(term_labels(self.law.terms), self.shown, strict=True) if shown]
        for j, (panel, equation) in enumerate(zip(panels, equation_labels(self.law), strict=True)):
            values = self.law.coefficients[:, j, self.shown]
            mesh = heat_map(panel, values, norm)
            panel.set_title(f"terms of {equation}" + ("" if values.any() else ": none is there"), loc="left")
            panel.set_xticks(np.arange(len(labels)) + 0.5, labels, rotation=0 if self.fits else 90)
            panel.set_yticks(np.arange(len(self.names)) + 0.5, self.names)
            if self.fits:
                # Print each coefficient in its cell, white on dark colours
                lightness = mesh.to_rgba(_magnitudes(values))[..., :3] @ (0.299, 0.587, 0.114)
                for i, k in np.argwhere(values):
                    color = "white" if lightness[i, k] < 0.5 else "black"
                    style = {"ha": "center", "va": "center", "fontsize": 9, "color": color}
                    panel.text(k + 0.5, i + 0.5, number_text(values[i, k], 3), **style)
            if known is not None:
                for i, k in np.argwhere(np.isfinite(known[:, j, self.shown])):
                    panel.add_patch(Rectangle((k, i), 1, 1, fill=False, edgecolor=COLORS[1], linewidth=2))
        if self.law.support.any():
            add_color_bar(figure, mesh, list(panels), self.width)

    def keys(self) -> list[Line2D]:
        """Return what belongs into the legend."""
        if self.truth is None:
            return []
        frame = {"marker": "s", "markersize": 9, "markerfacecolor": "none", "markeredgewidth": 2, "linestyle": ""}
        return [key("true term", color=COLORS[1], **frame)]


def _true_terms(law: Law, truth: Law | None) -> Floats | None:
    """Return `true_coefficients`, NaN where a term is absent."""
    known = true_coefficients(law, truth)
    return None if known is None else absent_as_nan(known)


def absent_as_nan(values: Floats) -> Floats:
    """Return the values with NaN for zeros."""
    return np.where(values == 0, np.nan, values)


def scale(coefficients: Floats) -> LogNorm:
    """Return a scale of colours over all magnitudes, at least a decade wide."""
    present = np.abs(coefficients[coefficients != 0])
    low, high = (present.min(), present.max()) if present.size else (1.0, 1.0)
    middle = np.sqrt(low) * np.sqrt(high)
    return LogNorm(float(min(low, middle / np.sqrt(10))), float(max(high, middle * np.sqrt(10))))


def heat_map(panel: Axes, values: Floats, norm: LogNorm) -> QuadMesh:
    """Draw cells of shape (objects, terms), the first object at the top."""
    colors = colormaps["cividis"].with_extremes(bad=ABSENT)
    mesh = panel.pcolormesh(_magnitudes(values), norm=norm, cmap=colors, edgecolors="white", linewidth=1)
    panel.invert_yaxis()
    panel.grid(False)
    panel.tick_params(length=0)
    panel.spines[:].set_visible(False)
    return mesh


def add_color_bar(figure: Figure, mesh: QuadMesh, panels: Sequence[Axes], width: float) -> None:
    """Put the scale of colours below panels that are so many inches wide."""
    low, high = mesh.get_clim()
    ticks = LogLocator(subs=(1, 3) if high < 1e3 * low else (1,))
    bar = figure.colorbar(mesh, ax=list(panels), location="bottom", aspect=4 * width, ticks=ticks, format="%g")
    bar.minorticks_off()
    bar.set_label("magnitude of coefficient (grey: term absent)")


def _magnitudes(values: Floats) -> Floats:
    return np.ma.masked_equal(np.abs(values), 0)


@styled()
@checks_types
def plot_profile(law: Law, trials: Trials, parameter: str, name: str | None = None) -> Figure:
    """Plot the profile likelihood of a parameter of one object, with its 95 % interval.

    ``2 (log L(best) - log L(value))``, all other parameters and initial conditions fitted again to the object's trials,
    under white noise. The parabola corresponds to the standard error. If the profile is flatter on one side, the
    interval is longer there; if it stays below the line, the 95 % quantile of a squared Student's t, the parameter is
    not identifiable on that side.

    Raises `CommonlawError` if there is no such object or parameter, the objects do not share their equations, or time
    is discrete.

    Parameters
    ----------
    law, trials
        A law, and the trials to which it was fitted.
    parameter
        Name of the parameter in `Law.structure`.
    name
        The object; optional if there is only one.
    """
    profile = likelihood_profile(law, trials, parameter, name)
    figure = Figure(figsize=(5.4, 4.0), layout="constrained")
    panel = figure.add_subplot()
    low, high, limit = profile.values[0], profile.values[-1], profile.quantile
    fine = np.linspace(low, high, 200)
    panel.axhline(limit, color=GREY, linewidth=0.8)
    panel.axvspan(*np.clip(profile.interval, low, high), color=COLORS[0], alpha=0.12, linewidth=0)
    panel.plot(fine, ((fine - profile.estimate) / profile.error) ** 2, color=GREY, linestyle="--")
    panel.plot(profile.values, profile.deviance, color=COLORS[0], marker="o")
    panel.axvline(profile.estimate, color=COLORS[0], linestyle=":")
    panel.set_ylim(-0.3, max(2 * limit, float(np.max(profile.deviance)) * 0.6) if len(fine) else None)
    label = math(latex_name(parameter), parameter)
    panel.set_xlabel(f"{label} ({unit_text(profile.unit)})" if profile.unit else label)
    panel.set_ylabel("2 log (largest likelihood / likelihood)")
    panel.set_title(plain(profile.object, 60))
    interval = key("95 % interval", color=COLORS[0], linewidth=8, alpha=0.12)
    parabola = key("by the standard error", color=GREY, linestyle="--")
    add_legend(figure, [key("profile", color=COLORS[0], marker="o"), interval, parabola], "below")
    return frozen_layout(figure)


@styled()
@checks_types
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
        forecast = law.predict(trials) if law.order == 0 else fitted(law, trials, law.uncertainty.has_std)
    names = representative(forecast)
    shown, left_out = of_objects(forecast, names), omission(forecast, names)
    if left_out and (known := [name for name in law.objects if name in names]):
        law = select_objects(law, known)
    true = () if truth is None else [truth.terms.names[k] for k in np.flatnonzero(truth.support.any(axis=0))]
    dots = DotPlot(law, truth)
    maps = HeatMaps(law, law.support.any(axis=0) | np.isin(law.terms.names, true), truth)
    coefficients = dots if 0 < len(dots.coefficients) <= 12 else maps
    columns, height = forecast_grid(shown)
    equations = equation_lines(law)
    heights = (height, 0.4 + coefficients.height)
    width = max(coefficients.width, 1.2 + 2.4 * max(columns, 2))
    size = fitting(width, 1.4 + 0.3 * equations.count("\n") + sum(heights))
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle(equations)
    indices = figure.add_gridspec(2, 1, height_ratios=heights)
    coefficients.draw(figure, indices[1])
    draw_forecast(figure, indices[0], shown, columns)
    add_legend(figure, [*coefficients.keys(), *forecast_keys(shown)], "below", left_out)
    return frozen_layout(figure)
