"""What to measure next, as the page shows it."""

from typing import Any

import msgspec

from commonlaw.app.result import Found
from commonlaw.app.words import in_page
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
        raise CommonlawError(f"a budget of {asked.trials} trials: choose 1 to {_MOST}")
    made = suggestions(found.law, found.findings.training, asked.trials)
    if not made:
        raise CommonlawError(
            "nothing can be suggested: that takes a law of continuous time that knows how accurate its coefficients are"
        )
    return {
        "suggestions": [
            {
                "purpose": in_page(each.purpose),
                "experiments": [in_page(own.text) for own in each.design.experiments],
                "trials": each.design.cost,
                "settles": [in_page(own) for own in each.design.sentences],
            }
            for each in made
        ]
    }
