"""Terms: products of whole powers of variables and of functions of them, in one form each, and many at once."""

import ast
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Self

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError, unknown
from commonlaw.library.grammar import MAX_POWER, columns_in, constant, factors_in, read, tree_of, with_names, write
from commonlaw.library.notation import expression_latex, powered, quoted, shown_name, sympy_form
from commonlaw.library.program import Program
from commonlaw.library.variables import Variables
from commonlaw.runtime.forking import cached_property

if TYPE_CHECKING:
    import sympy


class Factor(str):
    """A factor of a term: ``v<i>`` for variable i, the sine or cosine of a multiple of one, or any other function.

    Its text is that of `commonlaw.library.grammar.write`.
    """

    __slots__ = ()

    @property
    def column(self) -> int | None:
        """The column, if it is a variable."""
        return int(self[1:]) if self[0] == "v" and self[1:].isdecimal() else None

    @property
    def is_sinusoid(self) -> bool:
        """Whether it is the sine or cosine of a multiple of one variable."""
        return _sinusoid(self) is not None

    @property
    def is_sum(self) -> bool:
        """Whether it is a sum or a difference."""
        tree = tree_of(self)
        return isinstance(tree, ast.BinOp) and isinstance(tree.op, ast.Add | ast.Sub)

    @property
    def order(self) -> tuple[int, int, str]:
        """By what factors of a product are sorted: variables, then sinusoids, then other functions."""
        if self.column is not None:
            return 0, self.column, ""
        if (parts := _sinusoid(self)) is not None:
            function, frequency, column = parts
            return 1, 0, f"{function} {frequency}, {column})"
        return 2, 0, f"{self}'"

    def complexity(self) -> float:
        """Return how many variables and functions it is written with."""
        return 1.0 if self.column is not None else 2.0 if self.is_sinusoid else factors_in(self)

    def text(self, names: Sequence[str]) -> str:
        """Return it as the field writes it."""
        text = self.replace("**", "^")
        return with_names(text.replace("*", " ") if self.is_sinusoid else text, [*map(shown_name, names)])

    def raised(self, text: str, power: int, sign: str) -> str:
        """Return a power of it in a product, given how it is written itself."""
        if self.column is not None:
            return powered(text, power, sign)
        if self.is_sum or (power > 1 and not isinstance(tree_of(self), ast.Call)):
            text = f"({text})"
        return text if power == 1 else f"{text}{sign}{power}"


