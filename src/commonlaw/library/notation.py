"""How names and expressions are written: in a text, in LaTeX, in SymPy."""

import ast
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from functools import partial
from typing import TYPE_CHECKING, Any

from commonlaw.errors import CommonlawError
from commonlaw.library.grammar import FUNCTIONS, MAX_NUMBER, SHORT_NAMES, Algebra, evaluate
from commonlaw.runtime.packages import optional_import
from commonlaw.text import in_latex

if TYPE_CHECKING:
    import sympy


_WORD = re.compile(r"[^\W\d]\w*")
NAME = rf"`(?:[^`]|``)+`|{_WORD.pattern}"
"""A name in an expression, see `quoted`."""
_GREEK = re.compile(
    "alpha|beta|(var)?epsilon|zeta|eta|iota|kappa|mu|nu|rho|tau|chi|[Gg]amma|[Dd]elta|[Tt]heta|[Ll]ambda|[Xx]i|[Pp]i"
    "|[Ss]igma|[Uu]psilon|(var)?[Pp]hi|[Pp]si|[Oo]mega"
)


def quoted(name: str) -> str:
    """Return the name as an expression holds it: between backticks unless it is a plain word.

    >>> quoted("v_x"), quoted("wind speed")
    ('v_x', '`wind speed`')
    """
    return name if _WORD.fullmatch(name) else "`" + name.replace("`", "``") + "`"


def unquoted(text: str) -> str:
    """Return the name that an expression holds, the inverse of `quoted`.

    >>> unquoted("v_x"), unquoted("`wind speed`")
    ('v_x', 'wind speed')
    """
    return text[1:-1].replace("``", "`") if text.startswith("`") else text


def shown_name(name: str) -> str:
    """Return the name as a law shows it: between backticks if it ends in a prime, which else is a derivative.

    >>> shown_name("wind speed"), shown_name("x'")
    ('wind speed', "`x'`")
    """
    return quoted(name) if name.endswith("'") else name


def powered(name: str, power: int, sign: str = "^") -> str:
    """Return a power of a variable, in parentheses where its name is neither plain nor quoted.

    >>> powered("v", 1), powered("v", 2), powered("dx/dt", 2), powered("`dx/dt`", 2, "**")
    ('v', 'v^2', '(dx/dt)^2', '`dx/dt`**2')
    """
    if power == 1:
        return name
    plain = _WORD.fullmatch(name.rstrip("'")) or name.startswith("`")
    return f"{name}{sign}{power}" if plain else f"({name}){sign}{power}"


def latex_name(name: str) -> str:
    r"""Return the name in LaTeX: Greek letters by their name, what follows a letter's underscore or is a digit below.

    >>> print(latex_name("theta"), latex_name("x1"), latex_name("v_x"), latex_name("height"))
    \theta x_{1} v_{x} \mathrm{height}
    """
    match = re.fullmatch(r"([^\W\d_]+)(?:_?(\d+)|_([^\W_]+))?('*)", name)
    if match is None:
        return rf"\mathrm{{{in_latex(name)}}}"
    stem, number, index, primes = match.groups()
    below = number or (_stem(index) if index else "")
    return _stem(stem) + (f"_{{{below}}}" if below else "") + primes


def _stem(word: str) -> str:
    if _GREEK.fullmatch(word):
        return f"\\{word}"
    return word if len(word) == 1 else rf"\mathrm{{{word}}}"


class _Binding(IntEnum):
    """How strongly the outermost operation of a formula binds: what binds weaker needs parentheses inside."""

    SUM = 1
    PRODUCT = 2
    POWER = 3
    WHOLE = 4


_OPERATORS: Mapping[str, Callable[..., Any]] = {
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "divide": operator.truediv,
    "power": operator.pow,
    "negate": operator.neg,
}
_Formula = tuple[str, _Binding]
_FORMS = {
    "abs": (r"\left|{{{}}}\right|", _Binding.WHOLE),
    "sqrt": (r"\sqrt{{{}}}", _Binding.WHOLE),
    "exp": ("e^{{{}}}", _Binding.POWER),
    "floor": (r"\left\lfloor{{{}}}\right\rfloor", _Binding.WHOLE),
    "ceil": (r"\left\lceil{{{}}}\right\rceil", _Binding.WHOLE),
}
_LATEX_NAMES = {
    **{
        name: f"\\{name}" for name in ("log", "sin", "cos", "tan", "sinh", "cosh", "tanh", "arcsin", "arccos", "arctan")
    },
    "log10": r"\log_{10}",
    "log2": r"\log_{2}",
}
"""Functions that LaTeX has a command for."""


