"""What to measure next, where nobody said what can be set: experiments like those that were made."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.experiments.aims import COEFFICIENTS, LAW
from commonlaw.experiments.design import design, usual
from commonlaw.experiments.plan import Design
from commonlaw.experiments.search import SURE
from commonlaw.experiments.settings import Options, Range
from commonlaw.law import Law
from commonlaw.law.domain import Domain
from commonlaw.trials import Trials

_POINTS = 64
"""Experiments that are looked at, as they are sought unasked."""


@dataclass(frozen=True, eq=False)
class Suggestion:
    """Experiments for one purpose.

    Parameters
    ----------
    purpose
        What they are for, in words.
    design
        What to set, and what is to be expected.
    """

    purpose: str
    design: Design


def suggestions(law: Law, trials: Trials, most: int = 1) -> tuple[Suggestion, ...]:
    """Return what to measure next for up to three purposes: the law if it is in doubt, all coefficients, the worst one.

    Trials start anywhere in the ranges of states that were visited, with rates, inputs, duration and samples as in the
    trials that were made, and end where they leave what was visited: nothing is asked of laws beyond.

    Parameters
    ----------
    law
        It knows its noise and how accurate its coefficients are; nothing is suggested for others, and for laws in
        discrete time.
    trials
        What was measured.
    most
        Trials that all experiments for a purpose may have together.
    """
    if not law.has_std or law.order == 0 or not law.support.any():
        return ()
    visited = law.provenance.domain.visited or Domain.of(trials, law.state_rates).visited
    ranges = {name: Range(*visited[name]) for name in law.states if name in visited and np.ptp(visited[name]) > 0}
    vary: dict[str, Options] = {**usual(law, trials), **ranges}
    found = []
    for purpose, about in _purposes(law):
        settings: dict[str, Any] = {"experiments": most, "about": about, "points": _POINTS}
        try:
            made = design(law, vary, within=ranges, progress=lambda _: None, **settings)
        except CommonlawError:  # Forecasts may diverge from everywhere
            continue
        found.append(Suggestion(purpose, made))
    return tuple(found)


def _purposes(law: Law) -> list[tuple[str, str]]:
    purposes = [("To find out which law is right", LAW)] if law.plausible[0].probability < SURE else []
    purposes.append(("To know all coefficients better", COEFFICIENTS))
    values, errors = law.letter_values()
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(errors > 0, errors / np.abs(values), 0.0)
    if len(relative) * relative.shape[1] > 1 and np.nanmax(relative) > 0:
        owner, letter = np.unravel_index(int(np.nanargmax(relative)), relative.shape)
        name = law.letters[int(letter)]
        about = name if len(law.objects) == 1 else f"{name} of {law.objects[int(owner)]}"
        purposes.append((f"To know {about} better, the coefficient that is known worst", about))
    return purposes