@dataclass(frozen=True)
class Term:
    """A function of variables that can be multiplied by a coefficient: ``x^2 v``, ``v*abs(v)``, ``x/(1 + x^2)``.

    Variables are columns; names come in as arguments. Equal terms compare equal however they were written.
    `parse_term`, `monomial` and `product` make terms.

    Parameters
    ----------
    powers
        The factors, variables first, with their powers; negative powers divide, and no factor is the constant 1.
    parameter
        The column of a nonlinear parameter, such as K in ``s/(K + s)``, of which the term is the place among the terms
        of a law: its coefficient is the value. By itself it is zero, and has no factors.
    """

    powers: tuple[tuple[Factor, int], ...] = ()
    parameter: int | None = None

    @property
    def numerator(self) -> "Term":
        """What stands above."""
        return Term(tuple((factor, power) for factor, power in self.powers if power > 0))

    @property
    def denominator(self) -> "Term":
        """What it is divided by."""
        return Term(tuple((factor, -power) for factor, power in self.powers if power < 0))

    @property
    def divisors(self) -> "frozenset[Term]":
        """What it is divided by: a monomial, and functions."""
        below = self.denominator.powers
        variables = tuple(pair for pair in below if pair[0].column is not None)
        functions = {Term(((factor, 1),)) for factor, _ in below if factor.column is None}
        return frozenset(functions | ({Term(variables)} if variables else set()))

    @property
    def exponents(self) -> dict[int, int] | None:
        """The powers of variables by their columns, if it is a monomial."""
        if self.parameter is not None or any(factor.column is None or power < 0 for factor, power in self.powers):
            return None
        return {factor.column: power for factor, power in self.powers if factor.column is not None}

    @property
    def is_sum(self) -> bool:
        """Whether it needs parentheses behind a coefficient."""
        return len(self.powers) == 1 and self.powers[0][1] == 1 and self.powers[0][0].is_sum

    def power(self, exponent: int) -> "Term":
        """Return a whole power of the term."""
        return Term(tuple((factor, power * exponent) for factor, power in self.powers) if exponent else ())

    def columns(self) -> frozenset[int]:
        """Return the columns of the variables that the term depends on."""
        return self._columns

    @cached_property
    def _columns(self) -> frozenset[int]:
        inside = frozenset[int]() if self.parameter is None else frozenset((self.parameter,))
        return inside.union(*(columns_in(factor) for factor, _ in self.powers))

    def complexity(self) -> float:
        """Return how many variables and functions it is written with: 3 for ``x^2 v``, 2 for ``sin(2 x)``."""
        return sum(factor.complexity() * abs(power) for factor, power in self.powers)

    def evaluate(self, values: Floats) -> Floats:
        """Return values, shape (n,), at rows of variables, shape (n, variables); infinite or NaN where undefined."""
        return Program.of((self._product,), values.shape[1]).evaluate(values)[:, 0]

    def gradient(self, values: Floats) -> Floats:
        """Return the exact partial derivatives by every variable, shape (n, number of variables)."""
        return Program.of((self._product,), values.shape[1]).jacobian(values)[:, 0]

    @property
    def _product(self) -> tuple[tuple[str, int], ...] | None:
        return None if self.parameter is not None else self.powers

    def text(self, names: Sequence[str]) -> str:
        """Return the term as the field writes it: ``x^2 v``, ``sin(2 x)``, ``v*abs(v)``."""
        if self.parameter is not None:
            return names[self.parameter]
        spaced = all(factor.column is not None or factor.is_sinusoid for factor, power in self.powers if power > 0)
        return self._written([factor.text(names) for factor, _ in self.powers], "^", " " if spaced else "*")

    def expression(self, names: Sequence[str]) -> str:
        """Return the term as an expression that `parse_term` reads back: ``x**2*v``."""
        return with_names(self.code, [quoted(name) for name in names])

    @cached_property
    def code(self) -> str:
        """The expression over ``v0``, ``v1``, ..., as the grammar writes it."""
        if self.parameter is not None:
            return f"v{self.parameter}"
        return self._written([str(factor) for factor, _ in self.powers], "**", "*")

    def _written(self, texts: Sequence[str], sign: str, separator: str) -> str:
        """Return the product, given the texts of its factors, the sign of powers, and what stands between factors."""
        if len(texts) == 1 and self.powers[0][1] == 1:
            return texts[0]
        above, below = (
            [
                factor.raised(text, side * power, sign)
                for text, (factor, power) in zip(texts, self.powers, strict=True)
                if side * power > 0
            ]
            for side in (1, -1)
        )
        numerator = separator.join(above) or "1"
        if not below:
            return numerator
        return f"{numerator}/{below[0]}" if len(below) == 1 else f"{numerator}/({separator.join(below)})"

    def latex(self, names: Sequence[str]) -> str:
        """Return the term as LaTeX, without dollar signs."""
        return expression_latex(self.code, names)

    def sympy(self, symbols: Sequence["sympy.Symbol"]) -> "sympy.Expr":
        """Return the term as a SymPy expression in symbols, one for each variable.

        They should be real, so that the derivative of ``abs(x)`` is the sign of x. Raises `CommonlawError` if SymPy is
        not installed, or variables cancel and leave a huge number, as in ``exp((x - x + 9)**99)``.
        """
        return sympy_form(self.code, symbols)


def monomial(exponents: Mapping[int, int]) -> Term:
    """Return the product of powers of variables, by their columns."""
    return Term(tuple((Factor(f"v{i}"), power) for i, power in sorted(exponents.items()) if power))


def sinusoid(function: str, frequency: float, column: int) -> Term:
    """Return the sine or cosine (``"sin"``, ``"cos"``) of a multiple of a variable."""
    inside = f"v{column}" if frequency == 1 else f"{frequency}*v{column}"
    return Term(((Factor(f"{function}({inside})"), 1),))


def product(*terms: Term) -> Term:
    """Return the product of terms, cancelled; raises `CommonlawError` if powers are too high."""
    powers = Counter[Factor]()
    for term in terms:
        for factor, power in term.powers:
            powers[factor] += power
    if sum(map(abs, powers.values())) > MAX_POWER:
        raise CommonlawError("term-powers-too-high", limit=MAX_POWER)
    ordered = sorted((factor for factor, power in powers.items() if power), key=lambda factor: factor.order)
    return Term(tuple((factor, powers[factor]) for factor in ordered))


def parse_term(text: str, variables: Variables) -> Term:
    """Return the term that an expression stands for; the inverse of ``term.expression(variables.names)``.

    Products and whole powers are taken apart, so that equal terms compare equal however they are written. Expressions
    have numbers, variables (between backticks unless they are plain words), ``+ - * /``, ``**`` or ``^`` with a number
    or parameters above, and the functions abs, sqrt, cbrt, exp, log (or ln), log10, log2, sin, cos, tan, cot, sec, csc,
    arcsin (or asin), arccos, arctan, arctan2(y, x), the same of hyperbolas (sinh, ..., arctanh), sign, step (or
    heaviside), erf, erfc, floor, ceil and mod(x, y), which is x - y floor(x/y). Inside of floor, ceil and mod stand no
    parameters. Comparisons, ``x > 1``, where(x > 1, a, b), max and min are read as expressions of step.

    Raises `CommonlawError` if the text is not an expression, has an unknown name or a numeric factor (terms have no
    coefficients of their own), or is too long or too large.

    Examples
    --------
    >>> variables = Variables(("x", "v"))
    >>> parse_term("v*x*x", variables) == parse_term("x^2*v", variables)
    True
    >>> parse_term("sin(2*x)/x", variables).text(variables.names)
    'sin(2 x)/x'
    """
    tree = read(text, variables.names, len(variables.parameters), variables.arities)
    try:
        return _term(tree)
    except CommonlawError as error:
        raise CommonlawError("term-unusable", term=text[:60], error=error) from None


