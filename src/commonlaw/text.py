"""How names and numbers are shown: with nothing in them that a terminal, LaTeX or a page would obey."""

import json
import os
from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any
from unicodedata import category

_LETS_BE = frozenset("\n\t\u200c\u200d")
"""Ends of lines, tabs, and the joiners that some scripts need."""

_LATEX = {"\\": r"\backslash ", "~": r"\sim ", "^": r"\hat{}", " ": r"\ "} | {sign: f"\\{sign}" for sign in "#$%&_{}"}


def visible(text: str) -> str:
    r"""Return a text in which characters that control a terminal or hide stand as JSON writes them: ``\u001b``.

    Among them are those that turn the direction of writing, and bytes of file names that are not UTF-8. Lines stay.

    >>> print(visible("a\x1b[2J\nb"))
    a\u001b[2J
    b
    """
    if text.isprintable():
        return text
    return "".join(
        letter if letter in _LETS_BE or letter.isprintable() or category(letter) == "Zs" else escaped(letter)
        for letter in text
    )


def in_line(text: str) -> str:
    r"""Return a text as one line, `visible`, so that a name cannot look like more than it is.

    >>> print(in_line("a\nNote: b"))
    a\nNote: b
    """
    return "".join(escaped(letter) if letter in "\n\t" else letter for letter in visible(text))


def as_text(name: str) -> str:
    r"""Return the name of a file with bytes that are no text in UTF-8 written out, so that it can be saved anywhere.

    >>> print(as_text("\udcb5m"))
    \xb5m
    """
    return os.fsencode(name).decode(errors="backslashreplace")


def in_latex(name: str) -> str:
    r"""Return a name as LaTeX shows it within ``\mathrm{...}``.

    >>> print(in_latex("50% of \\input"))
    50\%\ of\ \backslash input
    """
    return "".join(_LATEX.get(letter, letter) for letter in in_line(name))


def escaped(text: str) -> str:
    r"""Return a text with what is not ASCII, or controls something, as JSON writes it.

    >>> print(escaped("\N{GREEK SMALL LETTER MU}m\x07"))
    \u03bcm\u0007
    """
    return json.dumps(text)[1:-1]


def counted(count: int, noun: str, ending: str = "s") -> str:
    """Return a number of things.

    >>> counted(1, "trial"), counted(3, "box", "es")
    ('1 trial', '3 boxes')
    """
    return f"{count} {noun}{'' if count == 1 else ending}"


def shown(names: Sequence[str], noun: str = "", most: int = 3) -> str:
    """Return how many there are of a noun, if one is given, and the first names, for a note."""
    count = counted(len(names), noun) if noun else f"{len(names)}"
    return f"{count} ({', '.join(names[:most])}{', ...' if len(names) > most else ''})"


def r_squared(score: float) -> str:
    """Return R^2 to five digits; what these would round to 1 is above the largest number below it.

    >>> r_squared(0.998472), r_squared(1 - 3.2e-7), r_squared(-6.4e-15), r_squared(float("nan"))
    ('R^2 = 0.99847', 'R^2 > 0.99999', 'R^2 = 0', 'no R^2, as no measured state varies')
    """
    if score != score:
        return "no R^2, as no measured state varies"
    text = f"{round(score, 12) + 0.0:.5g}"  # Of a forecast as good as the mean, rounding leaves about 1e-15
    return "R^2 > 0.99999" if text == "1" else f"R^2 = {text}"


def number_or_text(text: str) -> float | str:
    """Return the number that a text is, or the text itself."""
    try:
        return float(text)
    except ValueError:
        return text


def json_text(document: Mapping[str, Any]) -> str:
    """Return nested results, which may have arrays, as JSON; numbers that are not finite become null.

    >>> print(json_text({"score": float("nan"), "states": ("x", "y")}))
    {
     "score": null,
     "states": [
      "x",
      "y"
     ]
    }
    """
    return json.dumps(_plain(document), indent=1, ensure_ascii=False, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if hasattr(value, "tolist"):  # An array or number of NumPy, which is not loaded for text
        return _plain(value.tolist())
    return None if isinstance(value, float) and not isfinite(value) else value
