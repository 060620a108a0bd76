"""The small language that terms are written in, read without ever running what it says.

A term is made of numbers, names of variables, ``+ - * /``, powers ``**`` or ``^`` with a number or parameters above,
and the `FUNCTION_NAMES`. Names that are not plain words stand between backticks. Law files come from strangers: a text
is read by Python's parser, never by its evaluator, and what is long, deep or huge is refused.
"""

import ast
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, unknown

MAX_CHARACTERS = 1000
MAX_DEPTH = 60
MAX_POWER = 100
MAX_NUMBER = 1e100


def step(x: Any, out: Floats | None = None) -> Any:
    """Return the unit step: 1 above zero, 0 elsewhere."""
    return np.heaviside(x, 0.0, out)


def erf(x: Any, out: Floats | None = None) -> Any:
    """Return the error function."""
    from scipy.special import erf as function

    return function(x, out)


def erfc(x: Any, out: Floats | None = None) -> Any:
    """Return the complementary error function, 1 - erf(x), which keeps its digits for large x."""
    from scipy.special import erfc as function

    return function(x, out)


OPERATIONS: Mapping[str, Callable[..., Any]] = {
    "add": np.add,
    "subtract": np.subtract,
    "multiply": np.multiply,
    "divide": np.divide,
    "power": np.power,
    "arctan2": np.arctan2,
    "negate": np.negative,
    "abs": np.absolute,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "arctan": np.arctan,
    "sign": np.sign,
    "step": step,
    "arcsin": np.arcsin,
    "arccos": np.arccos,
    "arcsinh": np.arcsinh,
    "arccosh": np.arccosh,
    "arctanh": np.arctanh,
    "log10": np.log10,
    "log2": np.log2,
    "erf": erf,
    "erfc": erfc,
    "floor": np.floor,
    "ceil": np.ceil,
}
"""What expressions are made of, in the order of the kernel's operations; those up to arctan2 have two operands."""
FUNCTIONS = (*tuple(OPERATIONS)[7:], "arctan2")
STAIRS = ("floor", "ceil")
"""Functions that jump, and are constant elsewhere, so that no derivative moves a parameter inside."""
_SAME = {"ln": "log", "heaviside": "step"}
SHORT_NAMES = {f"a{name[3:]}": name for name in FUNCTIONS if name.startswith("arc")}
OTHER_NAMES = _SAME | SHORT_NAMES
"""Functions of the same meaning by other names: ``asin`` is ``arcsin``."""
_DERIVED = {
    "cot": ("1/tan({0})", 1),
    "sec": ("1/cos({0})", 1),
    "csc": ("1/sin({0})", 1),
    "coth": ("1/tanh({0})", 1),
    "sech": ("1/cosh({0})", 1),
    "csch": ("1/sinh({0})", 1),
    "cbrt": ("sign({0})*abs({0})**(1/3)", 1),
    "mod": ("({0}) - ({1})*floor(({0})/({1}))", 2),
    "where": ("({0})*({1}) + (1 - ({0}))*({2})", 3),
    "max": ("({1}) + step(({0}) - ({1}))*(({0}) - ({1}))", 2),
    "min": ("({1}) - step(({1}) - ({0}))*(({1}) - ({0}))", 2),
}
"""Functions that are read as expressions of the others, with the number of their arguments."""
SWITCHES = {"where": "where", "max": "max", "maximum": "max", "min": "min", "minimum": "min"}
"""Derived functions whose names are also those of parameters, where they are not called."""
JUMPING = ("step", "heaviside", *STAIRS, "mod", *SWITCHES)
"""Functions that jump or bend where it depends on their arguments."""
FUNCTION_NAMES = (*FUNCTIONS, *OTHER_NAMES, *(name for name in _DERIVED if name not in SWITCHES))
"""Names of functions in texts that mean nothing else."""
_OPERATORS: Mapping[type[ast.AST], str] = {
    ast.Add: "add",
    ast.Sub: "subtract",
    ast.Mult: "multiply",
    ast.Div: "divide",
    ast.Pow: "power",
}
_TOKEN = re.compile(
    r"`(?P<quoted>(?:[^`]|``)+)`|(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
    r"|(?P<function>[^\W\d]\w*)(?=\s*\()|(?P<name>[^\W\d]\w*)|(?P<power>\^)|(?P<sign>[<>]=?|,)"
    r"|(?P<bad>[^\s+\-*/().])"
)
_NAMED = re.compile(r"`(?:[^`]|``)+`|[^\W\d]\w*")
_COLUMN = re.compile(r"(?<![^\W\d])v(\d+)(?![\w(])")