def _term(tree: ast.expr) -> Term:
    number = constant(tree)
    if number == 1:
        return Term()
    if number is not None:
        raise CommonlawError("term-with-factor", factor=write(tree))
    match tree:
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _term(operand)
        case ast.UnaryOp():
            raise CommonlawError("term-with-factor", factor="minus sign")
        case ast.BinOp(op=ast.Mult() | ast.Div() as op, left=left, right=right):
            return product(_term(left), _term(right).power(1 if isinstance(op, ast.Mult) else -1))
        case ast.BinOp(op=ast.Pow(), left=base, right=exponent) if (power := constant(exponent)) is not None:
            if power.is_integer():
                return product(_term(base).power(int(power)))
    factor = Factor(write(tree))
    parts = _sinusoid(factor)
    return Term(((factor, 1),)) if parts is None else sinusoid(*parts)


@lru_cache(maxsize=4096)
def _sinusoid(code: str) -> tuple[str, float, int] | None:
    """Return the function, the positive frequency and the column of the sine or cosine of a multiple of a variable."""
    match tree_of(code):
        case ast.Call(func=ast.Name(id="sin" | "cos" as function), args=[ast.Name(id=name)]):
            return function, 1, int(name[1:])
        case ast.Call(
            func=ast.Name(id="sin" | "cos" as function),
            args=[
                ast.BinOp(op=ast.Mult(), left=ast.Constant(value=int() | float() as number), right=ast.Name(id=name))
                | ast.BinOp(op=ast.Mult(), left=ast.Name(id=name), right=ast.Constant(value=int() | float() as number))
            ],
        ) if number > 0:
            return function, int(number) if number == int(number) else number, int(name[1:])
    return None


class Fraction(str):
    """The name of a term with a coefficient, ``s/(K + s)``, with numerator, denominator, and how they are joined."""

    __slots__ = ("above", "below", "form")

    above: str
    below: str
    form: str

    def __new__(cls, whole: str, above: str, below: str, form: str) -> Self:
        result = super().__new__(cls, whole)
        result.above, result.below, result.form = above, below, form
        return result

    def __reduce__(self) -> tuple[object, ...]:
        return Fraction, (str(self), self.above, self.below, self.form)

    def over(self, above: str) -> str:
        """Return the fraction of another numerator, ``(a s + b s^2)/(K + s)``."""
        return self.form.format(above, self.below)

    def behind(self, number: str, times: str) -> str:
        """Return it behind a coefficient: ``a s/(K + s)``, ``a/(K + s)``."""
        if self.startswith("1/"):
            return f"{number}{self[1:]}"
        return f"{number}{times}{self}"


