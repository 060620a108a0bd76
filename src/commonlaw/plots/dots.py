"""Coefficients of a law as dots, beside the true ones where they are known."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, NullLocator
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.law import Law
from commonlaw.law.numbers import with_error
from commonlaw.library.notation import latex_name
from commonlaw.plots.coefficients import absent_as_nan, true_values
from commonlaw.plots.equations import left_hand_sides, letter_of, term_labels
from commonlaw.plots.style import COLORS, key, math, number_text, plain, powers_of_ten, unit_text

_DOT: Mapping[str, Any] = {"color": COLORS[0], "marker": "o", "linestyle": ""}
_FRAME = {"markersize": 9, "markerfacecolor": "none", "markeredgewidth": 1.2}
_OPEN: Mapping[str, Any] = {**_DOT, "color": "black", **_FRAME}


@dataclass(frozen=True)
class Coefficient:
    """One coefficient of every object: the index of its equation, its term, labels, and values of shape (objects,).

    Of a law that was given as equations it is one of their letters, which then stands for the term.

    A letter or unit that is not known is empty, and so are values NaN; standard errors that are not known are zero.
    The ends of 95 % intervals are averaged over what the law could be.
    """

    equation: int
    name: str
    term: str
    letter: str
    unit: str
    learned: Floats
    true: Floats
    errors: Floats
    low: Floats
    high: Floats

    @property
    def label(self) -> str:
        """Its letter and unit, as far as there are any."""
        return " ".join(filter(None, (self.letter, f"({self.unit})" if self.unit else "")))


@dataclass(frozen=True, eq=False)
class DotPlot:
    """The coefficients of a law, and of the true one if it is known, as dots.

    Each coefficient of several objects has a panel with a line for each object; those of a single object have a line
    each in the panel of their equation.
    """

    law: Law
    truth: Law | None = None

    @cached_property
    def coefficients(self) -> list[Coefficient]:
        """All coefficients that are in the law or in the truth, equation by equation."""
        if self._by_letter:
            return self._letters
        law, labels, units = self.law, term_labels(self.law.terms), self.law.coefficient_units()
        low, high = (law.coefficients,) * 2 if law.covariance is None else law.interval_ends()
        found = []
        for j, k in np.ndindex(law.support.shape):
            name, learned = law.terms.names[k], absent_as_nan(law.coefficients[:, j, k])
            true = learned * np.nan if self.truth is None else true_values(law, self.truth, j, name)
            if np.any(np.isfinite([learned, true])):
                unit = unit_text(units.get((law.left_hand_sides[j], name), ""))
                errors = np.nan_to_num(law.standard_errors[:, j, k])
                # The equations of an explained law have letters of their own
                letter = letter_of(law, j, k) if law.explanation is None else ""
                ends = low[:, j, k], high[:, j, k]
                found.append(Coefficient(j, name, labels[k], letter, unit, learned, true, errors, *ends))
        return found

    @property
    def _by_letter(self) -> bool:
        """Whether the law's own letters are shown; the equations of an explained law have others."""
        return bool(self.law.provenance.equations) and self.law.explanation is None

    @property
    def _letters(self) -> list[Coefficient]:
        """The letters of given equations."""
        law, found = self.law, list[Coefficient]()
        (values, errors), (low, high) = law.letter_values(), law.letter_interval_ends()
        for i, each in enumerate(law.named_coefficients):
            parts = [(part.equation, law.terms.names[part.term]) for part in each.parts]
            true = values[:, i] * np.nan
            if self.truth is not None:
                true = each.value([true_values(law, self.truth, *part) for part in parts])
            label, unit = math(latex_name(each.name), each.name), unit_text(law.letter_units()[i] or "")
            ends = (values[:, i],) * 2 if law.covariance is None else (low[:, i], high[:, i])
            own = values[:, i], true, np.nan_to_num(errors[:, i]), *ends
            found.append(Coefficient(each.equation, each.name, label, label, unit, *own))
        return found

    @property
    def several(self) -> bool:
        """Whether there are several objects."""
        return len(self.law.objects) > 1

    @property
    def columns(self) -> int:
        """Number of panels side by side."""
        return min(len(self.coefficients), 3) if self.several else 1

    @property
    def lines(self) -> int:
        """Number of lines of panels."""
        return -(-len(self.coefficients) // self.columns) if self.several else len(self.law.states)

    @property
    def width(self) -> float:
        """Width in inches."""
        return 1.6 + 1.9 * self.columns if self.several else 4.5 if self.law.covariance is None else 5.5

    @property
    def height(self) -> float:
        """Least height in inches."""
        marks = len(self.law.objects) * self.lines if self.several else len(self.coefficients)
        return 0.9 * self.lines + 0.24 * marks

    def draw(self, figure: Figure, index: SubplotSpec) -> None:
        """Draw into a part of a figure."""
        if self.several:
            self._draw_panels(figure, index)
        else:
            self._draw_lines(index)

    def title(self, each: Coefficient) -> str:
        """Return what stands above the panel of a coefficient: its term, and its equation if there are several."""
        if self._by_letter:
            return each.term
        lefts = left_hand_sides(self.law)
        where = f"{lefts[each.equation]}: " if len(lefts) > 1 else ""
        return where + ("constant term" if each.term == "$1$" else f"{each.term} term")

    def keys(self) -> list[Line2D]:
        """Return what belongs into the legend."""
        learned, known = key("learned", **_DOT), any(np.isfinite(each.true).any() for each in self.coefficients)
        bars = [] if self.law.covariance is None else [key("95 % interval", color=COLORS[0])]
        return [learned, *bars, *([key("true", **_OPEN)] if known else [])] if known or bars else []

    def _draw_panels(self, figure: Figure, index: SubplotSpec) -> None:
        grid = index.subgridspec(self.lines, self.columns)
        for i, each in enumerate(self.coefficients):
            panel = figure.add_subplot(grid[i])
            self.draw_panel(panel, each)
            panel.tick_params(labelleft=i % self.columns == 0)
            panel.set_title(self.title(each))

    def draw_panel(self, panel: Axes, each: Coefficient) -> None:
        """Draw a coefficient of several objects."""
        heights = np.arange(len(self.law.objects))
        panel.plot(each.learned, heights, **_DOT)
        panel.plot(each.true, heights, **_OPEN)
        _draw_bars(panel, heights, each.errors, each.low, each.high)
        panel.set_yticks(heights, [plain(name, 22) for name in self.law.objects])
        panel.set_ylim(len(heights) - 0.5, -0.5)
        panel.margins(x=0.15)
        panel.locator_params(axis="x", nbins=4)
        panel.set_xlabel(each.label)

    def _draw_lines(self, index: SubplotSpec) -> None:
        groups = [[each for each in self.coefficients if each.equation == j] for j in range(self.lines)]
        ratios = [1 + len(group) for group in groups]
        panels = index.subgridspec(self.lines, 1, height_ratios=ratios).subplots(sharex=True, squeeze=False)[:, 0]
        for panel, group, left in zip(panels, groups, left_hand_sides(self.law), strict=True):
            heights = np.arange(len(group))
            panel.plot([each.learned[0] for each in group], heights, **_DOT)
            panel.plot([each.true[0] for each in group], heights, **_OPEN)
            _draw_bars(panel, heights, *np.array([(each.errors[0], each.low[0], each.high[0]) for each in group]).T)
            for height, each in enumerate(group):
                _print_value(panel, height, each)
            panel.set_yticks(heights, [each.term for each in group])
            panel.set_ylim(len(group) - 0.4, -0.6)
            what = "parameters" if self._by_letter else "terms"
            panel.set_title(f"{what} of {left}", loc="left")
            panel.margins(x=0.4 if self.law.covariance is None else 0.7)  # room for the printed values
        panels[-1].locator_params(axis="x", nbins=5)
        logarithmic = self._scale(panels[-1])
        panels[-1].set_xlabel("coefficient, on a logarithmic scale" if logarithmic else "coefficient")

    def _scale(self, panel: Axes) -> bool:
        """Make the axis logarithmic on both sides of zero if coefficients differ by a factor above a hundred.

        Returns whether they do.
        """
        values = np.abs([[*each.learned, *each.true] for each in self.coefficients])
        low, high = np.nanmin(values), np.nanmax(values)
        differ = bool(high > 100 * low)
        if differ:
            panel.set_xscale("symlog", linthresh=low)
            # Matplotlib's own ticks for this scale run into each other around zero
            decades = 10.0 ** np.round(np.log10([np.sqrt(low * high), high]))
            panel.get_xlim()  # Has them set
            ticks = [0, *decades[::-1], *-decades[::-1]]
            at = (panel.transScale + panel.transLimits).transform([(tick, 0) for tick in ticks])[:, 0]
            apart = [tick for i, tick in enumerate(ticks) if (np.abs(at[i] - at[:i]) > 0.12).all()]
            panel.xaxis.set_major_locator(FixedLocator(apart))
            panel.xaxis.set_major_formatter("{x:g}")
            panel.xaxis.set_minor_locator(NullLocator())
        return differ


def _draw_bars(panel: Axes, heights: ArrayLike, errors: Floats, low: Floats, high: Floats) -> None:
    """Draw the 95 % intervals of coefficients whose errors are known."""
    if errors.any():
        panel.hlines(heights, low, high, color=COLORS[0], linewidth=1.4)


def _print_value(panel: Axes, height: int, each: Coefficient) -> None:
    """Print a coefficient right of its dot and interval."""
    value, error = each.learned[0], each.errors[0]
    if np.isfinite(value):
        number = powers_of_ten(with_error(value, error)) if error else number_text(value, 4)
        index = (np.fmax(value, each.high[0]), height)
        text = f"{number} {each.unit}".rstrip()
        panel.annotate(text, index, (8, 0), textcoords="offset points", va="center", fontsize=9)
