"""The part of a law's report that says what the law leaves unexplained."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from commonlaw.discrepancy.function import CLAIMED
from commonlaw.discrepancy.patterns import Residuals
from commonlaw.errors import CommonlawError
from commonlaw.inference import levels_in_words
from commonlaw.plots import ResidualPanels, plot_discrepancy
from commonlaw.report.document import Block, Fold, Gallery, Picture, Section, Table, Text
from commonlaw.report.law_case import LawCase, listed
from commonlaw.report.markup import literal

_MOST_OBJECTS = 100
"""Objects up to which a discrepancy is looked for, as it takes long."""

_FAILURES = (CommonlawError, ArithmeticError, np.linalg.LinAlgError)


def residuals(case: LawCase) -> Section:
    """Return the part on what the law leaves unexplained."""
    blocks = (*_patterns(case), *_discrepancy(case), *_errors(case))
    return Section("residuals", "Residuals and discrepancy", blocks)


def _patterns(case: LawCase) -> Iterator[Block]:
    """Yield what measurements are off the law's trajectories, and which patterns that has."""
    try:
        found = case.law.residuals(case.trials)
    except _FAILURES as error:
        yield Text(f"What measurements are off the law's trajectories could not be tested: {case.said(error)}.")
        return
    meaning = "Residuals are measurements less the law's trajectories, whose starts were fitted, over the noise. "
    meaning += "In the figures, orange are means of neighbouring ones with 95 % intervals."
    if len(found.significant) > 1:
        meaning += " Patterns often have one cause: look into the one with the smallest p-value first, see the tests."
    yield Text(meaning + listed([case.said(line) for line in str(found).splitlines()]))
    yield from _residual_panels(found)
    tests = found.tests()
    if len(tests):
        yield Fold("Tests of the residuals", (Table("tests", "P-values are adjusted for their number.", tests),))


def _residual_panels(found: Residuals) -> Iterator[Block]:
    """Yield small figures of residuals, those of the first state at once."""
    panels = ResidualPanels(found)
    for j, state in enumerate(found.trials.schema.states):
        pictures = [
            Picture(f"residuals-{j + 1}-{k + 1}", f"**Residuals of {literal(state)}.** {literal(caption)}", draw)
            for k, caption in enumerate(panels.captions(j))
            for draw in [partial(panels.draw, j, k)]
        ]
        gallery = Gallery(tuple(pictures))
        yield Fold(f"Residuals of {literal(state)}", (gallery,)) if j else gallery


def _discrepancy(case: LawCase) -> Iterator[Block]:
    """Yield what the law leaves as a function that objects share."""
    if len(case.law.objects) > _MOST_OBJECTS:
        yield Text("A function that all objects lack was not looked for, as there are many objects.")
        return
    try:
        found = case.law.discrepancy(case.findings.training)
    except _FAILURES as error:
        yield Text(f"A function that all objects lack could not be looked for: {case.said(error)}.")
        return
    of, strength = (
        literal(f"{found.basis.coordinate} in {found.equation}"),
        f"2 log B of {found.evidence:.1f} for it".replace("-", "−"),
    )
    if found.claimed:
        yield Text(f"The law lacks a function that all objects share, of {of}: there is strong evidence, {strength}.")
    else:
        yield Text(
            f"No function that all objects share is sure to be missing. The likeliest is one of {of}, with {strength}; "
            f"above {CLAIMED:.0f} the evidence would be strong."
        )
    picture = Picture("discrepancy", "The function, with its 95 % band.", partial(plot_discrepancy, found))
    lines = Text(listed([case.said(line) for line in str(found).splitlines()]))
    yield Fold("This function", (picture, lines))


def _errors(case: LawCase) -> Iterator[Block]:
    """Yield the errors of measurement, and whether the law itself errs."""
    if case.law.noise is not None:
        yield Text(f"Errors of measurement, by the law: {literal('; '.join(_of_measurement(case)))}.")
    if case.law.uncertainty.error_model.of_law:
        yield Text("The law is not exact: it has process noise besides, which the bands of forecasts hold.")


def _of_measurement(case: LawCase) -> Iterator[str]:
    """Yield the levels of the errors of measurement of each kind."""
    law, errors, schema = case.law, case.law.uncertainty.error_model, case.law.schema
    time = f"{errors.memory:.3g} {schema.units.get(schema.time, f'units of {schema.time}')}"
    kinds = (("noise", law.noise), (f"errors with a memory ({time})", errors.correlated))
    for kind, levels in kinds:
        if levels is not None:
            yield f"{kind} of {levels_in_words(levels, schema)}"
    if errors.proportional is not None:
        shares = [f"{100 * each:.3g} % of {name}" for name, each in zip(law.states, errors.proportional, strict=True)]
        yield f"noise of {', '.join(shares)}"