def expression_latex(code: str, names: Sequence[str]) -> str:
    r"""Return what `commonlaw.library.grammar.write` returned as LaTeX, with these names of the variables.

    >>> print(expression_latex("1 + v0**2/abs(v1)", ["x", "theta"]))
    \frac{x^{2}}{\left|{\theta}\right|} + 1
    """
    return _formula(ast.parse(code, mode="eval").body, names)[0]


def _formula(tree: ast.expr, names: Sequence[str]) -> _Formula:
    def inside(part: ast.expr, least: _Binding) -> str:
        latex, binding = _formula(part, names)
        return latex if binding >= least else rf"\left({latex}\right)"

    match tree:
        case ast.Name(id=name):
            return latex_name(names[int(name[1:])]), _Binding.WHOLE
        case ast.Constant(value=int() | float() as number):
            digits, _, power = repr(number).partition("e")
            if not power:
                return digits, _Binding.WHOLE
            return rf"{digits} \cdot 10^{{{int(power)}}}", _Binding.PRODUCT
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _formula(operand, names)
        case ast.UnaryOp(operand=operand):
            return f"-{inside(operand, _Binding.PRODUCT)}", _Binding.SUM
        case ast.BinOp(op=ast.Add(), left=ast.Constant() as number, right=right) if not isinstance(
            right, ast.Constant | ast.UnaryOp
        ):
            return f"{inside(right, _Binding.PRODUCT)} + {inside(number, _Binding.SUM)}", _Binding.SUM
        case ast.BinOp(op=ast.Add() | ast.Sub() as op, left=left, right=right):
            sign = "+" if isinstance(op, ast.Add) else "-"
            return f"{inside(left, _Binding.SUM)} {sign} {inside(right, _Binding.PRODUCT)}", _Binding.SUM
        case ast.BinOp(op=ast.Mult(), left=left, right=right):
            first, second = inside(left, _Binding.PRODUCT), inside(right, _Binding.PRODUCT)
            return first + (r" \cdot " if second[0].isdecimal() else " ") + second, _Binding.PRODUCT
        case ast.BinOp(op=ast.Div(), left=left, right=right):
            return rf"\frac{{{inside(left, _Binding.SUM)}}}{{{inside(right, _Binding.SUM)}}}", _Binding.PRODUCT
        case ast.BinOp(op=ast.Pow(), left=base, right=exponent):
            return f"{inside(base, _Binding.WHOLE)}^{{{inside(exponent, _Binding.SUM)}}}", _Binding.POWER
        case ast.Call(func=ast.Name(id=name), args=arguments):
            inner = ", ".join(inside(argument, _Binding.SUM) for argument in arguments)
            if name in _FORMS:
                form, binding = _FORMS[name]
                return form.format(inner), binding
            function = _LATEX_NAMES.get(name, rf"\operatorname{{{in_latex(name)}}}")
            return function + (rf"\left({inner}\right)" if r"\frac" in inner else f"({inner})"), _Binding.POWER
    raise CommonlawError("not-an-expression", expression=ast.unparse(tree)[:30])


def sympy_form(code: str, symbols: Sequence["sympy.Symbol"]) -> "sympy.Expr":
    """Return what `commonlaw.library.grammar.write` returned as a SymPy expression in symbols, one for each column."""
    sympy = optional_import("sympy", "the SymPy form of a term", "symbolic")
    renamed = {
        "abs": "Abs",
        "step": "Heaviside",
        "ceil": "ceiling",
        **{name: short for short, name in SHORT_NAMES.items()},
    }
    bases = {f"log{base}": partial(_logarithm, sympy, base) for base in (2, 10)}
    functions = {name: _guarded(bases.get(name) or getattr(sympy, renamed.get(name, name))) for name in FUNCTIONS}
    return evaluate(code, symbols, Algebra(sympy.sympify, {**_OPERATORS, **functions}))


def _logarithm(sympy: Any, base: int, argument: Any) -> Any:
    return sympy.log(argument) / sympy.log(base)


def _guarded(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the SymPy function for arguments that it can take without computing for ever."""

    def apply(*arguments: Any) -> Any:
        for argument in arguments:
            number = None if argument.free_symbols else argument.evalf(5)
            if number is not None and not (number.is_finite and abs(number) <= MAX_NUMBER):
                raise CommonlawError("number-in-term", limit=MAX_NUMBER)
        return function(*arguments)

    return apply
