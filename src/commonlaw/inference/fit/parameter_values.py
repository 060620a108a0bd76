"""Values that constants inside of terms are tried at: by where they stand, and how large what stands beside them is.

In ``s/(K + s)`` K is tried about the size of s, in ``exp(u/U)`` U about the size of u, in ``cos(w*t + p)`` w at all
frequencies that samples tell apart and p around the circle, and exponents from -3 to 6.
"""

import ast
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.library import Terms
from commonlaw.library.grammar import NUMPY, columns_in, compiled, constant

_NEAR = {1: 10.0 ** np.arange(-1.5, 1.51, 0.125), 2: 10.0 ** np.arange(-1.5, 1.51, 0.25)}
_NEAR_OF_MORE = 10.0 ** np.arange(-2.0, 2.1, 0.5)
"""About a size that is known from what stands beside a constant: finer steps for one or two constants."""

_ANY = 10.0 ** np.arange(-6.0, 6.1)
"""About a size that nothing tells."""

_EXPONENTS = np.array([-3.0, -2.0, -1.5, -1.0, -0.5, 0.25, 0.5, 0.75, 1.25, 1.5, 2.0, 3.0, 4.0, 6.0])

_PHASES = np.arange(0.5, 8.0) * np.pi / 4

_PER_CYCLE, _PER_CYCLE_ALONE = 4, 16
"""Frequencies for each cycle that there may be in the range of a variable, so that some phase is right all along it, or
the only one where no phase is sought."""

_MOST_FREQUENCIES = 1000
MOST_COMBINATIONS = 3000
"""Combinations that are tried; of more, as many are drawn."""


def values_to_try(terms: Terms, values: Floats, columns: Sequence[int]) -> Floats:
    """Return combinations of the values of `values_of_each`, shape (combinations, constants)."""
    return combined(values_of_each(terms, values, columns))


def combined(banks: Sequence[Floats]) -> Floats:
    """Return combinations of the values of each constant, shape (combinations, constants)."""
    counts = [len(each) for each in banks]
    chosen = np.arange(int(np.prod(counts, dtype=float)))
    if len(chosen) > MOST_COMBINATIONS:
        chosen = np.random.default_rng(0).choice(len(chosen), MOST_COMBINATIONS, replace=False)
    return np.column_stack([bank[each] for bank, each in zip(banks, np.unravel_index(chosen, counts), strict=True)])


def values_of_each(terms: Terms, values: Floats, columns: Sequence[int]) -> list[Floats]:
    """Return the values that each constant is tried at.

    Parameters
    ----------
    terms
        Whose constants these are.
    values
        Of the variables without constants, along what was measured, shape (n, variables).
    columns
        Those of the constants.
    """
    found: dict[int, Floats] = {}
    near = _NEAR.get(len(columns), _NEAR_OF_MORE)
    steps = _Steps(near, _PER_CYCLE_ALONE if len(columns) == 1 else _PER_CYCLE)
    names = [f"v{i}" for i in range(len(terms.variables.names))]
    for term in terms.terms:
        _look(ast.parse(term.expression(names), mode="eval").body, None, values, steps, found)
    return [found.get(column, _both_signs(_ANY)) for column in columns]


def divisors(terms: Terms, first: int | None = None) -> list[str]:
    """Return the code of what terms are divided by: where it is zero, they have a pole.

    Only where variables are in it from the `first` column on, by default constants.
    """
    names = [f"v{i}" for i in range(len(terms.variables.names))]
    trees = [ast.parse(term.expression(names), mode="eval") for term in terms.terms]
    divided = (each for tree in trees for each in ast.walk(tree) if isinstance(each, ast.BinOp))
    below = {ast.unparse(each.right) for each in divided if isinstance(each.op, ast.Div)}
    first = len(terms.variables.measured) if first is None else first
    return sorted(each for each in below if any(column >= first for column in columns_in(each)))


