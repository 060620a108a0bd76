"""How things are counted in words."""

from collections.abc import Sequence

_SHOWN = 3
"""Names that a note lists."""


def counted(count: int, noun: str, ending: str = "s") -> str:
    """Return a number of things.

    >>> counted(1, "trial"), counted(3, "box", "es")
    ('1 trial', '3 boxes')
    """
    return f"{count} {noun}{'' if count == 1 else ending}"


def shown(names: Sequence[str], noun: str = "") -> str:
    """Return how many there are of a noun, if one is given, and the first names, for a note."""
    count = counted(len(names), noun) if noun else f"{len(names)}"
    return f"{count} ({', '.join(names[:_SHOWN])}{', ...' if len(names) > _SHOWN else ''})"


def r_squared_text(value: float) -> str:
    """Return R^2 to five digits, and where these are those of 1 how far below 1 it is.

    >>> r_squared_text(0.98765432), r_squared_text(1 - 3.21e-7), r_squared_text(1.0), r_squared_text(-2.7)
    ('0.98765', '1 - 3.2e-07', '1', '-2.7')
    """
    text = f"{value:.5g}"
    return f"1 - {1 - value:.2g}" if text == "1" and value < 1 else text


def r_squared(score: float) -> str:
    """Return R^2 with its name, see `r_squared_text`.

    >>> r_squared(0.998472), r_squared(1 - 3.2e-7)
    ('R^2 = 0.99847', 'R^2 = 1 - 3.2e-07')
    """
    return f"R^2 = {r_squared_text(score)}"
