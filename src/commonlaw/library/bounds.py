"""Switches, bounds and events among equations: ``max(a, b)``, ``K > 0``, ``x < 0: v = -c v``."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.runtime.arguments import check_type

_CALL = re.compile(r"(?<![\w`])(where|maximum|minimum|max|min)\s*(?=\()")
_COMPARISON = re.compile(r"(?<!\s)\s*([<>])=?\s*(?=[^`]*(?:`[^`]*`[^`]*)*$)")  # Not in a name between backticks
_ASSIGNMENT = re.compile(r"(?<![<>])=")
_BRANCH = re.compile(r"\b(?:if|else|and|or|not)\b|[<>]=?\s*$|[&|?]")
_STEP = re.compile(r"step\([^()]*\)")
_SIMPLE = re.compile(r"[\w.]+|`[^`]+`")
_QUOTED = re.compile(r"`(?:[^`]|``)+`")
_BRACED = re.compile(rf"{_QUOTED.pattern}|\{{([^{{}}`]+)\}}")
_DOMAIN = re.compile(
    r"(?P<function>(?<!\w)(?:sqrt|ln|log\w*|acos\w*|arccos\w*)(?=\())?(?P<argument>\(|`[^`]*`|(?<!\w)[^\W\d]\w*(?![\w(]))"
)
"""What may be the argument of a root or logarithm, or the base of a power."""
_POWER = re.compile(r"\s*(?:\^|\*\*)(?!\s*\d+(?![\w.]))")
"""A power that is not a whole number."""
_SEPARATOR = re.compile(r"[;\n]")
_TRIAL = re.compile(r"@\s*\"([^\"]*)\"")


def with_steps(equation: str) -> str:
    """Return an equation without conditions, `where`, `max` or `min`; anything else as it is.

    ``a > b`` is ``step(a - b)``, one where it holds and zero elsewhere; ``where(c, a, b)`` is ``c a + (1 - c) b``; and
    ``max(a, b)`` is ``b + step(a - b) (a - b)``. What is times or plus zero is left out.

    >>> with_steps("x' = -k x + where(t > 5, a, b)")
    "x' = -k x + (step(t - 5)*a + (1 - step(t - 5))*b)"
    >>> with_steps("x' = max(x, 0) + where(x > 1, c, 0)")
    "x' = (step(x)*x) + (step(x - 1)*c)"
    """
    text, names = _numbered(equation)
    return _restored(_with_steps(text), names)


def _numbered(text: str) -> tuple[str, list[str]]:
    """Return a text with numbers in place of the names between backticks, so that nothing in these is read."""
    names = _QUOTED.findall(text)
    numbers = count()
    return _QUOTED.sub(lambda _: f"`{next(numbers)}`", text), names


def _restored(text: str, names: Sequence[str]) -> str:
    return _QUOTED.sub(lambda match: names[int(match[0][1:-1])], text)


def _with_steps(equation: str) -> str:
    assignment = _ASSIGNMENT.search(equation)
    if assignment is None or not (_CALL.search(equation) or _COMPARISON.search(equation)):
        return equation
    if _BRANCH.search(equation):
        raise CommonlawError("condition-syntax", expression=equation)
    space = re.match(r"\s*", equation[assignment.end() :])
    right = equation[assignment.end() :].strip()
    return equation[: assignment.end()] + (space[0] if space else "") + _rewritten(right, equation)


def _rewritten(text: str, whole: str) -> str:
    """Return a text between parentheses or commas without switches."""
    rewritten, at = "", 0
    while at < len(text):
        call = _CALL.match(text, at)
        begins = call.end() if call else at
        if text[begins] == "`":
            until = text.find("`", begins + 1) + 1 or len(text)
            rewritten += text[begins:until]
        elif text[begins] == "(":
            until = _closing(text, begins, whole) + 1
            inner = text[begins + 1 : until - 1]
            content = _call(call[1], inner, whole) if call else _rewritten(inner, whole)
            is_step = _STEP.fullmatch(content) and not call
            rewritten += f"{' ' * rewritten[-1:].isalnum()}{content}" if call or is_step else f"({content})"
        else:
            until = at + 1
            rewritten += text[at]
        at = until
    parts = _COMPARISON.split(rewritten)  # Those inside of parentheses have been rewritten
    if len(parts) == 1:
        return rewritten
    steps = []
    for part, sign, right in zip(parts[::2], parts[1::2], parts[2::2], strict=False):
        high, low = (part, right) if sign == ">" else (right, part)
        if not high or not low:
            raise CommonlawError("condition-syntax", expression=whole)
        below = "" if low == "0" else f" - {_factor(low)}"
        steps.append(f"step({high}{below})")
    return "*".join(steps)


def _call(name: str, inner: str, whole: str) -> str:
    arguments = [_rewritten(argument, whole) for argument in split_outside(inner)]
    if len(arguments) != (3 if name == "where" else 2) or not all(arguments):
        raise CommonlawError("switch-arguments", name=name, expression=whole)
    if name == "where":
        condition, *both = arguments
        holds = condition if _STEP.fullmatch(condition) else f"({condition})"
        yes, no = map(_factor, (_guarded(both[0], holds), _guarded(both[1], f"(1 - {holds})")))
        return f"({condition}*{yes})" if no == "0" else f"({condition}*{yes} + (1 - {condition})*{no})"
    first, second = map(_factor, arguments)
    if name.startswith("max") and "0" in (first, second):
        positive = first if second == "0" else second
        return f"(step({positive})*{positive})"
    larger = f"{first} - {second}" if name.startswith("max") else f"{second} - {first}"
    return f"({second} {'+' if name.startswith('max') else '-'} step({larger})*({larger}))"


def _guarded(branch: str, holds: str) -> str:
    """Return a branch whose roots, logarithms and powers have a value where its condition does not hold.

    There what they are of is one: ``sqrt(g)`` is ``sqrt(holds*g + (1 - holds))``, or ``sqrt(max(g, 0))`` if the
    condition is ``g > 0``. A branch that is not taken would be times zero, and no number times zero is no number.
    """
    guarded, at = "", 0
    for match in _DOMAIN.finditer(branch):
        if match.start() < at:
            continue
        begins = match.start("argument")
        ends = _closing(branch, begins, branch) + 1 if branch[begins] == "(" else match.end("argument")
        power = _POWER.match(branch, ends)
        if not (match["function"] or power):
            continue
        argument = branch[begins:ends]
        inner = _guarded(argument[1:-1], holds) if argument[0] == "(" else argument
        is_root = power is not None or match["function"] == "sqrt"
        if is_root and _is_positive(inner, holds):
            inner = f"step({inner})*{_factor(inner)}"
        else:
            inner = f"{holds}*{_factor(inner)} + (1 - {holds})"
        guarded += f"{branch[at : match.start()]}{match['function'] or ''}({inner})"
        at = ends
    return guarded + branch[at:]


def _is_positive(text: str, holds: str) -> bool:
    """Return whether a condition, or the opposite of one, is that a number is not negative."""
    opposite = re.fullmatch(r"\(1 - step\((.+) - (.+)\)\)", holds)
    below = opposite and (opposite[2] if opposite[1] == "0" else f"{opposite[2]} - {opposite[1]}")
    return text == below or holds == f"step({text})"


def _factor(text: str) -> str:
    return text if _SIMPLE.fullmatch(text) else f"({text})"


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


def _closing(text: str, opening: int, whole: str) -> int:
    depth = 0
    for i in range(opening, len(text)):
        depth += (text[i] == "(") - (text[i] == ")")
        if not depth:
            return i
    raise CommonlawError("condition-syntax", expression=whole)


EVENT = re.compile(r"(?P<condition>(?:[^`:<>]|`[^`]*`)*+[<>](?:[^`:]|`[^`]*`)*+):(?P<changes>.*)", re.DOTALL)
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
    """Return equations, without switches, bounds and events, between semicolons or lines of a text or several.

    A name in braces is one between backticks, which a shell would take for a command.

    >>> parts_of("x' = -{k} x; y' = x")
    ["x' = -`k` x", "y' = x"]
    """
    check_equations(texts)
    listed = [texts] if isinstance(texts, str) else texts
    parts = list[str]()
    for text in listed:
        between_backticks = _TRIAL.sub(lambda match: "@ `" + match[1].replace("`", "``") + "`", text)
        numbered, names = _numbered(_BRACED.sub(lambda m: f"`{m[1]}`" if m[1] else m[0], between_backticks))
        parts += [_restored(part.strip(), names) for part in _SEPARATOR.split(numbered) if part.strip()]
    return [part if EVENT.fullmatch(part) else with_steps(part) for part in parts]


def is_bound(part: str) -> bool:
    """Return whether a part of a text is a bound, and neither an equation nor an event."""
    return _COMPARISON.search(part) is not None and not EVENT.fullmatch(part)


def bounds_in(texts: str | Sequence[str]) -> tuple[Bound, ...]:
    """Return the bounds that stand among equations; raises `CommonlawError` if one cannot be read, or leaves no number.

    >>> bounds_in("s' = -V s/(K + s); K > 0")
    (Bound(text='K > 0', name='K', low=0.0, high=inf),)
    """
    return tuple(_bound(part) for part in parts_of(texts) if is_bound(part))


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
