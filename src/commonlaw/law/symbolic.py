"""Equations as SymPy expressions."""

from collections.abc import Sequence

import sympy

from commonlaw.array_types import Floats
from commonlaw.library import Terms


def sympy_equations(lefts: Sequence[str], coefficients: Floats, terms: Terms) -> dict[sympy.Expr, sympy.Expr]:
    """Return left-hand sides to right-hand sides; coefficients of shape (equations, terms)."""
    symbols = [sympy.Symbol(each, real=True) for each in terms.variables.names]
    forms = [term.sympy(symbols) for term in terms.terms]
    return {
        sympy.Symbol(left, real=True): sympy.Add(
            *(sympy.Float(float(c)) * form for c, form in zip(row, forms, strict=True) if c)
        )
        for left, row in zip(lefts, coefficients, strict=True)
    }
