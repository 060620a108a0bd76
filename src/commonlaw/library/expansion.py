"""Sums multiplied out: products with parameters in equations, and functions of Python as sums of terms."""

import ast
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from commonlaw.errors import CommonlawError
from commonlaw.library.grammar import FUNCTION_NAMES, columns_in, constant, read, with_names, write
from commonlaw.library.notation import quoted

_MAX_SUMMANDS = 200
"""Most summands that a product is multiplied out into."""


class NotAFactorError(Exception):
    """A constant stands where no multiplying out makes it a factor; its column is the argument."""


class Product(NamedTuple):
    """A number, powers of parameters by their columns, and trees without parameters with their powers of 1 or -1."""

    factor: float
    parameters: Mapping[int, int]
    trees: tuple[tuple[ast.expr, int], ...]

    def times(self, other: "Product", power: int = 1) -> "Product":
        """Return the product, or with a power of -1 the quotient."""
        powers = dict(self.parameters)
        for column, parameter in other.parameters.items():
            powers[column] = powers.get(column, 0) + power * parameter
        trees = (*self.trees, *((tree, power * exponent) for tree, exponent in other.trees))
        kept = {column: exponent for column, exponent in powers.items() if exponent}
        return Product(self.factor * other.factor**power, kept, trees)


def multiplied_out(tree: ast.expr, variables: int, inside: int | None = None) -> list[Product]:
    """Return the products whose sum a tree is; what has no parameter in it stays as it is written.

    Columns from `variables` on are parameters. Those before the column `inside` may also stand in a function, a power,
    or a divisor that is a sum, which stay as they are written. Raises `NotAFactorError` if another one does, and
    `CommonlawError` if there are too many products.
    """
    inside = variables if inside is None else inside
    names = _constants(tree, variables)
    if not names:
        return [_plain(tree)]
    match tree:
        case ast.Name():
            return [Product(1.0, {names[0]: 1}, ())]
        case ast.UnaryOp(op=op, operand=operand):
            sign = -1.0 if isinstance(op, ast.USub) else 1.0
            return [
                summand._replace(factor=sign * summand.factor) for summand in multiplied_out(operand, variables, inside)
            ]
        case ast.BinOp(op=ast.Add() | ast.Sub()):
            return _sum(_addends(tree, 1), variables, inside)
        case ast.BinOp(left, ast.Mult() | ast.Div() as op, ast.UnaryOp(sign, operand)):
            return multiplied_out(ast.UnaryOp(sign, ast.BinOp(left, op, operand)), variables, inside)
        case ast.BinOp(
            left, ast.Mult() | ast.Div() as first_op, ast.BinOp(middle, ast.Mult() | ast.Div() as op, right)
        ):
            # Factor by factor, so that a sum in a divisor is separate from the numbers and parameters that multiply it
            inverse = ast.Mult() if isinstance(op, ast.Div) else ast.Div()
            last = op if isinstance(first_op, ast.Mult) else inverse
            return multiplied_out(ast.BinOp(ast.BinOp(left, first_op, middle), last, right), variables, inside)
        case ast.BinOp(op=ast.Mult() | ast.Div() as op, left=left, right=right):
            first, second = (multiplied_out(side, variables, inside) for side in (left, right))
            power = 1 if isinstance(op, ast.Mult) else -1
            if power < 0 and len(second) > 1:
                second = _whole(right, inside)
            if len(first) * len(second) > _MAX_SUMMANDS:
                raise CommonlawError("too-many-summands", limit=_MAX_SUMMANDS)
            return [first_part.times(second_part, power) for first_part in first for second_part in second]
    return _whole(tree, inside)


def _whole(tree: ast.expr, inside: int) -> list[Product]:
    """Return a tree as it is written, with parameters inside."""
    if others := _constants(tree, inside):
        raise NotAFactorError(others[0])
    return [Product(1.0, {}, ((tree, 1),))]


def _constants(tree: ast.expr, variables: int) -> list[int]:
    return sorted(column for column in columns_in(tree) if column >= variables)


def _addends(tree: ast.expr, sign: int) -> list[tuple[int, ast.expr]]:
    match tree:
        case ast.BinOp(op=ast.Add() | ast.Sub() as op, left=left, right=right):
            return [*_addends(left, sign), *_addends(right, sign if isinstance(op, ast.Add) else -sign)]
    return [(sign, tree)]


def _sum(addends: Sequence[tuple[int, ast.expr]], variables: int, inside: int) -> list[Product]:
    """Return the products of a sum; its addends without parameters stay together."""
    plain = [addend for addend in addends if not _constants(addend[1], variables)]
    result = [] if not plain else [_plain(_joined(plain))]
    for sign, tree in addends:
        if (sign, tree) not in plain:
            result += [
                summand._replace(factor=sign * summand.factor) for summand in multiplied_out(tree, variables, inside)
            ]
    return result


