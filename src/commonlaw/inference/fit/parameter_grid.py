"""Grids of nonlinear parameters, from their role in a term and the sizes of variables; terms on these grids.

The grid of K in ``s/(K + s)`` is about the size of s, that of U in ``exp(u/U)`` about the size of u; that of w in
``cos(w*t + p)`` has all frequencies that samples resolve, and that of p a cycle; exponents are from -3 to 6.
"""

import ast
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.inference import settings
from commonlaw.library import ParametricTerm, Term, Terms, Variables
from commonlaw.library.grammar import columns_in, constant, evaluate
from commonlaw.runtime.forking import cached_property


def log_grid(per_decade: int, decades: float = settings.MAX_DECADES) -> Floats:
    """Return a logarithmic grid about one, with so many values per decade, over some decades up and down."""
    count = round(decades * per_decade)
    return np.asarray(10.0 ** (np.arange(-count, count + 1) / per_decade))


def grid_product(grids: Sequence[Floats]) -> Floats:
    """Return the product of grids, shape (points, parameters), a random sample if it has over `MAX_COMBINATIONS`."""
    if math.prod(map(len, grids)) > settings.MAX_COMBINATIONS:
        random = np.random.default_rng(0)
        return np.column_stack([random.choice(grid, settings.MAX_COMBINATIONS) for grid in grids])
    return np.stack(np.meshgrid(*grids, indexing="ij"), axis=-1).reshape(-1, len(grids))


def factor_powers(terms: Terms) -> Floats:
    """Return the exponent of each parameter as a factor of each term, shape (terms, parameters), else NaN."""
    first = len(terms.variables.measured)
    points = np.random.default_rng(0).uniform(0.5, 1.5, (settings.GENERIC_POINTS, len(terms.variables.names)))
    values = terms.evaluate(points)[:, :, np.newaxis]
    slopes = terms.jacobian(points)[:, :, first:] * points[:, np.newaxis, first:]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(slopes == 0, 0.0, slopes / values)
    power = np.rint(ratios[0])
    return np.asarray(np.where((np.abs(ratios - power) < settings.ROUNDING).all(axis=0), power, np.nan))


def parameter_values(terms: Terms, values: Floats, columns: Sequence[int]) -> list[Floats]:
    """Return the grid of each parameter of terms, by its column.

    Values of the other variables along the measurements have shape (n, variables).
    """
    near = log_grid(settings.PER_DECADE[min(len(columns), len(settings.PER_DECADE)) - 1])
    grids = dict[int, Floats]()
    for tree in _trees(terms):
        _add_grids(tree, None, values, near, grids)
    unknown = _near_size(None, near)
    return [grids.get(column, unknown) for column in columns]


def divisors(terms: Terms, first: int | None = None) -> list[str]:
    """Return the code of denominators with variables from the `first` column on, by default parameters."""
    divided = (node for tree in _trees(terms) for node in ast.walk(tree) if isinstance(node, ast.BinOp))
    below = {ast.unparse(quotient.right) for quotient in divided if isinstance(quotient.op, ast.Div)}
    first = len(terms.variables.measured) if first is None else first
    return sorted(divisor for divisor in below if any(column >= first for column in columns_in(divisor)))


def frequencies_in_time(terms: Terms) -> list[int]:
    """Return the columns of parameters that are frequencies in time, as w of ``cos(w*t + p)``."""
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


def _add_grids(
    tree: ast.expr, size: float | None, values: Floats, near: Floats, grids: dict[int, Floats], angle: bool = False
) -> None:
    """Add grids of the parameters in a tree that has this size, or is the angle of a sine."""
    inside = {column for column in columns_in(tree) if column >= values.shape[1]}
    if inside <= grids.keys():
        return
    match tree:
        case ast.Name(id=name):
            phases = 2 * np.pi / settings.PER_CYCLE * (np.arange(settings.PER_CYCLE) + 0.5)
            grids[int(name[1:])] = np.asarray(phases) if angle else _near_size(size, near)
        case ast.UnaryOp(operand=operand):
            _add_grids(operand, size, values, near, grids, angle)
        case ast.Call(func=ast.Name(id=name), args=[argument]):
            _add_grids(argument, 1.0, values, near, grids, angle=name in ("sin", "cos", "tan"))
        case ast.BinOp(op=ast.Pow(), left=base, right=exponent):
            number = constant(exponent)
            root = None if size is None or not number else size ** (1 / number)
            _add_grids(base, root, values, near, grids)
            if isinstance(exponent, ast.Name):
                grids.setdefault(int(exponent.id[1:]), np.array(settings.EXPONENTS))
            _add_grids(exponent, 1.0, values, near, grids)
        case ast.BinOp(op=op, left=left, right=right):
            for operand, sibling, first in ((right, left, False), (left, right, True)):
                other_size = _size(sibling, values)
                if angle and isinstance(operand, ast.Name) and other_size and np.ptp(_along(sibling, values)):
                    if isinstance(op, ast.Mult):
                        grids.setdefault(int(operand.id[1:]), _frequencies(sibling, values))
                    elif isinstance(op, ast.Div) and not first:
                        grids.setdefault(int(operand.id[1:]), np.asarray(1 / _frequencies(sibling, values)))
                _add_grids(operand, _operand_size(op, size, other_size, first), values, near, grids, angle)


