"""Trials side by side, as under a strobe light."""

import numpy as np
from matplotlib.figure import Figure

from commonlaw.errors import CommonlawError, unknown
from commonlaw.plots.style import axis_label, frozen_layout, looks, plain, styled
from commonlaw.trials import Trials


@styled()
def plot_strobe(trials: Trials, every: int = 3, state: str | None = None) -> Figure:
    """Plot one state of every trial in a column of its own, with a marker at every few samples.

    Faint lines join the markers of the same sample, so that it shows who is ahead (the upper part of the founding
    paper's figure of the ball drops).

    Parameters
    ----------
    trials
        What was measured.
    every
        How many samples are from one marker to the next; the first sample has one.
    state
        Which state; the first by default.

    Raises
    ------
    CommonlawError
        If the state is not among the trials', or `every` is less than one.
    """
    schema = trials.schema
    name = schema.states[0] if state is None else state
    if name not in schema.states:
        raise unknown("state", name, schema.states)
    if every < 1:
        raise CommonlawError("other", text=f"every is {every}: give the number of samples between markers, at least 1")
    look, column = looks(trials.objects), schema.states.index(name)
    shown = [trial.states[::every, column] for trial in trials]
    table = np.full((len(trials), max(map(len, shown))), np.nan)
    for i, values in enumerate(shown):
        table[i, : len(values)] = values
    figure = Figure(figsize=(1.2 + 0.85 * len(trials), 5), layout="constrained")
    panel = figure.subplots()
    panel.plot(np.arange(len(trials)), table, color="#c4c4c4", linewidth=0.8)
    for i, (trial, values) in enumerate(zip(trials, shown, strict=True)):
        panel.plot(np.full(len(values), i), values, **look[trial.object], linestyle="", markersize=7, clip_on=False)
    one_label = len({trial.name for trial in trials}) == 1
    labels = [plain(trial.object if one_label else trial.label, 12) for trial in trials]
    panel.set_xticks(range(len(trials)), labels)
    panel.set_xlim(-0.5, len(trials) - 0.5)
    panel.grid(False, axis="x")
    panel.set_ylabel(axis_label(name, schema.units.get(name, "")))
    panel.set_title("every sample" if every == 1 else f"every {every}{_ordinal(every)} sample", loc="left")
    return frozen_layout(figure)


def _ordinal(number: int) -> str:
    """Return the ending of an ordinal number.

    >>> _ordinal(2), _ordinal(11), _ordinal(23)
    ('nd', 'th', 'rd')
    """
    return "th" if number // 10 % 10 == 1 else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