def _joined(addends: Sequence[tuple[int, ast.expr]]) -> ast.expr:
    sign, whole = addends[0]
    whole = whole if sign > 0 else ast.UnaryOp(ast.USub(), whole)
    for sign, tree in addends[1:]:
        whole = ast.BinOp(whole, ast.Add() if sign > 0 else ast.Sub(), tree)
    return whole


def _plain(tree: ast.expr) -> Product:
    """Return a product without parameters, its numbers apart."""
    number = constant(tree)
    if number is not None:
        return Product(number, {}, ())
    match tree:
        case ast.UnaryOp(op=op, operand=operand):
            inner = _plain(operand)
            return inner._replace(factor=-inner.factor if isinstance(op, ast.USub) else inner.factor)
        case ast.BinOp(op=ast.Mult() | ast.Div() as op, left=left, right=right):
            return _plain(left).times(_plain(right), 1 if isinstance(op, ast.Mult) else -1)
    return Product(1.0, {}, ((tree, 1),))


_NAMES = {"absolute": "abs", "remainder": "mod"}
_SIGNS = {"add": "+", "subtract": "-", "multiply": "*", "divide": "/", "power": "**"}
_COMPARISONS = ("less", "less_equal", "greater", "greater_equal", "equal", "not_equal")


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
        if method == "__call__" and name in (*FUNCTION_NAMES, "negative", "positive"):
            sign = {"negative": "-", "positive": "+"}.get(name, name)
            return Traced(f"({sign}({', '.join(map(_code, values))}))")
        raise CommonlawError("known-function-numpy", function=function.__name__, functions=FUNCTION_NAMES)


def traced(function: Callable[..., Any], values: dict[str, float | None]) -> Any:
    """Return what a function gives of numbers, and of variables for which None stands."""
    return function(**{name: Traced(quoted(name)) if value is None else value for name, value in values.items()})


def summands(result: Any, names: tuple[str, ...]) -> list[tuple[float, str]]:
    """Return the numbers and the terms, as texts over names, whose products are the summands of what was traced.

    Raises `CommonlawError` if it is neither a number nor traced, or has too many summands.
    """
    tree = read(_code(result), names)
    pairs = [(number, with_names(write(term), [quoted(name) for name in names])) for number, term in _expanded(tree)]
    if len(pairs) > _MAX_SUMMANDS:
        raise CommonlawError("known-function-too-long", summands=len(pairs), limit=_MAX_SUMMANDS)
    return [(number, text) for number, text in pairs if number]


Summands = list[tuple[float, ast.expr]]
_ONE = ast.Constant(1)


def _expanded(tree: ast.expr) -> Summands:
    """Return a tree as summands: numbers, and trees without numeric factors."""
    number = constant(tree)
    if number is not None:
        return [(number, _ONE)]
    match tree:
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return [(-factor, part) for factor, part in _expanded(operand)]
        case ast.BinOp(op=ast.Add(), left=left, right=right):
            return [*_expanded(left), *_expanded(right)]
        case ast.BinOp(op=ast.Sub(), left=left, right=right):
            return [*_expanded(left), *((-factor, part) for factor, part in _expanded(right))]
        case ast.BinOp(op=ast.Mult(), left=left, right=right):
            pairs = product(_expanded(left), _expanded(right))
            return [(f * g, _product(first, ast.Mult(), second)) for (f, first), (g, second) in pairs]
        case ast.BinOp(op=ast.Div(), left=left, right=right):
            factor, below = _single(right)
            return [(f / factor, _product(part, ast.Div(), below)) for f, part in _expanded(left)]
        case ast.BinOp(op=ast.Pow() as op, left=base, right=exponent) if (power := constant(exponent)) is not None:
            factor, inner = _single(base)
            if factor > 0 or power.is_integer():
                return [(factor**power, ast.BinOp(inner, op, exponent))]
        case ast.Call(func=name, args=[argument]):
            return [(1.0, ast.Call(name, [_sum_of(_expanded(argument))], []))]
    return [(1.0, tree)]


def _single(tree: ast.expr) -> tuple[float, ast.expr]:
    """Return a tree as one number and one tree, a sum as it is."""
    parts = _expanded(tree)
    return parts[0] if len(parts) == 1 else (1.0, _sum_of(parts))


def _sum_of(found: Summands) -> ast.expr:
    parts = [tree if number == 1 else _product(ast.Constant(number), ast.Mult(), tree) for number, tree in found]
    return reduce(lambda total, part: ast.BinOp(total, ast.Add(), part), parts)


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