@dataclass(frozen=True)
class Algebra:
    """What an expression is computed in: how a number is written, and the operations by their names."""

    number: Callable[[float], Any]
    operations: Mapping[str, Callable[..., Any]]


NUMPY = Algebra(float, OPERATIONS)
_NUMBERS = Algebra(np.float64, OPERATIONS)


def read(text: str, names: Sequence[str], parameters: int = 0, functions: Mapping[str, int] = {}) -> ast.expr:
    """Return the tree of an expression, with ``v<i>`` for column i; so many of the last names are parameters.

    `functions` are the numbers of arguments of other functions than `FUNCTION_NAMES` by their names.
    """
    shown = text if len(text) <= 60 else f"{text[:57]}..."
    if (characters := length(text)) > MAX_CHARACTERS:
        raise CommonlawError("term-too-long", term=shown, characters=characters, limit=MAX_CHARACTERS)
    try:
        code = _TOKEN.sub(lambda token: _translated(token, names, functions), text).strip()
        tree: ast.expr = _Expansion().visit(ast.parse(code, mode="eval").body)
        _check(tree, 0, 1, len(names) - parameters, functions)
    except SyntaxError as error:
        index = with_names(code[max(0, (error.offset or 1) - 1) :], names)
        place = f"near {index[:30]!r}" if index else "at its end"
        raise CommonlawError(
            "term-syntax", term=shown, error=CommonlawError("expression-syntax", place=place)
        ) from None
    except CommonlawError as error:
        raise CommonlawError("term-syntax", term=shown, error=error) from None
    except (RecursionError, MemoryError):
        raise CommonlawError("term-too-deep", term=shown) from None
    return tree


def length(text: str) -> int:
    """Return the number of characters of an expression, in which a name counts as one.

    >>> length("`wind speed` + 2*height")
    7
    """
    return len(_NAMED.sub("v", text))


def write(tree: ast.expr) -> str:
    """Return the tree as a text over the names ``v<i>``, always the same for the same tree."""
    return re.sub(r" (\*\*|\*|/) ", r"\1", ast.unparse(tree))


def with_names(code: str, names: Sequence[str]) -> str:
    """Return what `write` returned with names in place of ``v<i>``."""
    return _COLUMN.sub(lambda match: names[int(match[1])], code)


def columns_in(expression: str | ast.expr) -> frozenset[int]:
    """Return the columns of the variables in a tree, or in what `write` returned."""
    if isinstance(expression, str):
        return frozenset(int(column) for column in _COLUMN.findall(expression))
    names = (_COLUMN.fullmatch(node.id) for node in ast.walk(expression) if isinstance(node, ast.Name))
    return frozenset(int(match[1]) for match in names if match)


def factors_in(expression: str | ast.AST) -> float:
    """Return how many variables and functions there are in an expression, repeated for powers.

    >>> factors_in("v0*abs(v1)"), factors_in("(1 + v0)**2")
    (3.0, 2.0)
    """
    tree = tree_of(expression) if isinstance(expression, str) else expression
    match tree:
        case ast.Name():
            return 1.0
        case ast.BinOp(op=ast.Pow(), left=base, right=exponent):
            number = constant(exponent)
            if number is not None:
                return factors_in(base) * max(1.0, abs(number))
    return sum((factors_in(part) for part in ast.iter_child_nodes(tree)), 0.0)


@lru_cache(maxsize=4096)
def tree_of(code: str) -> ast.expr:
    """Return the tree of what `write` returned."""
    return ast.parse(code, mode="eval").body


def evaluate(expression: str | ast.expr, variables: Sequence[Any] | Floats, algebra: Algebra = NUMPY) -> Any:
    """Return the value of an expression in an algebra, given its variables by column.

    >>> evaluate("v0*abs(v1)", [2.0, -3.0])
    np.float64(6.0)
    """
    tree = tree_of(expression) if isinstance(expression, str) else expression
    match tree:
        case ast.Name(id=name):
            return variables[int(name[1:])]
        case ast.Constant(value=int() | float() as number):
            return algebra.number(number)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return evaluate(operand, variables, algebra)
        case ast.UnaryOp(operand=operand):
            name, operands = "negate", [operand]
        case ast.BinOp(op=op, left=left, right=right):
            name, operands = _OPERATORS[type(op)], [left, right]
        case ast.Call(func=ast.Name(id=name), args=operands):
            if name not in algebra.operations:
                raise CommonlawError("function-unavailable", function=name)
        case _:
            raise CommonlawError("not-an-expression", expression=ast.unparse(tree)[:30])
    return algebra.operations[name](*(evaluate(operand, variables, algebra) for operand in operands))


