"""Parts of texts: equations, bounds and events among them, ``K > 0`` and ``x < 0: v = -c v``."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.runtime.arguments import check_type

_COMPARISON = re.compile(r"\s*([<>])=?\s*")
_ASSIGNMENT = re.compile(r"(?<![<>])=")
_QUOTED = re.compile(r"`(?:[^`]|``)+`")
_BRACED = re.compile(rf"{_QUOTED.pattern}|\{{([^{{}}`]+)\}}")
_SEPARATOR = re.compile(r"[;\n]")
_TRIAL = re.compile(r"\"([^\"]*)\"")
_TRIALS = re.compile(rf"@\s*{_TRIAL.pattern}(?:\s*,\s*{_TRIAL.pattern})*")


def _numbered(text: str) -> tuple[str, list[str]]:
    """Return a text with numbers in place of the names between backticks, so that nothing in these is read."""
    names = _QUOTED.findall(text)
    numbers = count()
    return _QUOTED.sub(lambda _: f"`{next(numbers)}`", text), names


def _restored(text: str, names: Sequence[str]) -> str:
    return _QUOTED.sub(lambda match: names[int(match[0][1:-1])], text)


def split_outside(text: str, separator: str = ",") -> list[str]:
    """Return the parts of a text between separators that are not inside of parentheses or backticks."""
    parts, depth, quoted, position = [""], 0, False, 0
    while position < len(text):
        if depth == 0 and not quoted and text.startswith(separator, position):
            parts.append("")
            position += len(separator)
            continue
        character = text[position]
        quoted ^= character == "`"
        depth += 0 if quoted else (character == "(") - (character == ")")
        parts[-1] += character
        position += 1
    return [part.strip() for part in parts]


EVENT = re.compile(r"(?P<condition>(?:[^`:<>]|`[^`]*`)*+[<>](?:[^`:]|`[^`]*`)*+):(?P<changes>.*)", re.DOTALL)
"""A condition and what changes where it becomes true: ``x < 0: v = -c v``."""


NEAR_BOUND = 3.0
"""Standard errors from a bound up to which the likelihood of a parameter may have several maxima, or none inside."""


@dataclass(frozen=True)
class Bound:
    """A coefficient's limits, infinite for none, with its name and the text they are from."""

    text: str
    name: str
    low: float = -np.inf
    high: float = np.inf

    def holds(self, values: Floats) -> bool:
        """Return whether all values are between the numbers."""
        return bool(np.all((values >= self.low) & (values <= self.high)))


def limits_of(name: str, bounds: Sequence[Bound]) -> tuple[float, float]:
    """Return between which numbers a coefficient lies, infinite for none."""
    limits = [bound for bound in bounds if bound.name == name]
    return max((bound.low for bound in limits), default=-np.inf), min((bound.high for bound in limits), default=np.inf)


def check_equations(texts: object) -> None:
    """Refuse what is neither a text nor a sequence of texts."""
    expected = 'a text or several, such as "x\' = -k x"'
    check_type("equations", texts, (str, Sequence), expected)
    if isinstance(texts, Sequence):
        for text in texts:
            check_type("equations", text, str, expected)


def parts_of(texts: str | Sequence[str]) -> list[str]:
    """Return equations, bounds and events as they stand between semicolons or lines of a text or several.

    A name in braces is one between backticks, which a shell would take for a command.

    >>> parts_of("x' = -{k} x; y' = x")
    ["x' = -`k` x", "y' = x"]
    """
    check_equations(texts)
    listed = [texts] if isinstance(texts, str) else texts
    parts = list[str]()
    for text in listed:
        between_backticks = _TRIALS.sub(
            lambda trials: _TRIAL.sub(lambda name: "`" + name[1].replace("`", "``") + "`", trials[0]), text
        )
        numbered, names = _numbered(_BRACED.sub(lambda m: f"`{m[1]}`" if m[1] else m[0], between_backticks))
        parts += [_restored(part.strip(), names) for part in _SEPARATOR.split(numbered) if part.strip()]
    return parts


def is_bound(part: str) -> bool:
    """Return whether a part of a text is a bound, and neither an equation nor an event."""
    bare = _QUOTED.sub("", part)
    is_comparison = _COMPARISON.search(bare) is not None and not _ASSIGNMENT.search(bare)
    return is_comparison and not EVENT.fullmatch(part)


def bounds_in(texts: str | Sequence[str]) -> tuple[Bound, ...]:
    """Return the bounds that stand among equations; raises `CommonlawError` if one is unreadable, or no number is left.

    >>> bounds_in("s' = -V s/(K + s); K > 0")
    (Bound(text='K > 0', name='K', low=0.0, high=inf),)
    """
    bounds = tuple(_bound(part) for part in parts_of(texts) if is_bound(part))
    for name in dict.fromkeys(bound.name for bound in bounds):
        low, high = limits_of(name, bounds)
        if not low < high:
            contradictory = "; ".join(bound.text for bound in bounds if bound.name == name)
            raise CommonlawError("bound-contradiction", parameter=name, bounds=contradictory)
    return bounds


def _bound(text: str) -> Bound:
    parts = _COMPARISON.split(text)
    numbers = [_number(part) for part in parts[::2]]
    names = [part for part, number in zip(parts[::2], numbers, strict=True) if number is None]
    one_way = len({*parts[1::2]}) == 1 and len(numbers) <= 3 and (len(numbers) < 3 or numbers[1] is None)
    if len(names) != 1 or not names[0].isidentifier() or not one_way:
        raise CommonlawError("bound-syntax", text=text)
    rising = numbers if parts[1] == "<" else numbers[::-1]
    at = rising.index(None)
    low, high = (rising[at - 1] if at else None), (rising[at + 1] if at + 1 < len(rising) else None)
    result = Bound(text, names[0], -np.inf if low is None else low, np.inf if high is None else high)
    if not result.low < result.high:
        raise CommonlawError("bound-empty", text=text)
    return result


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
