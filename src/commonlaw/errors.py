"""The one kind of error that a user of commonlaw can cause and mend."""

from collections.abc import Iterable
from difflib import get_close_matches

from commonlaw.names import in_line


class CommonlawError(ValueError):
    """Input that cannot be used; the message says in one line what is wrong, where, and what to do."""

    def __init__(self, message: str) -> None:
        super().__init__(in_line(message))


def unknown(kind: str, name: object, known: Iterable[object]) -> CommonlawError:
    """Return the error for a name that is not among the known ones, with the nearest suggestion.

    >>> print(unknown("column", "hieght", ["t", "height"]))
    unknown column 'hieght': did you mean 'height'? Known: t, height
    """
    names = [str(each) for each in known]
    folded = {each.casefold(): each for each in reversed(names)}
    near = get_close_matches(str(name).casefold(), folded, n=1, cutoff=0.6)
    hint = f"did you mean {folded[near[0]]!r}? " if near else ""
    return CommonlawError(f"unknown {kind} {str(name)!r}: {hint}Known: {', '.join(names) or 'none'}")


def check_choice(name: str, value: object, choices: Iterable[object]) -> None:
    """Refuse a value that is not among the choices of a setting, with the nearest suggestion."""
    known = list(choices)
    if value not in known:
        raise unknown(name, value, known)