def constant(tree: ast.expr) -> float | None:
    """Return the number that a tree without variables is; nothing for any other."""
    if columns_in(tree):
        return None
    try:
        with np.errstate(all="ignore"):
            return float(evaluate(tree, (), _NUMBERS))
    except OverflowError:
        return float("inf")


def _translated(token: re.Match[str], names: Sequence[str], functions: Mapping[str, int]) -> str:
    """Return a token of the language as one of Python, names replaced by columns."""
    text, kind = token[0], token.lastgroup
    if kind == "power":
        return "**"
    if kind == "bad":
        raise CommonlawError("character-unknown", character=text)
    if kind == "function":
        if text in names:
            raise CommonlawError("variable-called", variable=text)
        function = text if text in functions else (OTHER_NAMES | SWITCHES).get(text, text)
        if function not in (*FUNCTIONS, *_DERIVED, *functions):
            raise unknown("function", text, (*FUNCTION_NAMES, *functions))
        return function
    if kind in ("number", "sign"):
        return text
    name = text if kind == "name" else token["quoted"].replace("``", "`")
    if name not in names:
        raise unknown("variable", name, names)
    column = f"v{names.index(name)}"
    return column if kind == "name" else f" {column} "


class _Expansion(ast.NodeTransformer):
    """Puts expressions in place of derived functions and of comparisons.

    ``a > b`` is ``step(a - b)``, one where it holds and zero elsewhere. What is times or plus zero is left out.
    """

    def visit_Call(self, node: ast.Call) -> ast.expr:
        self.generic_visit(node)
        if not isinstance(node.func, ast.Name) or node.func.id not in _DERIVED:
            return node
        name, (_, arguments) = node.func.id, _DERIVED[node.func.id]
        operands = [ast.unparse(operand) for operand in node.args]
        if name in ("max", "min") and len(operands) > 2:
            *first, last = node.args
            return self._call(name, [ast.unparse(self.visit(ast.Call(node.func, first, []))), ast.unparse(last)])
        if name in SWITCHES and len(operands) != arguments:
            raise CommonlawError("switch-arguments", name=name)
        _check_arguments(name, arguments, len(operands))
        return self._call(name, operands)

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        self.generic_visit(node)
        sides = [ast.unparse(side) for side in (node.left, *node.comparators)]
        pairs = [
            (high, low) if isinstance(sign, ast.Gt | ast.GtE) else (low, high)
            for high, sign, low in zip(sides, node.ops, sides[1:], strict=False)
        ]
        steps = (f"step({high})" if low == "0" else f"step(({high}) - ({low}))" for high, low in pairs)
        return _parsed("a condition", "*".join(steps))

    def _call(self, name: str, operands: Sequence[str]) -> ast.expr:
        form = _DERIVED[name][0]
        if name == "where":
            condition = operands[0]
            operands = [condition, _guarded(operands[1], condition), _guarded(operands[2], f"1 - ({condition})")]
            form = "({0})*({1})" if operands[2] == "0" else form
        elif name == "max" and "0" in operands:
            form = "step({0})*({0})" if operands[1] == "0" else "step({1})*({1})"
        return _parsed(name, form.format(*operands))


