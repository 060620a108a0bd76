"""How a law was found: every choice on the way."""

import textwrap
from dataclasses import dataclass

_WIDTH = 60
"""Characters of a line of a reason."""


@dataclass(frozen=True)
class Step:
    """One choice on the way to a law.

    Parameters
    ----------
    stage
        What was to be chosen: ``"noise"``, ``"support"``.
    choice
        What was chosen: ``"x: 0.05 m"``.
    reason
        Why, with the numbers that decided.
    """

    stage: str
    choice: str
    reason: str


class History(tuple[Step, ...]):
    """Every choice on the way to a law, in order; it prints as a table.

    >>> print(History([Step("noise", "x: 0.05", "from differences of order 4")]))
    stage  choice   reason
    noise  x: 0.05  from differences of order 4
    """

    __slots__ = ()

    def __str__(self) -> str:
        if not self:
            return "no choices are on record"
        head = ("stage", "choice", "reason")
        cells = [tuple(textwrap.wrap(text, _WIDTH) or [""] for text in row) for row in [head, *map(_texts, self)]]
        widths = [max(len(line) for row in cells for line in row[j]) for j in range(2)]
        return "\n".join(line for row in cells for line in _lines(row, widths))


def _texts(step: Step) -> tuple[str, str, str]:
    return step.stage, step.choice, step.reason


def _lines(row: tuple[list[str], ...], widths: list[int]) -> list[str]:
    """Return the lines of a row whose cells have several."""
    count = max(map(len, row))
    first, second, third = ([*cell, *[""] * (count - len(cell))] for cell in row)
    return [
        f"{one:<{widths[0]}}  {two:<{widths[1]}}  {three}".rstrip()
        for one, two, three in zip(first, second, third, strict=True)
    ]
