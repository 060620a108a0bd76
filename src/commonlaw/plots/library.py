"""Candidate terms: their path, and what they are."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from commonlaw.formulation import StrongForm
from commonlaw.law import Law
from commonlaw.law.parameters import left_hand_sides
from commonlaw.library import Terms, term_unit, with_rates
from commonlaw.plots.equations import equation_labels
from commonlaw.plots.style import (
    COLORS,
    DASHES,
    add_legend,
    axis_label,
    columns_for,
    fitting,
    frozen_layout,
    key,
    math,
    plain,
    show_lowest_ticks,
    styled,
)
from commonlaw.runtime.arguments import checks_types
from commonlaw.trials import Trial
from commonlaw.trials.headers import parse_unit

if TYPE_CHECKING:
    import pint


@styled()
@checks_types
def plot_library(trial: Trial, form: StrongForm, terms: Terms, units: Mapping[str, str] | None = None) -> Figure:
    """Plot the candidate functions along one trial, a panel for each (de Silva et al. 2020).

    Raises `CommonlawError` if the trial is too short or a term is not finite on it.

    Parameters
    ----------
    trial, form, terms
        The trial, the form of its regression rows, and the candidate functions.
    units
        Units of states, inputs and time by name: ``trials.schema.units``.
    """
    values, _ = form.samples(trial)
    rows, _ = form.rows(trial, terms)
    names, columns = terms.variables.names, columns_for(len(terms))
    variables, known = terms.variables, dict[str, "str | pint.Unit"](units or {})
    count = trial.states.shape[1]
    for j, rate in zip(with_rates(form.order, count), variables.states[count:], strict=True):
        if {state := variables.states[j], variables.time} <= known.keys():  # Both have a unit, and so the rate has
            known[rate] = parse_unit(str(known[state])) / parse_unit(str(known[variables.time]))
    lines = -(-len(terms) // columns)
    figure = Figure(figsize=fitting(1 + 2.3 * columns, 0.9 + 1.6 * lines), layout="constrained")
    figure.suptitle(plain(trial.label, 60))
    panels: list[Axes] = []
    for i, term in enumerate(terms.terms):
        panel = figure.add_subplot(lines, columns, i + 1, sharex=panels[0] if panels else None)
        panel.plot(values[:, -1], rows[:, i], color=COLORS[0])
        panel.set_title(math(term.latex(names), terms.names[i]))
        unit = term_unit(term, terms.variables, known)
        panel.set_ylabel("" if unit is None else f"{unit:~P}")
        panels.append(panel)
    time = terms.variables.time
    show_lowest_ticks(panels, columns, axis_label(time, (units or {}).get(time, "")))
    return frozen_layout(figure)


_ERROR, _DEVIATION = "held-out error", "standard error"


@styled()
@checks_types
def plot_path(law: Law, hyperparameter: str = "threshold", *, marks: Mapping[str, float] | None = None) -> Figure:
    """Plot the regularization path: number of terms and held-out error against the hyperparameter of the solver.

    The band is one standard error on both sides; the interval of the chosen equation is shaded.

    Raises `CommonlawError` if the law was not chosen from the path of one solver.

    Parameters
    ----------
    law
        A law that was chosen from the path of one solver.
    hyperparameter
        Name of the hyperparameter on the axis.
    marks
        Values to mark by a line, by name.
    """
    path = law.provenance.path()
    marks, columns = marks or {}, len(law.schema.states)
    lined = [(name, DASHES[1:][i % 3]) for i, name in enumerate(marks)]
    figure = Figure(figsize=fitting(1.2 + 5 * columns, 5.2), layout="constrained")
    panels = figure.subplots(2, columns, sharex="col", sharey="row", squeeze=False)
    for (above, below), equation, label in zip(panels.T, left_hand_sides(law), equation_labels(law), strict=True):
        rows = path[path["equation"] == equation]
        # Where the intervals begin, and where the last is cut off, all above zero
        begins = rows["from"].to_numpy(dtype=np.float64)
        inner = np.array([*begins[begins > 0], *marks.values()])
        low, high = (inner.min(), inner.max()) if inner.size else (1.0, 1.0)
        margin = max((high / low) ** 0.08, 1.5)
        edges = np.array([*np.maximum(begins, low / margin), high * margin])
        values = rows[["size", _ERROR, _DEVIATION]].to_numpy(dtype=np.float64)
        size, error, deviation = np.vstack([values, values[-1]]).T  # The last once more, for the end of its interval
        above.step(edges, size, where="post", color=COLORS[0])
        below.step(edges, error, where="post", color=COLORS[1])
        # A band that went down to zero would have no end on a logarithmic axis
        low, high = np.maximum(error - deviation, error / 10), error + deviation
        below.fill_between(edges, low, high, step="post", color=COLORS[1], alpha=0.2, linewidth=0)
        for panel in (above, below):
            for i in np.flatnonzero(rows["chosen"]):
                panel.axvspan(edges[i], edges[i + 1], color=COLORS[2], alpha=0.15, linewidth=0)
            for name, dash in lined:
                panel.axvline(marks[name], color="black", linestyle=dash)
        above.set_title(f"equation of {label}" if columns > 1 else "")
        below.set_xscale("log")
        below.set_xlim(edges[0], edges[-1])
        below.set_xlabel(plain(hyperparameter, 60))
    panels[0, 0].set_ylabel("number of terms")
    panels[0, 0].yaxis.set_major_locator(MaxNLocator(integer=True))
    panels[1, 0].set_ylabel(f"{_ERROR}\n± one {_DEVIATION}")
    panels[1, 0].set_yscale("log")
    chosen = key("chosen", color=COLORS[2], alpha=0.3, linewidth=8)
    lines = [key(plain(name, 40), color="black", linestyle=dash) for name, dash in lined]
    add_legend(figure, [chosen, *lines], "above")
    return frozen_layout(figure)
