"""Any other function of the variables, given by an expression."""

import ast
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.extras import optional_import
from commonlaw.library.dual import DUAL, Dual
from commonlaw.library.grammar import FUNCTIONS, LARGEST_NUMBER, NUMPY, Algebra, columns_in, compiled, with_names
from commonlaw.library.latex import expression_latex
from commonlaw.library.naming import quoted
from commonlaw.library.term import AbstractTerm

if TYPE_CHECKING:
    import sympy


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
        """Return the values, shape (n,)."""
        with np.errstate(all="ignore"):
            result: Floats = compiled(self.code)(values.T, NUMPY)
        return result

    def gradient(self, values: Floats) -> Floats:
        """Return the partial derivatives, shape (n, number of variables)."""
        result = np.zeros(values.shape)
        with np.errstate(all="ignore"):
            dual = compiled(self.code)([Dual(column, {i: 1.0}) for i, column in enumerate(values.T)], DUAL)
        for i, slope in dual.slopes.items():
            result[:, i] = slope
        return result

    def parts(self) -> None:
        """Return nothing: it is computed directly."""

    def columns(self) -> frozenset[int]:
        """Return the columns of the variables in it."""
        return columns_in(self.code)

    def text(self, names: Sequence[str]) -> str:
        """Return ``abs(v)``, ``1 + x^2``."""
        return with_names(self.code.replace("**", "^"), names)

    def expression(self, names: Sequence[str]) -> str:
        """Return ``abs(v)``, ``1 + x**2``."""
        return with_names(self.code, [quoted(name) for name in names])

    def latex(self, names: Sequence[str]) -> str:
        r"""Return ``\left|{v}\right|``."""
        return expression_latex(self.code, names)

    def sympy(self, symbols: Sequence["sympy.Symbol"]) -> "sympy.Expr":
        """Return the expression in the symbols.

        Raises
        ------
        CommonlawError
            If SymPy is not installed, or the variables cancel out, as in ``exp((x - x + 9)**99)``, and leave a number
            beyond all bounds.
        """
        sympy = optional_import("sympy", "the SymPy form of a term", "symbolic")

        renamed = {"abs": "Abs", "arctan": "atan"}
        functions = {name: _guarded(getattr(sympy, renamed.get(name, name))) for name in FUNCTIONS}
        return compiled(self.code)(symbols, Algebra(sympy.sympify, functions))

    @property
    def is_sum(self) -> bool:
        """Whether it needs parentheses in a product."""
        tree = ast.parse(self.code, mode="eval").body
        return isinstance(tree, ast.BinOp) and isinstance(tree.op, ast.Add | ast.Sub)

    @property
    def is_call(self) -> bool:
        """Whether it needs no parentheses anywhere."""
        return isinstance(ast.parse(self.code, mode="eval").body, ast.Call)


def _guarded(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return the SymPy function for arguments that it can take without computing for ever."""

    def apply(argument: Any) -> Any:
        number = None if argument.free_symbols else argument.evalf(5)
        if number is not None and not (number.is_finite and abs(number) <= LARGEST_NUMBER):
            raise CommonlawError(f"a number in a term is not finite or beyond {LARGEST_NUMBER:g}; write it without")
        return function(argument)

    return apply
