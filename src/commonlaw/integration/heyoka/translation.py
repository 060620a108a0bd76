"""From terms to expressions of heyoka."""

import ast
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import heyoka

from commonlaw.library import AbstractTerm
from commonlaw.library.grammar import OPERATORS, constant

_NAMES = ("sqrt", "exp", "log", "sin", "cos", "tan", "sinh", "cosh", "tanh")
FUNCTIONS: Mapping[str, Callable[[Any], Any]] = {name: getattr(heyoka, name) for name in _NAMES} | {
    "arctan": heyoka.atan
}
"""Functions that have Taylor series wherever they are defined; abs and sign have none at 0."""


class UnsupportedError(Exception):
    """A law or an event that heyoka does not take; the text says why."""


def translated(term: AbstractTerm, variables: Sequence[Any]) -> Any:
    """Return a term as an expression of heyoka in these variables.

    Raises
    ------
    UnsupportedError
        If it holds a function without Taylor series.
    """
    text = term.expression([f"v{i}" for i in range(len(variables))])
    return _translated(ast.parse(text, mode="eval").body, variables)


def _translated(tree: ast.expr, variables: Sequence[Any]) -> Any:
    match tree:
        case ast.Name(id=name):
            return variables[int(name[1:])]
        case ast.Constant(value=int() | float() as number):
            return heyoka.expression(float(number))
        case ast.UnaryOp(op=op, operand=operand):
            inner = _translated(operand, variables)
            return -inner if isinstance(op, ast.USub) else inner
        case ast.BinOp(op=ast.Pow(), left=base, right=exponent):
            above = constant(exponent)
            if above is None:
                return _translated(base, variables) ** _translated(exponent, variables)
            return _power(_translated(base, variables), above)
        case ast.BinOp(op=op, left=left, right=right):
            return OPERATORS[type(op)](_translated(left, variables), _translated(right, variables))
        case ast.Call(func=ast.Name(id=name), args=[argument]) if name in FUNCTIONS:
            return FUNCTIONS[name](_translated(argument, variables))
        case _:
            raise UnsupportedError(f"{ast.unparse(tree).partition('(')[0]} has no Taylor series at 0")


def _power(base: Any, exponent: float) -> Any:
    """Return a power; a whole one as products, since heyoka's own power divides by the base."""
    if exponent != int(exponent):
        return base**exponent
    result = math.prod([base] * abs(int(exponent)), start=heyoka.expression(1.0))
    return result if exponent >= 0 else 1.0 / result