@dataclass(frozen=True)
class Terms:
    """Terms over named variables, evaluated together."""

    variables: Variables
    terms: tuple[Term, ...]

    def __len__(self) -> int:
        return len(self.terms)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The terms as the field writes them: ``("1", "x", "x^2 v")``."""
        return tuple(term.text(self.variables.names) for term in self.terms)

    @cached_property
    def factors(self) -> tuple[str, ...]:
        """The same as factors of a product, sums in parentheses."""
        return self.factors_over(self.variables.names)

    def factors_over(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return them over other names of the variables, or numbers in place of parameters."""
        return self._factors(lambda term: term.text(names), "({})", "({})/({})")

    def latex_factors(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return them as LaTeX."""
        return self._factors(lambda term: term.latex(names), r"\left({}\right)", r"\frac{{{}}}{{{}}}")

    def _factors(self, write: Callable[[Term], str], brackets: str, form: str) -> tuple[str, ...]:
        measured, result = len(self.variables.measured), list[str]()
        for term in self.terms:
            text, above, below = write(term), term.numerator, term.denominator
            if max(below.columns(), default=0) < measured:
                result.append(brackets.format(text) if term.is_sum else text)
            else:  # Divided by something with parameters
                over = f"({write(above)})" if above.is_sum else write(above)
                result.append(Fraction(text, over, write(below), form))
        return tuple(result)

    @cached_property
    def complexities(self) -> Floats:
        """The complexity of each term, shape (terms,); shared divisors with parameters count once."""
        first, seen, result = len(self.variables.measured), set[Term](), list[float]()
        for term in self.terms:
            below = {divisor for divisor in term.divisors if any(column >= first for column in divisor.columns())}
            result.append(term.complexity() - sum(divisor.complexity() for divisor in below & seen))
            seen |= below
        return np.array(result)

    @cached_property
    def program(self) -> Program:
        """The terms as a program of single operations."""
        products = [term.powers if term.parameter is None else None for term in self.terms]
        return Program.of(products, len(self.variables.names), self.variables.functions)

    @cached_property
    def parameters(self) -> tuple[int, ...]:
        """The index of each parameter's own term, see `Term`; raises `CommonlawError` if these are not the last."""
        expected = tuple(Term(parameter=self.variables.index(name)) for name in self.variables.parameters)
        first = len(self.terms) - len(expected)
        if self.terms[max(first, 0) :] != expected:
            names = ", ".join(self.variables.parameters)
            raise CommonlawError("parameter-names", names=names)
        return tuple(range(first, len(self.terms)))

    def parameter_name(self, index: int) -> str | None:
        """Return the name of the constant that a term, by its index, is the place of, if it is one."""
        return self.variables.parameters[self.parameters.index(index)] if index in self.parameters else None

    @cached_property
    def is_factor(self) -> Bools:
        """Which terms are multiplied by their coefficients, shape (terms,): all but those of parameters."""
        result = np.ones(len(self.terms), dtype=np.bool_)
        result[list(self.parameters)] = False
        return result

    @cached_property
    def have_parameters(self) -> tuple[bool, ...]:
        """Which terms have parameters inside."""
        first = len(self.variables.measured)
        return tuple(any(column >= first for column in term.columns()) for term in self.terms)

    def at(self, values: Floats, coefficients: Floats) -> Floats:
        """Return values of measured variables, shape (n, variables), followed by parameters from the coefficients."""
        if not self.parameters:
            return values
        measured = values.shape[1]
        result = np.empty((len(values), measured + len(self.parameters)))
        result[:, :measured], result[:, measured:] = values, coefficients[:, list(self.parameters)].sum(axis=0)
        return result

    def index(self, name: str) -> int:
        """Return the index of the term of that name, without spaces or with stars: ``x^2 v`` is also ``x**2*v``.

        Raises `CommonlawError` if there is no such term.
        """
        if name in self.names:
            return self.names.index(name)
        folded = [_folded(term_name) for term_name in self.names]
        if _folded(name) not in folded:
            raise unknown("term", name, self.names)
        return folded.index(_folded(name))

    def take(self, indices: Sequence[int]) -> "Terms":
        """Return the terms at these indices; all of them, in order, share their program."""
        if tuple(indices) == tuple(range(len(self))):
            return self
        return Terms(self.variables, tuple(self.terms[i] for i in indices))

    def evaluate(self, values: Floats, out: Floats | None = None) -> Floats:
        """Return the matrix of terms, shape (n, terms), in Fortran order, at rows of `values`; `out` is filled if
        given.

        A value does not depend on which other terms there are, to the last bit.
        """
        return self.program.evaluate(values, out)

    def jacobian(self, values: Floats) -> Floats:
        """Return the exact derivatives of every term by every variable, shape (n, terms, variables)."""
        return self.program.jacobian(values)

    def check_finite(self, matrix: Floats, values: Floats, where: str = "", before: int = 0) -> None:
        """Refuse a matrix of terms, shape (n, terms), at values of the variables, that is not finite.

        The `CommonlawError` names the term, the values, the sample, counted from those `before`, and `where`: a trial.
        """
        # The sum is finite when every entry is, and costs no temporary matrix.
        with np.errstate(all="ignore"):
            if np.isfinite(matrix.sum()) or np.isfinite(matrix).all():
                return
        row, column = np.argwhere(~np.isfinite(matrix))[0]
        state = "not a number" if np.isnan(matrix[row, column]) else "infinite"
        used = sorted(self.terms[column].columns())
        point = ", ".join(f"{self.variables.names[i]} = {values[row, i]:g}" for i in used)
        raise CommonlawError(
            "term-not-finite",
            where,
            term=self.names[column],
            value=state,
            sample=before + row + 1,
            point=point,
            variable=self.variables.names[used[0]],
        )


def parse_terms(texts: Sequence[str], variables: Variables) -> Terms:
    """Return the terms that expressions stand for, see `parse_term`; the last are those of parameters."""
    first = len(texts) - len(variables.parameters)
    of_parameters = (Term(parameter=variables.index(name)) for name in variables.parameters)
    return Terms(variables, (*(parse_term(text, variables) for text in texts[:first]), *of_parameters))


def _folded(name: str) -> str:
    return name.replace("**", "^").replace("*", "").replace(" ", "")
