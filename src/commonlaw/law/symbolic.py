"""Equations as SymPy expressions."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from commonlaw.array_types import Floats
from commonlaw.extras import optional_import
from commonlaw.library import Terms

if TYPE_CHECKING:
    import sympy


def sympy_equations(lefts: Sequence[str], coefficients: Floats, terms: Terms) -> "dict[sympy.Expr, sympy.Expr]":
    """Return left-hand sides to right-hand sides; coefficients of shape (equations, terms).

    Raises
    ------
    CommonlawError
        If SymPy is not installed.
    """
    sympy = optional_import("sympy", "the SymPy form of a law", "symbolic")
    symbols = [sympy.Symbol(each, real=True) for each in terms.variables.names]
    forms = [term.sympy(symbols) for term in terms.terms]
    return {
        sympy.Symbol(left, real=True): sympy.Add(
            *(sympy.Float(float(c)) * form for c, form in zip(row, forms, strict=True) if c)
        )
        for left, row in zip(lefts, coefficients, strict=True)
    }
