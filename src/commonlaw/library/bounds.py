"""Between which numbers a coefficient of equations lies, as people write it: ``K > 0``, ``1 < p < 2``."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.library.switches import with_steps

_SIGN = re.compile(r"\s*([<>])=?\s*")
EVENT = re.compile(r"(?P<condition>(?:[^`:<>]|`[^`]*`)*+[<>](?:[^`:]|`[^`]*`)*+):(?P<changes>.*)")
"""A condition and what changes where it becomes true: ``x < 0: v = -c v``."""


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
    own = [bound for bound in bounds if bound.name == name]
    return max((each.low for each in own), default=-np.inf), min((each.high for each in own), default=np.inf)


def parts_of(texts: str | Sequence[str]) -> list[str]:
    """Return equations, without switches, bounds and events, between semicolons or lines of a text or several."""
    listed = [texts] if isinstance(texts, str) else texts
    parts = [each.strip() for text in listed for each in re.split(r"[;\n]", text) if each.strip()]
    return [each if EVENT.fullmatch(each) else with_steps(each) for each in parts]


def is_bound(part: str) -> bool:
    """Return whether a part of a text is a bound, and neither an equation nor an event."""
    return _SIGN.search(part) is not None and not EVENT.fullmatch(part)


def bounds_in(texts: str | Sequence[str]) -> tuple[Bound, ...]:
    """Return the bounds that stand among equations; raises `CommonlawError` if one cannot be read, or leaves no number.

    >>> bounds_in("s' = -V s/(K + s); K > 0")
    (Bound(text='K > 0', name='K', low=0.0, high=inf),)
    """
    return tuple(_bound(each) for each in parts_of(texts) if is_bound(each))


def _bound(text: str) -> Bound:
    parts = _SIGN.split(text)
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
