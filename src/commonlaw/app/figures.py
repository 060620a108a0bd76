"""Pictures of a law: each as SVG and PNG, and as the Python that draws it."""

from collections.abc import Callable, Mapping
from threading import Lock

import numpy as np

from commonlaw.app.result import Found
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.forecast import Forecast
from commonlaw.law.script import Source, to_script
from commonlaw.plots import (
    Figure,
    plot_coefficients,
    plot_forecast,
    plot_law,
    plot_phase_plane,
    plot_profile,
    plot_residuals,
    render,
)

one_draws = Lock()
"""Matplotlib draws in one thread at a time."""

_OF_CURVES: Mapping[str, Callable[[Found, str, str], Figure]] = {
    "law": lambda found, *_: plot_law(found.law, curves(found, found.findings.shown)),
    "fit": lambda found, *_: plot_forecast(curves(found, found.findings.fit)),
    "forecast": lambda found, *_: plot_forecast(curves(found, found.findings.forecast)),
    "residuals": lambda found, *_: plot_residuals(found.law.residuals(found.findings.training)),
    "coefficients": lambda found, *_: plot_coefficients(found.law, "support"),
    "phase-plane": lambda found, owner, _: plot_phase_plane(found.law, found.findings.training, owner),
    "profile": lambda found, owner, name: plot_profile(found.law, found.findings.training, name, owner),
}

_WRITTEN: Mapping[str, str] = {
    "law": "cl.plots.plot_law(law, trials)",
    "fit": "cl.plots.plot_forecast(law.predict(trials, start='all', return_std={bands}))",
    "forecast": "cl.plots.plot_forecast(law.predict({measured}, start={start}, return_std={bands}))",
    "residuals": "cl.plots.plot_residuals(law.residuals(trials))",
    "coefficients": "cl.plots.plot_coefficients(law, 'support')",
    "phase-plane": "cl.plots.plot_phase_plane(law, trials, {object!r})",
    "profile": "cl.plots.plot_profile(law, trials, {parameter!r}, {object!r})",
}


def figure_file(
    name: str, found: Found, source: Source, is_candidate: bool = False, owner: str = "", parameter: str = ""
) -> bytes:
    """Return a picture of a law, by its kind and ending; or the program that draws it, which loads a candidate.

    Raises `CommonlawError` if there is no such picture, or the law has it not.
    """
    kind, _, ending = name.partition(".")
    check_choice("figure", kind, _OF_CURVES)
    check_choice("ending of a figure", ending, ("svg", "png", "py"))
    if ending == "py":
        findings, lines = found.findings, to_script(found.law, source).splitlines()
        # Of another candidate there is no program that finds it: its law is loaded
        left_out = ("print(", "law = ") if is_candidate else ("print(",)
        lines = [line for line in lines if not line.startswith(left_out)]
        lines += ["law = cl.Law.load('law.json')"] * is_candidate
        measured = "measured" if findings.has_later_samples else "trials"
        if findings.is_held_out and source.training.endswith("[1]"):
            measured = source.training.removesuffix("[1]") + "[0]"
        bands = findings.fit is not None and findings.fit.std is not None
        named = {"object": owner, "parameter": parameter, "start": findings.start}
        call = _WRITTEN[kind].format(bands=bands, measured=measured, **named)
        lines += [f"figure = {call}", f"cl.plots.save_figure(figure, '{kind}.svg')", ""]
        return "\n".join(lines).encode()
    with one_draws:
        try:
            return render(_OF_CURVES[kind](found, owner, parameter), f".{ending}")
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            raise CommonlawError("figure-failed", figure=kind, reason=error) from None


def curves(found: Found, wanted: Forecast | None) -> Forecast:
    """Return curves, which a law in discrete time, say, may not have."""
    if wanted is None:
        raise CommonlawError("curves-missing", reasons=found.findings.lacking or ["a law in discrete time has none"])
    return wanted
