"""Grids of nonlinear parameters, by where they stand and how large what they are added to is; and terms on them.

In ``s/(K + s)`` K is tried about the size of s, in ``exp(u/U)`` U about the size of u, in ``cos(w*t + p)`` w at all
frequencies that samples tell apart and p around the circle, and exponents from -3 to 6.
"""

import ast
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.inference import settings
from commonlaw.library import ParametricTerm, Term, Terms, Variables
from commonlaw.library.grammar import columns_in, constant, evaluate


def log_grid(per_decade: int, decades: float = settings.MAX_DECADES) -> Floats:
    """Return values about one, so many in a decade, up and down by some decades."""
    count = round(decades * per_decade)
    return np.asarray(10.0 ** (np.arange(-count, count + 1) / per_decade))


def combined(banks: Sequence[Floats]) -> Floats:
    """Return combinations of the values of each parameter, shape (combinations, parameters); of too many, some."""
    if math.prod(map(len, banks)) > settings.MAX_COMBINATIONS:
        random = np.random.default_rng(0)
        return np.column_stack([random.choice(bank, settings.MAX_COMBINATIONS) for bank in banks])
    return np.stack(np.meshgrid(*banks, indexing="ij"), axis=-1).reshape(-1, len(banks))


def factor_powers(terms: Terms) -> Floats:
    """Return the power of each parameter in each term, shape (terms, parameters), NaN where it is no factor of it."""
    first = len(terms.variables.measured)
    points = np.random.default_rng(0).uniform(0.5, 1.5, (settings.GENERIC_POINTS, len(terms.variables.names)))
    values = terms.evaluate(points)[:, :, np.newaxis]
    slopes = terms.jacobian(points)[:, :, first:] * points[:, np.newaxis, first:]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(slopes == 0, 0.0, slopes / values)
    power = np.rint(ratios[0])
    return np.asarray(np.where((np.abs(ratios - power) < settings.ROUNDING).all(axis=0), power, np.nan))


def parameter_values(terms: Terms, values: Floats, columns: Sequence[int]) -> list[Floats]:
    """Return the values that each constant is tried at.

    Parameters
    ----------
    terms
        Whose parameters these are.
    values
        Of the variables without parameters, along what was measured, shape (n, variables).
    columns
        Those of the parameters.
    """
    near, grids = (
        log_grid(settings.PER_DECADE[min(len(columns), len(settings.PER_DECADE)) - 1]),
        dict[int, Floats](),
    )
    for tree in _trees(terms):
        _look(tree, None, values, near, grids)
    unknown = _near_size(None, near)
    return [grids.get(column, unknown) for column in columns]


def divisors(terms: Terms, first: int | None = None) -> list[str]:
    """Return the code of what terms are divided by: where it is zero, they have a pole.

    Only where variables are in it from the `first` column on, by default parameters.
    """
    divided = (node for tree in _trees(terms) for node in ast.walk(tree) if isinstance(node, ast.BinOp))
    below = {ast.unparse(quotient.right) for quotient in divided if isinstance(quotient.op, ast.Div)}
    first = len(terms.variables.measured) if first is None else first
    return sorted(divisor for divisor in below if any(column >= first for column in columns_in(divisor)))


def frequencies_in_time(terms: Terms) -> list[int]:
    """Return the columns of the parameters that time is multiplied with in a sine: w of ``cos(w*t + p)``."""
    variables, frequencies = terms.variables, set[int]()
    time = f"v{variables.index(variables.time)}"
    for call in (node for tree in _trees(terms) for node in ast.walk(tree)):
        if isinstance(call, ast.Call) and ast.unparse(call.func) in ("sin", "cos"):
            products = (
                node for node in ast.walk(call) if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult)
            )
            sides = [(ast.unparse(product.left), ast.unparse(product.right)) for product in products]
            frequencies |= {int(name[1:]) for pair in sides if time in pair for name in pair if name[1:].isdigit()}
    return sorted(column for column in frequencies if column >= len(variables.measured))


def _trees(terms: Terms) -> list[ast.expr]:
    """Return the terms as parsed code, whose variables are v0, v1, ..."""
    names = [f"v{i}" for i in range(len(terms.variables.names))]
    return [ast.parse(term.expression(names), mode="eval").body for term in terms.terms]


