"""The equations of a law in SymPy, and the shortest of their equivalent forms."""

from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.extras import optional_import
from commonlaw.law.from_text import read_equations
from commonlaw.law.law import Law
from commonlaw.library.notation import quoted

if TYPE_CHECKING:
    import sympy


def symbolic() -> Any:
    """Return SymPy.

    Raises
    ------
    CommonlawError
        If it is not installed.
    """
    return optional_import("sympy", "the simplest form of a law", "symbolic")


def symbol(name: str) -> "sympy.Symbol":
    """Return the symbol of a variable, a constant inside of terms or a letter."""
    return symbolic().Symbol(quoted(name), real=True)


def right_hand_sides(law: Law) -> "list[sympy.Expr]":
    """Return what the equations give, with symbols for letters."""
    sympy, columns = symbolic(), [symbol(name) for name in law.terms.variables.names]
    products = {(each.equation, each.term): each for each in law.named_products}
    found = []
    for j, k in np.argwhere(law.support & law.terms.is_factor).tolist():
        product = products.get((j, k))
        factors = [symbol(name) ** power for name, power in product.coefficients] if product else []
        number = product.factor if product else float(law.coefficients[0, j, k])
        found.append((j, sympy.Mul(_exact(number), *factors, law.terms.terms[k].sympy(columns))))
    return [sympy.Add(*(each for i, each in found if i == j)) for j in range(len(law.states))]


def shortest(law: Law, right_hand_sides: "Sequence[sympy.Expr]") -> tuple[str, ...]:
    """Return each equation in the equivalent form of fewest operations if `commonlaw.fit` reads it, else as a sum."""
    sympy = symbolic()
    forms = (sympy.factor, sympy.factor_terms, sympy.together, sympy.collect_const, sympy.simplify)
    plain, short = list[str](), list[str]()
    for left, right in zip(law.left_hand_sides, right_hand_sides, strict=True):
        found = [
            (each.count_ops(), f"{left} = {written(each, order)}")
            for each in (form(right) for form in (sympy.expand, *forms))
            for order in ("lex", "rev-lex")
        ]
        plain.append(found[0][1])
        short.append(min((operations, len(text), text) for operations, text in found)[2])
    try:
        read_equations(short, law.schema)
    except CommonlawError:
        return tuple(plain)
    return tuple(short)


def written(expression: "sympy.Expr", order: str = "lex") -> str:
    """Return an expression in the words of equations."""
    text = str(symbolic().sstr(expression, order=order))
    for theirs, ours in (("**", "^"), ("Abs(", "abs("), ("atan(", "arctan(")):
        text = text.replace(theirs, ours)
    return text


def _exact(number: float) -> "sympy.Expr":
    """Return a number as a ratio of whole numbers where it is one of small ones."""
    near = Fraction(number).limit_denominator(1000)
    if float(near) == number:
        return symbolic().Rational(near.numerator, near.denominator)
    return symbolic().Float(number)