class _Guard(ast.NodeTransformer):
    """Gives roots, logarithms and powers in a branch a value where the condition of the branch does not hold.

    There what they are of is one: ``sqrt(g)`` is ``sqrt(holds*g + (1 - holds))``, or ``sqrt(max(g, 0))`` if the
    condition is ``g > 0``. A branch that is not taken would be times zero, and no number times zero is no number.
    """

    def __init__(self, holds: str) -> None:
        self.holds, self.positive = holds, ""
        match tree_of(holds):
            case ast.Call(ast.Name("step"), [argument]):
                self.positive = ast.unparse(argument)
            case ast.BinOp(ast.Constant(1), ast.Sub(), ast.Call(ast.Name("step"), [ast.BinOp(low, ast.Sub(), high)])):
                is_zero = isinstance(low, ast.Constant) and low.value == 0
                self.positive = ast.unparse(high if is_zero else ast.BinOp(high, ast.Sub(), low))

    def visit_Call(self, node: ast.Call) -> ast.expr:
        self.generic_visit(node)
        name = ast.unparse(node.func)
        if name in ("sqrt", "log", "log2", "log10", "arccos", "arccosh"):
            node.args = [self._with_value(node.args[0], is_root=name == "sqrt")]
        return node

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        self.generic_visit(node)
        is_whole = isinstance(node.right, ast.Constant) and isinstance(node.right.value, int)
        if isinstance(node.op, ast.Pow) and not is_whole:
            node.left = self._with_value(node.left, is_root=True)
        return node

    def _with_value(self, argument: ast.expr, is_root: bool) -> ast.expr:
        if not columns_in(argument):
            return argument
        inner, holds = ast.unparse(argument), self.holds
        if is_root and inner == self.positive:
            return _parsed("where", f"step({inner})*({inner})")
        return _parsed("where", f"({holds})*({inner}) + (1 - ({holds}))")


def _guarded(branch: str, holds: str) -> str:
    condition = ast.unparse(tree_of(holds))
    return ast.unparse(_Guard(condition).visit(ast.parse(branch, mode="eval").body))


def _parsed(name: str, text: str) -> ast.expr:
    if len(text) > MAX_CHARACTERS:
        raise CommonlawError("function-too-long", function=name, characters=len(text), limit=MAX_CHARACTERS)
    return ast.parse(text, mode="eval").body


def _check_arguments(function: str, arguments: int, given: int) -> None:
    if given != arguments:
        raise CommonlawError("function-arity", function=function, arguments=arguments, given=given)


def _check(tree: ast.expr, depth: int, power: float, variables: int, functions: Mapping[str, int]) -> None:
    """Refuse what the language does not have or what could take for ever."""
    if depth > MAX_DEPTH:
        raise CommonlawError("expression-too-deep", limit=MAX_DEPTH)
    inside: tuple[ast.expr, ...] = ()
    match tree:
        case ast.Constant(value=int() | float()) | ast.Name():
            pass
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
            inside = (operand,)
        case ast.BinOp(op=ast.Pow(), left=base, right=exponent):
            power *= _checked_exponent(exponent, depth, variables, functions)
            inside = (base,)
        case ast.BinOp(op=ast.Div(), right=right) if constant(right) == 0:
            raise CommonlawError("division-by-zero")
        case ast.BinOp(op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div(), left=left, right=right):
            inside = (left, right)
        case ast.Call(func=ast.Name(id=name), args=operands, keywords=[]) if name in FUNCTIONS:
            _check_arguments(name, 2 if name == "arctan2" else 1, len(operands))
            if name in STAIRS and max(columns_in(tree), default=-1) >= variables:
                raise CommonlawError("stairs-of-parameter", function=name)
            inside = tuple(operands)
        case ast.Call(func=ast.Name(id=name), args=operands, keywords=[]) if name in functions:
            if len(operands) != functions[name] or not columns_in(tree):
                raise CommonlawError("function-call", function=name, arguments=functions[name])
            inside = tuple(operands)
        case ast.Tuple(elts=[_, *_]):
            raise CommonlawError("character-unknown", character=",")
        case _:
            raise CommonlawError("expression-forbidden", functions=(*FUNCTION_NAMES, *functions))
    for subtree in inside:
        _check(subtree, depth + 1, power, variables, functions)
    if power > MAX_POWER:
        raise CommonlawError("powers-too-high", limit=MAX_POWER)
    number = constant(tree)
    if number is not None and not abs(number) <= MAX_NUMBER:
        raise CommonlawError("number-too-large", number=ast.unparse(tree)[:30], limit=MAX_NUMBER)


def _checked_exponent(tree: ast.expr, depth: int, variables: int, functions: Mapping[str, int]) -> float:
    """Return the size of an exponent, at least 1."""
    _check(tree, depth + 1, 1, variables, functions)
    exponent = constant(tree)
    if exponent is None and min(columns_in(tree)) >= variables:
        return 1.0
    if exponent is None:
        raise CommonlawError("exponent-not-a-number")
    return max(1.0, abs(exponent))