def _look(
    tree: ast.expr, size: float | None, values: Floats, near: Floats, grids: dict[int, Floats], angle: bool = False
) -> None:
    """Note values for the parameters in a tree that is about so large, or the angle of a sine."""
    inside = {column for column in columns_in(tree) if column >= values.shape[1]}
    if inside <= grids.keys():
        return
    match tree:
        case ast.Name(id=name):
            phases = 2 * np.pi / settings.PER_CYCLE * (np.arange(settings.PER_CYCLE) + 0.5)
            grids[int(name[1:])] = np.asarray(phases) if angle else _near_size(size, near)
        case ast.UnaryOp(operand=operand):
            _look(operand, size, values, near, grids, angle)
        case ast.Call(func=ast.Name(id=name), args=[argument]):
            _look(argument, 1.0, values, near, grids, angle=name in ("sin", "cos", "tan"))
        case ast.BinOp(op=ast.Pow(), left=base, right=exponent):
            number = constant(exponent)
            root = None if size is None or not number else size ** (1 / number)
            _look(base, root, values, near, grids)
            if isinstance(exponent, ast.Name):
                grids.setdefault(int(exponent.id[1:]), np.array(settings.EXPONENTS))
            _look(exponent, 1.0, values, near, grids)
        case ast.BinOp(op=op, left=left, right=right):
            for operand, sibling, first in ((right, left, False), (left, right, True)):
                other_size = _size(sibling, values)
                if angle and isinstance(operand, ast.Name) and other_size is not None:
                    if isinstance(op, ast.Mult):
                        grids.setdefault(int(operand.id[1:]), _frequencies(sibling, values))
                    elif isinstance(op, ast.Div) and not first:
                        grids.setdefault(int(operand.id[1:]), np.asarray(1 / _frequencies(sibling, values)))
                _look(operand, _operand_size(op, size, other_size, first), values, near, grids, angle)


def _operand_size(op: ast.operator, size: float | None, sibling: float | None, first: bool) -> float | None:
    """Return how large an operand is, by the sizes of the result and of the other operand; None if nothing tells."""
    if isinstance(op, ast.Add | ast.Sub):
        return size if sibling is None else sibling
    if size is None:
        return None
    if isinstance(op, ast.Mult):
        return size / (sibling or 1.0)
    return size * (sibling or 1.0) if first else (sibling or 1.0) / size


def _size(tree: ast.expr, values: Floats) -> float | None:
    """Return the root mean square of a tree; None if it has parameters in it, is zero or is not finite."""
    if any(column >= values.shape[1] for column in columns_in(tree)):
        return None
    rms = float(np.sqrt(np.mean(_along(tree, values) ** 2)))
    return rms if 0 < rms < np.inf else None


def _along(tree: ast.expr, values: Floats) -> Floats:
    with np.errstate(all="ignore"):
        return np.asarray(evaluate(tree, values.T) + np.zeros(len(values)))


