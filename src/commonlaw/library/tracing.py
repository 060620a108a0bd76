"""Functions of Python as sums of terms: they are called with what writes down how it is computed with."""

import ast
from collections.abc import Callable
from functools import reduce
from itertools import product
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from commonlaw.errors import CommonlawError
from commonlaw.library.grammar import FUNCTIONS, OTHER_NAMES, constant, read, with_names, write
from commonlaw.library.notation import quoted

_NAMES = {"absolute": "abs", **OTHER_NAMES}
_SIGNS = {"add": "+", "subtract": "-", "multiply": "*", "divide": "/", "power": "**"}
_COMPARISONS = ("less", "less_equal", "greater", "greater_equal", "equal", "not_equal")
_MAX_SUMMANDS = 200
"""Summands of a function."""


class Traced(NDArrayOperatorsMixin):
    """A variable, or what was computed of variables, as an expression of the language of terms."""

    def __init__(self, code: str) -> None:
        self.code = code

    def __bool__(self) -> bool:
        raise CommonlawError("known-function-branches")

    def __array_ufunc__(self, function: np.ufunc, method: str, *values: Any, **_: Any) -> "Traced":
        name = _NAMES.get(function.__name__, function.__name__)
        if name in _COMPARISONS:
            raise CommonlawError("known-function-branches")
        if method == "__call__" and name in _SIGNS:
            return Traced(f"({_code(values[0])} {_SIGNS[name]} {_code(values[1])})")
        if method == "__call__" and name == "square":
            return Traced(f"({_code(values[0])} ** 2)")
        if method == "__call__" and name in (*FUNCTIONS, "negative", "positive"):
            sign = {"negative": "-", "positive": "+"}.get(name, name)
            return Traced(f"({sign}({_code(values[0])}))")
        raise CommonlawError("known-function-numpy", function=function.__name__, functions=FUNCTIONS)


def traced(function: Callable[..., Any], values: dict[str, float | None]) -> Any:
    """Return what a function gives of numbers, and of variables for which None stands."""
    return function(**{name: Traced(quoted(name)) if value is None else value for name, value in values.items()})


def summands(result: Any, names: tuple[str, ...]) -> list[tuple[float, str]]:
    """Return the numbers and the terms, as texts over names, whose products are the summands of what was traced.

    Raises `CommonlawError` if it is neither a number nor traced, or has too many summands.
    """
    tree = read(_code(result), names)
    found = [(number, with_names(write(each), [quoted(name) for name in names])) for number, each in _expanded(tree)]
    if len(found) > _MAX_SUMMANDS:
        raise CommonlawError("known-function-too-long", summands=len(found), limit=_MAX_SUMMANDS)
    return [(number, text) for number, text in found if number]


Summands = list[tuple[float, ast.expr]]
_ONE = ast.Constant(1)


def _expanded(tree: ast.expr) -> Summands:
    """Return a tree as summands: numbers, and trees without numeric factors."""
    number = constant(tree)
    if number is not None:
        return [(number, _ONE)]
    match tree:
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return [(-factor, each) for factor, each in _expanded(operand)]
        case ast.BinOp(op=ast.Add(), left=left, right=right):
            return [*_expanded(left), *_expanded(right)]
        case ast.BinOp(op=ast.Sub(), left=left, right=right):
            return [*_expanded(left), *((-factor, each) for factor, each in _expanded(right))]
        case ast.BinOp(op=ast.Mult(), left=left, right=right):
            pairs = product(_expanded(left), _expanded(right))
            return [(f * g, _product(one, ast.Mult(), other)) for (f, one), (g, other) in pairs]
        case ast.BinOp(op=ast.Div(), left=left, right=right):
            factor, below = _single(right)
            return [(f / factor, _product(each, ast.Div(), below)) for f, each in _expanded(left)]
        case ast.BinOp(op=ast.Pow() as op, left=base, right=exponent) if (power := constant(exponent)) is not None:
            factor, inner = _single(base)
            if factor > 0 or power.is_integer():
                return [(factor**power, ast.BinOp(inner, op, exponent))]
        case ast.Call(func=name, args=[argument]):
            return [(1.0, ast.Call(name, [_sum(_expanded(argument))], []))]
    return [(1.0, tree)]


def _single(tree: ast.expr) -> tuple[float, ast.expr]:
    """Return a tree as one number and one tree, a sum as it is."""
    found = _expanded(tree)
    return found[0] if len(found) == 1 else (1.0, _sum(found))


def _sum(found: Summands) -> ast.expr:
    """Return the sum of summands."""
    parts = [each if number == 1 else _product(ast.Constant(number), ast.Mult(), each) for number, each in found]
    return reduce(lambda left, right: ast.BinOp(left, ast.Add(), right), parts)


def _product(left: ast.expr, op: ast.operator, right: ast.expr) -> ast.expr:
    """Return a product or a quotient, without the factor one."""
    if right is _ONE:
        return left
    return right if left is _ONE and isinstance(op, ast.Mult) else ast.BinOp(left, op, right)


def _code(value: Any) -> str:
    if isinstance(value, Traced):
        return value.code
    try:
        return f"({float(value)!r})"
    except (TypeError, ValueError):
        what = type(value).__name__
        raise CommonlawError("known-function-result", result=what) from None
