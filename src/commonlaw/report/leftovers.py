"""The part of a law's report that says what the law leaves unexplained."""

from collections.abc import Iterator
from functools import partial

import numpy as np
import pandas as pd

from commonlaw.errors import CommonlawError
from commonlaw.plots import plot_discrepancy, plot_errors, plot_residuals
from commonlaw.report.document import Block, Fold, Picture, Section, Table, Text
from commonlaw.report.law_case import LawCase, listed
from commonlaw.report.markup import literal

_MOST_OBJECTS = 100
"""Objects up to which a discrepancy is looked for, as it takes long."""

_FAILURES = (CommonlawError, ArithmeticError, np.linalg.LinAlgError)


def residuals(case: LawCase) -> Section:
    """Return the part on what the law leaves unexplained."""
    blocks = (*_patterns(case), *_discrepancy(case), *_errors(case))
    return Section("residuals", "What it leaves", blocks)


def _patterns(case: LawCase) -> Iterator[Block]:
    """Yield what measurements are off the law's trajectories, and which patterns that has."""
    try:
        found = case.law.residuals(case.trials)
    except _FAILURES as error:
        yield Text(f"What measurements are off the law's trajectories could not be tested: {case.said(error)}.")
        return
    yield Text(listed([case.said(line) for line in str(found).splitlines()]))
    caption = (
        "Residuals over noise: measurements less the law's trajectories, whose starts were fitted. A law that lacks "
        "nothing leaves no course, and no memory."
    )
    yield Picture("residual-plots", caption, partial(plot_residuals, found))
    tests = found.tests()
    if len(tests):
        yield Fold("Tests of the residuals", (Table("tests", "P-values are adjusted for their number.", tests),))


def _discrepancy(case: LawCase) -> Iterator[Block]:
    """Yield what the law leaves as a function that objects share."""
    if len(case.law.objects) > _MOST_OBJECTS:
        yield Text("A discrepancy that objects share was not looked for, as there are many objects.")
        return
    try:
        found = case.law.discrepancy(case.training)
    except _FAILURES as error:
        yield Text(f"A discrepancy that objects share could not be looked for: {case.said(error)}.")
        return
    yield Text(listed([case.said(line) for line in str(found).splitlines()]))
    caption = "The discrepancy, with its 95 % band."
    yield Fold("The discrepancy as a figure", (Picture("discrepancy", caption, partial(plot_discrepancy, found)),))


def _errors(case: LawCase) -> Iterator[Block]:
    """Yield what free forecasts are off."""
    forecast = case.forecast
    if forecast is None:
        yield Text("Without forecasts there are no errors of these to show.")
        return
    frame = forecast.to_frame()
    rows = []
    for state in case.law.states:
        off = frame[f"{state} error"].to_numpy(dtype=np.float64)
        row: dict[str, object] = {
            "state": state,
            "unit": case.trials.schema.units.get(state),
            "measurements": int(np.isfinite(off).sum()),
            "mean error": float(np.nanmean(off)) if np.isfinite(off).any() else None,
            "rms error": float(np.sqrt(np.nanmean(off**2))) if np.isfinite(off).any() else None,
        }
        if f"{state} measured low" in frame:
            low, high = frame[f"{state} measured low"], frame[f"{state} measured high"]
            inside = ((low <= frame[state]) & (frame[state] <= high))[np.isfinite(off)]
            row["within 95 % band"] = f"{100 * inside.mean():.0f} %" if len(inside) else None
        rows.append(row)
    caption = f"Forecasts of trials {case.forecast_of}, less what was measured."
    table = Table("residuals-by-state", caption, pd.DataFrame(rows).dropna(axis=1, how="all"))
    yield table
    yield Picture("errors", "Errors of these forecasts.", partial(plot_errors, forecast))
    noise, units = case.law.noise, case.trials.schema.units
    if noise is not None:
        pairs = zip(case.law.states, noise.tolist(), strict=True)
        said = [f"{name} {level:.3g} {units.get(name, '')}".rstrip() for name, level in pairs]
        yield Text(f"Noise of the measurements, by the law: {literal(', '.join(said))}.")
    errors = case.law.uncertainty.error_model
    if errors.of_law:
        yield Text("The law is not exact: it has a model error besides, which its bands hold.")
