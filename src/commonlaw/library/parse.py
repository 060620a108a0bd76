"""From the text of a term to the term."""

import ast
from collections import Counter
from collections.abc import Sequence

from commonlaw.errors import CommonlawError
from commonlaw.library.constant import Constant
from commonlaw.library.expression import Expression
from commonlaw.library.grammar import constant, read, write
from commonlaw.library.monomial import variable
from commonlaw.library.product import multiply_powers
from commonlaw.library.term import AbstractTerm
from commonlaw.library.terms import Terms, Variables
from commonlaw.library.trigonometric import Trigonometric


def parse_term(text: str, variables: Variables) -> AbstractTerm:
    """Return the term that an expression stands for; the inverse of ``term.expression(variables.names)``.

    Products and whole powers are taken apart, so that equal terms compare equal however they are written:
    ``v*x*x`` is the monomial ``x^2 v``, ``sin(2*x)`` a sine, ``v*abs(v)`` the product of v and the expression
    ``abs(v)``. A name that is not a plain word stands between backticks.

    Parameters
    ----------
    text
        Numbers, variables, ``+ - * /``, ``**`` or ``^`` with a number or constants above, and the functions abs, sqrt,
        exp, log, sin, cos, tan, sinh, cosh, tanh, arctan (or atan) and sign.
    variables
        What the term may be a function of.

    Raises
    ------
    CommonlawError
        If the text is not an expression, names an unknown variable or function, has a numeric factor (a term has no
        coefficient of its own), or is too long or too large.

    Examples
    --------
    >>> variables = Variables(("x", "v"))
    >>> parse_term("v*x^2", variables)
    Monomial(exponents=(2, 1, 0))
    >>> parse_term("sin(2*x)/x", variables).text(variables.names)
    'sin(2 x)/x'
    """
    size = len(variables.names)
    tree = read(text, variables.names, len(variables.constants))
    try:
        return multiply_powers(_powers(tree, size), size)
    except CommonlawError as error:
        raise CommonlawError("term-unusable", term=text[:60], error=error) from None


def parse_terms(texts: Sequence[str], variables: Variables) -> Terms:
    """Return the terms that expressions stand for, see `parse_term`; the last are those of constants."""
    first = len(texts) - len(variables.constants)
    own = (Constant(variables.index(name)) for name in variables.constants)
    return Terms(variables, (*(parse_term(text, variables) for text in texts[:first]), *own))


def _powers(tree: ast.expr, size: int) -> Counter[AbstractTerm]:
    """Return the terms, with their powers, whose product a tree is."""
    number = constant(tree)
    if number == 1:
        return Counter()
    if number is not None:
        raise CommonlawError("term-with-factor", factor=write(tree))
    match tree:
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _powers(operand, size)
        case ast.UnaryOp():
            raise CommonlawError("term-with-factor", factor="minus sign")
        case ast.Name(id=name):
            return Counter({variable(int(name[1:]), size): 1})
        case ast.BinOp(op=ast.Mult() | ast.Div() as op, left=left, right=right):
            sign = 1 if isinstance(op, ast.Mult) else -1
            powers = _powers(left, size)
            for term, power in _powers(right, size).items():
                powers[term] += sign * power
            return powers
        case ast.BinOp(op=ast.Pow(), left=base, right=exponent) if (times := constant(exponent)) is not None:
            if times.is_integer():
                return Counter({term: int(times) * power for term, power in _powers(base, size).items()})
        case ast.Call(func=ast.Name(id="sin" | "cos" as function), args=[argument]):
            multiple = _multiple(argument)
            if multiple is not None:
                frequency, column = multiple
                return Counter({Trigonometric("sin" if function == "sin" else "cos", frequency, column): 1})
    return Counter({Expression(write(tree)): 1})


def _multiple(tree: ast.expr) -> tuple[float, int] | None:
    """Return the positive number and the column of a multiple of a variable, nothing for anything else."""
    match tree:
        case ast.Name(id=name):
            return 1, int(name[1:])
        case (
            ast.BinOp(op=ast.Mult(), left=ast.Constant(value=int() | float() as number), right=ast.Name(id=name))
            | ast.BinOp(op=ast.Mult(), left=ast.Name(id=name), right=ast.Constant(value=int() | float() as number))
        ) if number > 0:
            return int(number) if number == int(number) else number, int(name[1:])
    return None
