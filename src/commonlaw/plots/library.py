"""Candidate functions along a trial."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from commonlaw.formulation import StrongForm
from commonlaw.library import Order, Terms, Variables, term_unit, with_rates
from commonlaw.plots.style import COLORS, axis_label, columns_for, frozen_layout, math, plain, show_lowest_ticks, styled
from commonlaw.trials import Trial
from commonlaw.trials.units import parse_unit

if TYPE_CHECKING:
    import pint


@styled()
def plot_library(trial: Trial, form: StrongForm, terms: Terms, units: Mapping[str, str] | None = None) -> Figure:
    """Plot every candidate function along one trial, one panel each (the founding paper's figure of the library).

    Parameters
    ----------
    trial
        The trial.
    form
        How the trial becomes library rows.
    terms
        The candidate functions.
    units
        Units of the states, inputs and time by name: ``trials.schema.units``. Terms whose unit follows from them have
        it beside their axis.

    Raises
    ------
    CommonlawError
        If the trial is too short or a term is not finite on it.
    """
    values, _ = form.samples(trial)
    rows, _ = form.rows(trial, terms)
    names, columns = terms.variables.names, columns_for(len(terms))
    known = _with_rates(units or {}, terms.variables, form.order, trial.states.shape[1])
    lines = -(-len(terms) // columns)
    figure = Figure(figsize=(1 + 2.3 * columns, 0.9 + 1.6 * lines), layout="constrained")
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


def _with_rates(
    units: Mapping[str, str], variables: Variables, order: Order, count: int
) -> "dict[str, str | pint.Unit]":
    """Return the units with those of the states' rates, where both the state and time have one."""
    states, time, known = variables.states, variables.time, dict[str, "str | pint.Unit"](units)
    for j, rate in zip(with_rates(order, count), states[count:], strict=True):
        state = states[j]
        if {state, time} <= units.keys():
            known[rate] = parse_unit(units[state]) / parse_unit(units[time])
    return known
