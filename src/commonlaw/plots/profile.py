"""Profile likelihoods."""

import numpy as np
from matplotlib.figure import Figure

from commonlaw.estimation import likelihood_profile
from commonlaw.law import Law
from commonlaw.library.notation import latex_name
from commonlaw.plots.style import COLORS, GREY, add_legend, frozen_layout, key, math, plain, styled, unit_text
from commonlaw.trials import Trials

_QUANTILE = 3.841


@styled()
def plot_profile(law: Law, trials: Trials, parameter: str, name: str | None = None) -> Figure:
    """Plot the profile likelihood of a parameter of one object, with its 95 % interval.

    ``2 (log L(best) - log L(value))``, all other parameters and initial conditions fitted again to the object's trials,
    under white noise. A parabola is that of the standard error: where the profile is flatter on a side, the interval is
    longer there, and where it stays below 3.84, the data do not bound the parameter.

    Raises `CommonlawError` if there is no such object or parameter, the objects do not share their equations, or time
    is discrete.

    Parameters
    ----------
    law, trials
        A law, and the trials that it was fitted to.
    parameter
        Its name in `Law.structure`.
    name
        The object; not needed if there is one.
    """
    profile = likelihood_profile(law, trials, parameter, name)
    figure = Figure(figsize=(5.4, 4.0), layout="constrained")
    panel = figure.add_subplot()
    low, high = profile.values[0], profile.values[-1]
    fine = np.linspace(low, high, 200)
    panel.axhline(_QUANTILE, color=GREY, linewidth=0.8)
    ends = np.clip(profile.interval, low, high)
    panel.axvspan(*ends, color=COLORS[0], alpha=0.12, linewidth=0)
    panel.plot(fine, ((fine - profile.estimate) / profile.error) ** 2, color=GREY, linestyle="--")
    panel.plot(profile.values, profile.deviance, color=COLORS[0], marker="o")
    panel.axvline(profile.estimate, color=COLORS[0], linestyle=":")
    panel.set_ylim(-0.3, max(2 * _QUANTILE, float(np.max(profile.deviance)) * 0.6) if len(fine) else None)
    label = math(latex_name(parameter), parameter)
    panel.set_xlabel(f"{label} ({unit_text(profile.unit)})" if profile.unit else label)
    panel.set_ylabel("2 log (largest likelihood / likelihood)")
    panel.set_title(plain(profile.object, 60))
    interval = key("95 % interval", color=COLORS[0], linewidth=8, alpha=0.12)
    parabola = key("by the standard error", color=GREY, linestyle="--")
    add_legend(figure, [key("profile", color=COLORS[0], marker="o"), interval, parabola], "below")
    return frozen_layout(figure)
