"""Numbers as text and as JSON."""

import json
import re
from collections.abc import Mapping
from math import isfinite
from typing import Any

import numpy as np

_NUMBER = re.compile(r"(< )?(-)?([\d.]*\d|∞)(?:e([-+]\d+))?")
_SHOWN = re.compile(r"(< )?−?([\d.]*\d|∞)( × 10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def cell(value: object, digits: int) -> str:
    """Return a table's cell as text; a missing value is None.

    Numbers get a minus sign instead of a hyphen, also those that come as text to keep their digits.

    >>> cell(-0.123456, 3), cell(None, 3), cell(12, 3), cell("a-b", 3), cell("-0.50", 3), cell(True, 3)
    ('−0.123', '', '12', 'a-b', '−0.50', 'yes')
    >>> cell(-1.2345e-7, 3), cell("< 1e-9", 3), cell(float("nan"), 3)
    ('−1.23 × 10⁻⁷', '< 1 × 10⁻⁹', '')
    """
    match value:
        case None:
            return ""
        case bool() | np.bool_():
            return "yes" if value else "no"
        case float() | np.floating():
            text = "" if value != value else f"{value:.{digits}g}".replace("inf", "∞")
        case _:
            text = str(value)
    number = _NUMBER.fullmatch(text)
    if not number:
        return text
    bound, sign, size, power = number.groups()
    return (
        (bound or "") + ("−" if sign else "") + size + (f" × 10{str(int(power)).translate(_RAISED)}" if power else "")
    )


def is_number(text: str) -> bool:
    """Return whether a cell is set to the right.

    >>> is_number("−1.23 × 10⁻⁷"), is_number("0.5 v")
    (True, False)
    """
    return _SHOWN.fullmatch(text) is not None


def to_json(document: Mapping[str, Any]) -> bytes:
    """Return nested results as JSON; numbers that are not finite become null."""
    return (json.dumps(_plain(document), indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, float):
        return value if isfinite(value) else None
    return value