def _operand_size(op: ast.operator, size: float | None, sibling: float | None, first: bool) -> float | None:
    """Return the size of an operand from those of the result and of its sibling; None if it is unknown."""
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
    """Return the frequencies w of an angle ``w f``, up to the Nyquist frequency of the values of f."""
    along = _along(tree, values)
    count = min(settings.PER_CYCLE * len(np.unique(along)) // 2, settings.MAX_COMBINATIONS)
    return np.asarray(2 * np.pi / (settings.PER_CYCLE * np.ptp(along)) * np.arange(1, count + 1))


def _near_size(size: float | None, near: Floats) -> Floats:
    """Return values of both signs about a size; if it is unknown, of all sizes above rounding."""
    sizes = log_grid(1, -float(np.log10(settings.ROUNDING))) if size is None else size * near
    return np.concatenate([sizes, -sizes])


@dataclass(frozen=True, eq=False)
class ParameterGrids:
    """Parametric terms along curves at all values of their parameter grids.

    Values of variables other than parameters have shape (n, variables), the grid of each term (values, parameters), and
    the terms at the values of their grids in turn (n, columns). Redundant terms are multiples of an earlier one with as
    few parameters, as s/(e + |s|) of s/(K + s) for positive s.
    """

    others: tuple[ParametricTerm, ...]
    values: Floats
    parameters: tuple[Floats, ...]
    columns: Floats
    redundant: Bools

    @classmethod
    def along(
        cls,
        variables: Variables,
        values: Floats,
        others: Sequence[ParametricTerm],
        sampled: Bools | slice = slice(None),
    ) -> "ParameterGrids":
        """Return terms along curves at grid values where they are finite and distinct.

        Frequencies are those that the sampled points resolve, by default all points. Variables slightly below zero,
        most likely by noise, are clipped above it, so that roots and logarithms exist.
        """
        sizes = np.sqrt(np.mean(values**2, axis=0))
        is_near_zero = values.min(axis=0) > -settings.MAX_BELOW_ZERO * sizes
        values = np.where(
            is_near_zero & (values < settings.MIN_ABOVE_ZERO * sizes), settings.MIN_ABOVE_ZERO * sizes, values
        )
        parameters, columns = list[Floats](), [np.empty((len(values), 0))]
        before, redundant = dict[bytes, int](), list[bool]()
        for term in others:
            grid = _grid(term, variables, values, sampled)
            terms = along(term, values, grid)
            count, usable = len(term.parameters), _usable(terms)
            parameters.append(grid[list(usable.values())])
            columns.append(terms[:, list(usable.values())])
            redundant.append(bool(usable) and all(before.get(shown, count + 1) <= count for shown in usable))
            before |= {shown: min(count, before.get(shown, count)) for shown in usable}
        return cls(
            tuple(others), values, tuple(parameters), np.concatenate(columns, axis=1), np.array(redundant, dtype=bool)
        )

    @cached_property
    def offsets(self) -> Indices:
        """The first column of each term, and the number of columns."""
        return np.cumsum([0, *map(len, self.parameters)])


def along(term: ParametricTerm, values: Floats, grid: Floats) -> Floats:
    """Return a parametric term along curves at values of its parameters, shape (n, values)."""
    count, first = values.shape
    every = np.empty((len(grid), count, first + grid.shape[1]))
    every[:, :, :first], every[:, :, first:] = values, grid[:, np.newaxis]
    return np.asarray(term.term.evaluate(every.reshape(-1, every.shape[2])).reshape(len(grid), count).T)


def _grid(parametric: ParametricTerm, variables: Variables, values: Floats, sampled: Bools | slice) -> Floats:
    """Return the parameter grid of a term, without values at which it has a pole along the curves."""
    first = len(variables.measured)
    columns = range(first, first + len(parametric.parameters))
    places = (Term(parameter=column) for column in columns)
    terms = Terms(replace(variables, parameters=parametric.parameters), (parametric.term, *places))
    grid = (
        grid_product(parameter_values(terms, values[sampled], columns)) if parametric.parameters else np.empty((1, 0))
    )
    every = [*values.T[:, :, np.newaxis], *grid.T[:, np.newaxis, :]]
    whole = np.ones(len(grid), dtype=bool)
    for code in divisors(terms, 0):
        with np.errstate(all="ignore"):
            whole &= np.ptp(np.sign(evaluate(code, every)) + np.zeros((len(values), len(grid))), axis=0) == 0
    return np.asarray(grid[whole])


def _usable(columns: Floats) -> dict[bytes, int]:
    """Return the indices of finite, nonzero columns that are no multiples of earlier ones, by signature."""
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
