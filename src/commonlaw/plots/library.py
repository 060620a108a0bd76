"""Candidate functions along a trial."""

from collections.abc import Mapping
from types import MappingProxyType

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from commonlaw.formulation import StrongForm
from commonlaw.library import Terms
from commonlaw.plots.style import COLORS, axis_label, columns_for, math, plain, settled, show_lowest_ticks, styled
from commonlaw.trials import Trial

_NO_UNITS: Mapping[str, str] = MappingProxyType({})


@styled()
def plot_library(trial: Trial, form: StrongForm, terms: Terms, units: Mapping[str, str] = _NO_UNITS) -> Figure:
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
        Units of the variables by name: ``trials.schema.units``.

    Raises
    ------
    CommonlawError
        If the trial is too short or a term is not finite on it.
    """
    values, _ = form.samples(trial)
    rows, _ = form.rows(trial, terms)
    names, columns = terms.variables.names, columns_for(len(terms))
    lines = -(-len(terms) // columns)
    figure = Figure(figsize=(1 + 2.1 * columns, 0.9 + 1.6 * lines), layout="constrained")
    figure.suptitle(plain(trial.label, 60))
    panels: list[Axes] = []
    for i, term in enumerate(terms.terms):
        panel = figure.add_subplot(lines, columns, i + 1, sharex=panels[0] if panels else None)
        panel.plot(values[:, -1], rows[:, i], color=COLORS[0])
        panel.set_title(math(term.latex(names), terms.names[i]))
        panels.append(panel)
    time = terms.variables.time
    show_lowest_ticks(panels, columns, axis_label(time, units.get(time, "")))
    return settled(figure)
