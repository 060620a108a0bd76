"""Measured states against time."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from commonlaw.errors import unknown
from commonlaw.plots.style import DASHES, GREY, add_legend, axis_label, frozen_layout, key, looks, plain, styled
from commonlaw.trials import Trials


@styled()
def plot_trials(
    trials: Trials,
    state: str | None = None,
    objects: Sequence[str] | None = None,
    references: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
) -> Figure:
    """Plot measured states against time: a colour and marker for each object, a line style for each trial.

    Parameters
    ----------
    trials
        What was measured.
    state
        One state; all of them by default, one panel each.
    objects
        Some of the objects; they keep the colours that they have among all.
    references
        Curves to compare with, such as a simulated fall: times and values by label, each of shape (n,); black, in
        their own line styles, in every panel.

    Raises
    ------
    CommonlawError
        If the state or an object is not among the trials'.
    """
    schema = trials.schema
    if state is not None and state not in schema.states:
        raise unknown("state", state, schema.states)
    states = schema.states if state is None else (state,)
    chosen = trials if objects is None else trials.select(object=objects if isinstance(objects, str) else list(objects))
    figure = Figure(figsize=(9, 2 + 3 * len(states)), layout="constrained")
    panels = figure.subplots(len(states), 1, sharex=True, squeeze=False)[:, 0]
    look, dashes, references = looks(trials.objects), _dashes(chosen), references or {}
    for panel, name in zip(panels, states, strict=True):
        column, unit = schema.states.index(name), schema.units.get(name, "")
        for trial in chosen:
            panel.plot(
                trial.times,
                trial.states[:, column],
                dashes.get(trial.name, "-"),
                markevery=max(1, len(trial) // 12),
                **look[trial.object],
            )
        for i, curve in enumerate(references.values()):
            panel.plot(*map(np.asarray, curve), **_reference(i))
        panel.set_ylabel(axis_label(name, unit))
    panels[-1].set_xlabel(axis_label(schema.time, schema.units.get(schema.time, "")))
    keys = [key(plain(name), **look[name]) for name in chosen.objects]
    keys += [key(plain(f"{schema.trial} {name}"), color=GREY, linestyle=dash) for name, dash in dashes.items()]
    keys += [key(plain(label), **_reference(i)) for i, label in enumerate(references)]
    add_legend(figure, keys)
    return frozen_layout(figure)


def _reference(index: int) -> dict[str, Any]:
    """Return how a curve to compare with looks: wider than those of the trials, and above them."""
    return {"color": "black", "linestyle": DASHES[index % len(DASHES)], "linewidth": 2.4, "zorder": 3}


def _dashes(trials: Trials) -> dict[str, str]:
    """Return the line style of each trial label; none if there is one label, or more labels than line styles."""
    names = list(dict.fromkeys(trial.name for trial in trials))
    return dict(zip(names, DASHES, strict=False)) if 1 < len(names) <= len(DASHES) else {}