def frequencies_in_time(terms: Terms) -> list[int]:
    """Return the columns of the constants that time is multiplied with in a sine: w of ``cos(w*t + p)``."""
    variables, found = terms.variables, set[int]()
    names = [f"v{i}" for i in range(len(variables.names))]
    time = names[variables.index(variables.time)]
    trees = [ast.parse(term.expression(names), mode="eval") for term in terms.terms]
    for each in (node for tree in trees for node in ast.walk(tree)):
        if isinstance(each, ast.Call) and ast.unparse(each.func) in ("sin", "cos"):
            products = (own for own in ast.walk(each) if isinstance(own, ast.BinOp) and isinstance(own.op, ast.Mult))
            sides = [(ast.unparse(own.left), ast.unparse(own.right)) for own in products]
            found |= {int(name[1:]) for pair in sides if time in pair for name in pair if name[1:].isdigit()}
    return sorted(column for column in found if column >= len(variables.measured))


class _Steps(NamedTuple):
    """How finely values are tried: about a size that is known, and of frequencies for each cycle."""

    near: Floats
    per_cycle: int


def _look(
    tree: ast.expr, size: float | None, values: Floats, steps: _Steps, found: dict[int, Floats], angle: bool = False
) -> None:
    """Note values for the constants in a tree that is about so large, or the angle of a sine."""
    inside = {each for each in columns_in(ast.unparse(tree)) if each >= values.shape[1]}
    if not inside <= found.keys():
        match tree:
            case ast.Name(id=name):
                found[int(name[1:])] = _PHASES if angle else _both_signs(_ANY if size is None else size * steps.near)
            case ast.UnaryOp(operand=operand):
                _look(operand, size, values, steps, found, angle)
            case ast.Call(func=ast.Name(id=name), args=[argument]):
                _look(argument, 1.0, values, steps, found, angle=name in ("sin", "cos", "tan"))
            case ast.BinOp(op=ast.Pow(), left=base, right=exponent):
                number = constant(exponent)
                root = None if size is None or not number else size ** (1 / number)
                _look(base, root, values, steps, found)
                if isinstance(exponent, ast.Name):
                    found.setdefault(int(exponent.id[1:]), _EXPONENTS)
                _look(exponent, 1.0, values, steps, found)
            case ast.BinOp(op=op, left=left, right=right):
                for own, other, first in ((right, left, False), (left, right, True)):
                    other_size = _size(other, values)
                    if angle and isinstance(op, ast.Mult) and isinstance(own, ast.Name) and other_size is not None:
                        found.setdefault(int(own.id[1:]), _frequencies(other, values, steps.per_cycle))
                    if angle and isinstance(op, ast.Div) and isinstance(own, ast.Name) and own is right and other_size:
                        found.setdefault(int(own.id[1:]), 1 / _frequencies(other, values, steps.per_cycle))
                    _look(own, _SIZES[type(op)](size, other_size, first), values, steps, found, angle)


def _of_sum(size: float | None, other: float | None, _: bool) -> float | None:
    return size if other is None else other


def _of_product(size: float | None, other: float | None, _: bool) -> float | None:
    return None if size is None else size / (other or 1.0)


def _of_quotient(size: float | None, other: float | None, above: bool) -> float | None:
    if size is None:
        return None
    return size * (other or 1.0) if above else (other or 1.0) / size


_SIZES: Mapping[type[ast.operator], Callable[[float | None, float | None, bool], float | None]] = {
    ast.Add: _of_sum,
    ast.Sub: _of_sum,
    ast.Mult: _of_product,
    ast.Div: _of_quotient,
}
"""How large an operand is, by the size of the result, that of the other operand, and whether it is the first one."""


def _size(tree: ast.expr, values: Floats) -> float | None:
    """Return the root mean square of a tree; None if it has constants in it, is zero or is not finite."""
    code = ast.unparse(tree)
    if any(each >= values.shape[1] for each in columns_in(code)):
        return None
    found = float(np.sqrt(np.mean(_along(code, values) ** 2)))
    return found if 0 < found < np.inf else None


def _along(code: str, values: Floats) -> Floats:
    with np.errstate(all="ignore"):
        return np.asarray(compiled(code)(values.T, NUMPY) + np.zeros(len(values)))


def _frequencies(tree: ast.expr, values: Floats, per_cycle: int) -> Floats:
    """Return the frequencies that an angle may have of what is multiplied with them."""
    along = _along(ast.unparse(tree), values)
    count = min(per_cycle * len(np.unique(along)) // 2, _MOST_FREQUENCIES)
    return np.asarray(2 * np.pi / (per_cycle * np.ptp(along)) * np.arange(1, count + 1))


def _both_signs(sizes: Floats) -> Floats:
    return np.concatenate([sizes, -sizes])
