"""Products with constants that are to be found, multiplied out: ``-k*(T - a)`` is ``-k*T + k*a``."""

import ast
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from commonlaw.errors import CommonlawError
from commonlaw.library.grammar import columns_in, constant

_MAX_SUMMANDS = 200
"""Summands of one product; more would be no law that somebody has in mind."""


class NotAFactorError(Exception):
    """A constant stands where no multiplying out makes it a factor; its column is the argument."""


class Product(NamedTuple):
    """A number, powers of constants by their columns, and trees without constants with their powers of 1 or -1."""

    factor: float
    constants: Mapping[int, int]
    trees: tuple[tuple[ast.expr, int], ...]

    def times(self, other: "Product", power: int = 1) -> "Product":
        """Return the product, or with a power of -1 the quotient."""
        powers = dict(self.constants)
        for column, own in other.constants.items():
            powers[column] = powers.get(column, 0) + power * own
        trees = (*self.trees, *((tree, power * own) for tree, own in other.trees))
        left = {column: own for column, own in powers.items() if own}
        return Product(self.factor * other.factor**power, left, trees)


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
            return [each._replace(factor=sign * each.factor) for each in multiplied_out(operand, variables, inside)]
        case ast.BinOp(op=ast.Add() | ast.Sub()):
            return _sum(_addends(tree, 1), variables, inside)
        case ast.BinOp(op=ast.Mult() | ast.Div() as op, left=left, right=right):
            first, second = (multiplied_out(each, variables, inside) for each in (left, right))
            power = 1 if isinstance(op, ast.Mult) else -1
            if power < 0 and len(second) > 1:
                second = _whole(right, inside)
            if len(first) * len(second) > _MAX_SUMMANDS:
                raise CommonlawError("too-many-summands", limit=_MAX_SUMMANDS)
            return [one.times(other, power) for one in first for other in second]
    return _whole(tree, inside)


def _whole(tree: ast.expr, inside: int) -> list[Product]:
    """Return a tree as it is written, with constants inside."""
    if others := _constants(tree, inside):
        raise NotAFactorError(others[0])
    return [Product(1.0, {}, ((tree, 1),))]


def _constants(tree: ast.expr, variables: int) -> list[int]:
    return sorted(each for each in columns_in(tree) if each >= variables)


def _addends(tree: ast.expr, sign: int) -> list[tuple[int, ast.expr]]:
    match tree:
        case ast.BinOp(op=ast.Add() | ast.Sub() as op, left=left, right=right):
            return [*_addends(left, sign), *_addends(right, sign if isinstance(op, ast.Add) else -sign)]
    return [(sign, tree)]


def _sum(addends: Sequence[tuple[int, ast.expr]], variables: int, inside: int) -> list[Product]:
    """Return the products of a sum; its addends without constants stay together."""
    plain = [each for each in addends if not _constants(each[1], variables)]
    found = [] if not plain else [_plain(_joined(plain))]
    for sign, tree in addends:
        if (sign, tree) not in plain:
            found += [each._replace(factor=sign * each.factor) for each in multiplied_out(tree, variables, inside)]
    return found


def _joined(addends: Sequence[tuple[int, ast.expr]]) -> ast.expr:
    sign, whole = addends[0]
    whole = whole if sign > 0 else ast.UnaryOp(ast.USub(), whole)
    for sign, tree in addends[1:]:
        whole = ast.BinOp(whole, ast.Add() if sign > 0 else ast.Sub(), tree)
    return whole


def _plain(tree: ast.expr) -> Product:
    """Return a product without constants, its numbers apart."""
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
