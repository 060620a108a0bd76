"""Any other function of the variables, given by an expression."""

import ast
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.library.dual import DUAL, Dual
from commonlaw.library.grammar import NUMPY, columns_in, compiled, factors_in, with_names
from commonlaw.library.naming import quoted
from commonlaw.library.term import AbstractTerm


@dataclass(frozen=True)
class Expression(AbstractTerm):
    """A function of the variables that is no monomial, sine or cosine, and no product of simpler ones: ``abs(v)``.

    `parse_term` makes it, from a text that is checked there.

    Parameters
    ----------
    code
        The expression with ``v0``, ``v1``, ... for the variables, as `commonlaw.library.grammar.write` writes it.
    """

    code: str

    def evaluate(self, values: Floats) -> Floats:
        with np.errstate(all="ignore"):
            return np.asarray(compiled(self.code)(values.T, NUMPY))

    def gradient(self, values: Floats) -> Floats:
        result = np.zeros(values.shape)
        with np.errstate(all="ignore"):
            dual = compiled(self.code)([Dual(column, {i: 1.0}) for i, column in enumerate(values.T)], DUAL)
        for i, slope in dual.slopes.items():
            result[:, i] = slope
        return result

    def columns(self) -> frozenset[int]:
        return columns_in(self.code)

    def complexity(self) -> float:
        return factors_in(self.code)

    def text(self, names: Sequence[str]) -> str:
        """Return ``abs(v)``, ``1 + x^2``."""
        return with_names(self.code.replace("**", "^"), names)

    def expression(self, names: Sequence[str]) -> str:
        """Return ``abs(v)``, ``1 + x**2``."""
        return with_names(self.code, [quoted(name) for name in names])

    @property
    def is_sum(self) -> bool:
        tree = ast.parse(self.code, mode="eval").body
        return isinstance(tree, ast.BinOp) and isinstance(tree.op, ast.Add | ast.Sub)

    def needs_parentheses(self, power: int) -> bool:
        """Say whether it stands in parentheses as that power in a product."""
        return self.is_sum or (power > 1 and not isinstance(ast.parse(self.code, mode="eval").body, ast.Call))
