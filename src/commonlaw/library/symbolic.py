"""Expressions as SymPy expressions."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from commonlaw.errors import CommonlawError
from commonlaw.extras import optional_import
from commonlaw.library.grammar import FUNCTIONS, LARGEST_NUMBER, Algebra, compiled

if TYPE_CHECKING:
    import sympy


def sympy_form(code: str, symbols: Sequence["sympy.Symbol"]) -> "sympy.Expr":
    """Return what `commonlaw.library.grammar.write` returned as a SymPy expression in symbols, one for each column."""
    sympy = optional_import("sympy", "the SymPy form of a term", "symbolic")
    renamed = {"abs": "Abs", "arctan": "atan"}
    functions = {name: _guarded(getattr(sympy, renamed.get(name, name))) for name in FUNCTIONS}
    return compiled(code)(symbols, Algebra(sympy.sympify, functions))


def _guarded(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return the SymPy function for arguments that it can take without computing for ever."""

    def apply(argument: Any) -> Any:
        number = None if argument.free_symbols else argument.evalf(5)
        if number is not None and not (number.is_finite and abs(number) <= LARGEST_NUMBER):
            raise CommonlawError(f"a number in a term is not finite or beyond {LARGEST_NUMBER:g}; write it without")
        return function(argument)

    return apply
