"""What to measure next, as the page shows it."""

from typing import Any

import msgspec

from commonlaw.app.result import Found
from commonlaw.app.words import text_in_page
from commonlaw.errors import CommonlawError
from commonlaw.experiments import suggestions

_MOST = 6
"""Trials that experiments may have together."""


class Budget(msgspec.Struct, forbid_unknown_fields=True):
    """How many trials may be made."""

    trials: int


def suggested(found: Found, asked: Budget) -> dict[str, Any]:
    """Return experiments for each purpose, with what they settle.

    Raises
    ------
    CommonlawError
        If the budget is none that the page offers, or nothing can be suggested.
    """
    if not 1 <= asked.trials <= _MOST:
        raise CommonlawError("design-budget", trials=asked.trials, limit=_MOST)
    made = suggestions(found.law, found.findings.training, asked.trials)
    if not made:
        raise CommonlawError("design-needs-uncertain-law")
    return {
        "suggestions": [
            {
                "purpose": text_in_page(each.purpose),
                "experiments": [text_in_page(own.text) for own in each.design.experiments],
                "trials": each.design.cost,
                "settles": [text_in_page(own) for own in each.design.sentences],
            }
            for each in made
        ]
    }