def _frequencies(tree: ast.expr, values: Floats) -> Floats:
    """Return the frequencies that an angle may have of what is multiplied with them."""
    along = _along(tree, values)
    count = min(settings.PER_CYCLE * len(np.unique(along)) // 2, settings.MAX_COMBINATIONS)
    return np.asarray(2 * np.pi / (settings.PER_CYCLE * np.ptp(along)) * np.arange(1, count + 1))


def _near_size(size: float | None, near: Floats) -> Floats:
    """Return values of both signs about a size; if nothing tells it, of all sizes that are not rounding."""
    sizes = log_grid(1, -float(np.log10(settings.ROUNDING))) if size is None else size * near
    return np.concatenate([sizes, -sizes])


@dataclass(frozen=True, eq=False)
class ParameterGrids:
    """Terms along curves at the values of their parameters in a bank of each, one column for each.

    Parameters
    ----------
    others
        The terms.
    values
        Of the variables without parameters, along the curves, shape (n, variables).
    parameters
        The values in each bank, shape (values, parameters).
    columns
        All terms at all values, one bank behind the other, shape (n, columns).
    repeated
        Which terms are along these curves what one before is that has no more parameters, shape (terms,): s/(e + |s|)
        is s/(K + s) where s is positive.
    """

    others: tuple[ParametricTerm, ...]
    values: Floats
    parameters: tuple[Floats, ...]
    columns: Floats
    repeated: Bools

    @classmethod
    def along(
        cls,
        variables: Variables,
        values: Floats,
        others: Sequence[ParametricTerm],
        sampled: Bools | slice = slice(None),
    ) -> "ParameterGrids":
        """Return terms along curves at values of their parameters at which they are finite and no others' repeats.

        Periodic functions may be as fast as the points that were sampled resolve, by default all. Variables that are
        hardly below zero, most likely by noise, are kept above it, so that roots and logarithms exist.
        """
        sizes = np.sqrt(np.mean(values**2, axis=0))
        hardly = values.min(axis=0) > -settings.MAX_BELOW_ZERO * sizes
        values = np.where(hardly & (values < settings.MIN_ABOVE_ZERO * sizes), settings.MIN_ABOVE_ZERO * sizes, values)
        parameters, columns = list[Floats](), [np.empty((len(values), 0))]
        before, repeated = dict[bytes, int](), list[bool]()
        for each in others:
            bank = _bank(each, variables, values, sampled)
            terms = along(each, values, bank)
            count, usable = len(each.parameters), _usable(terms)
            parameters.append(bank[list(usable.values())])
            columns.append(terms[:, list(usable.values())])
            repeated.append(bool(usable) and all(before.get(shown, count + 1) <= count for shown in usable))
            before |= {shown: min(count, before.get(shown, count)) for shown in usable}
        return cls(
            tuple(others), values, tuple(parameters), np.concatenate(columns, axis=1), np.array(repeated, dtype=bool)
        )

    @cached_property
    def firsts(self) -> Indices:
        """The first column of each bank, and the number of columns."""
        return np.cumsum([0, *map(len, self.parameters)])


def along(term: ParametricTerm, values: Floats, bank: Floats) -> Floats:
    """Return a term along curves at each of some values of its parameters, shape (n, values)."""
    count, first = values.shape
    every = np.empty((len(bank), count, first + bank.shape[1]))
    every[:, :, :first], every[:, :, first:] = values, bank[:, np.newaxis]
    return np.asarray(term.term.evaluate(every.reshape(-1, every.shape[2])).reshape(len(bank), count).T)


def _bank(parametric: ParametricTerm, variables: Variables, values: Floats, sampled: Bools | slice) -> Floats:
    """Return values of the parameters of a term that are tried, without a pole along the curves or between points."""
    first = len(variables.measured)
    columns = range(first, first + len(parametric.parameters))
    places = (Term(parameter=column) for column in columns)
    terms = Terms(replace(variables, parameters=parametric.parameters), (parametric.term, *places))
    bank = combined(parameter_values(terms, values[sampled], columns)) if parametric.parameters else np.empty((1, 0))
    every = [*values.T[:, :, np.newaxis], *bank.T[:, np.newaxis, :]]
    whole = np.ones(len(bank), dtype=bool)
    for code in divisors(terms, 0):
        with np.errstate(all="ignore"):
            whole &= np.ptp(np.sign(evaluate(code, every)) + np.zeros((len(values), len(bank))), axis=0) == 0
    return np.asarray(bank[whole])


def _usable(columns: Floats) -> dict[bytes, int]:
    """Return the indices of columns that are finite, not zero, and no multiple of one before, by values at points."""
    with np.errstate(all="ignore"):
        sizes = np.sqrt(np.mean(columns**2, axis=0))
    good = np.flatnonzero(np.isfinite(sizes) & (sizes > 0))
    probes = np.linspace(0, len(columns) - 1, settings.GENERIC_POINTS).round().astype(int)
    shown = columns[np.ix_(probes, good)] / sizes[good]
    largest = np.take_along_axis(shown, np.abs(shown).argmax(axis=0, keepdims=True), axis=0)
    shown = np.rint(shown * np.where(largest < 0, -1.0, 1.0) / settings.ROUNDING) + 0.0  # Of zeros both signs are one
    distinct = dict[bytes, int]()
    for index, signature in zip(good.tolist(), shown.T, strict=True):
        distinct.setdefault(signature.tobytes(), index)
    return distinct
