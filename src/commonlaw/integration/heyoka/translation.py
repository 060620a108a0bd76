"""From terms to expressions of heyoka."""

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NoReturn

import heyoka

from commonlaw.library import Term
from commonlaw.library.grammar import Algebra, evaluate

_FUNCTIONS = ("sqrt", "exp", "log", "sin", "cos", "tan", "sinh", "cosh", "tanh")
"""Functions that have Taylor series wherever they are defined, beside arctan; abs and sign have none at 0."""


class UnsupportedError(Exception):
    """A law or an event that heyoka does not take; the text says why."""


def translated(term: Term, variables: Sequence[Any]) -> Any:
    """Return a term as an expression of heyoka in these variables.

    Raises
    ------
    UnsupportedError
        If it holds a function without Taylor series.
    """
    return evaluate(term.code, variables, _ALGEBRA)


def _power(base: Any, exponent: Any) -> Any:
    """Return a power; a whole one as products, since heyoka's own power divides by the base."""
    try:  # Without variables an expression is written as a number
        number = float(str(exponent))
    except ValueError:
        return base**exponent
    if not number.is_integer():
        return base**number
    result = math.prod([base] * abs(int(number)), start=heyoka.expression(1.0))
    return result if number >= 0 else 1.0 / result


def _refused(name: str, _: Any) -> NoReturn:
    raise UnsupportedError(f"{name} has no Taylor series at 0")


_OPERATIONS: Mapping[str, Callable[..., Any]] = {
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "divide": operator.truediv,
    "power": _power,
    "negate": operator.neg,
    "arctan": heyoka.atan,
    **{name: getattr(heyoka, name) for name in _FUNCTIONS},
    **{name: partial(_refused, name) for name in ("abs", "sign")},
}
_ALGEBRA = Algebra(lambda number: heyoka.expression(float(number)), _OPERATIONS)
