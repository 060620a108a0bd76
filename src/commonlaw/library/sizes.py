"""How large parameters and latent states are likely to be, from the sizes of what was measured.

What is added or compared is of one size, arguments of functions and exponents are of size one, and a rate is the size
of its state over the time that trials take. In logarithms these are linear equations, solved by least squares.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.library.grammar import OPERATIONS, Algebra, evaluate


class _Size(NamedTuple):
    """The logarithm of a size: a number and multiples of unknowns; and the number that it is of, if it is one."""

    known: float
    unknown: Floats
    value: float | None = None


class _Sizes:
    """Collects what equations say of sizes."""

    def __init__(self, unknowns: int) -> None:
        self.unknowns, self.rows = unknowns, list[tuple[Floats, float]]()
        operations = {name: partial(self._operation, name) for name in OPERATIONS}
        self.algebra = Algebra(self._number, operations)

    def _number(self, value: float) -> _Size:
        return _Size(np.log(abs(value)) if value else 0.0, np.zeros(self.unknowns), float(value))

    def equal(self, one: _Size, other: _Size) -> None:
        """Note that two sizes are the same."""
        if 0.0 not in (one.value, other.value):
            self.rows.append((one.unknown - other.unknown, other.known - one.known))

    def _operation(self, name: str, one: _Size, other: _Size | None = None) -> _Size:
        unit = self._number(1.0)
        if other is None:
            if name in ("abs", "negate", "floor", "ceil"):
                return one
            if name == "sqrt":
                return _Size(one.known / 2, one.unknown / 2)
            if name not in ("log", "log10", "log2"):
                self.equal(one, unit)
            return unit._replace(value=None)
        if name == "multiply":
            return _Size(one.known + other.known, one.unknown + other.unknown)
        if name == "divide":
            return _Size(one.known - other.known, one.unknown - other.unknown)
        if name == "power":
            if other.value is not None:
                return _Size(other.value * one.known, other.value * one.unknown)
            self.equal(other, unit)
            return _Size(one.known, one.unknown)
        self.equal(one, other)
        if name == "arctan2":
            return unit._replace(value=None)
        return other if one.value == 0.0 else one


def likely_sizes(
    equations: Sequence[tuple[str, float | int | None]], known: Mapping[int, float], variables: int, span: float
) -> Floats:
    """Return a size for each of the variables, shape (variables,), given known ones by column.

    Equations are expressions over ``v<i>``, each with what its size is: a number, the column of the state whose rate it
    is over the span of trials, or None if only its parts have sizes.
    """
    unknown = [i for i in range(variables) if i not in known]
    sizes = _Sizes(len(unknown))
    columns = [
        _Size(np.log(known[i]), np.zeros(len(unknown)))
        if i in known
        else _Size(0.0, np.eye(len(unknown))[unknown.index(i)])
        for i in range(variables)
    ]
    for text, size in equations:
        whole = evaluate(text, columns, sizes.algebra)
        if isinstance(size, int):
            state_size = columns[size]
            sizes.equal(whole, _Size(state_size.known - np.log(span), state_size.unknown))
        elif size is not None:
            sizes.equal(whole, _Size(np.log(size), np.zeros(len(unknown))))
    # The wish for sizes near one counts less than what equations say
    rows = [*sizes.rows, *((1e-3 * row, 0.0) for row in np.eye(len(unknown)))]
    matrix, right = np.array([row for row, _ in rows]), np.array([value for _, value in rows])
    result = np.ones(variables)
    result[[*known]] = [*known.values()]
    if unknown:
        logs = np.linalg.lstsq(matrix, right, rcond=None)[0]
        result[unknown] = np.exp(np.clip(logs, -60.0, 60.0))
    return result
