"""Equations as people write them: ``T' = a + b T``, ``x'' = -9.81 - c v``, ``x[k+1] = r x (1 - x)``."""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, chain
from typing import NamedTuple, NoReturn

from commonlaw.diagnostics import Diagnostic
from commonlaw.errors import CommonlawError, unknown
from commonlaw.library.bounds import EVENT, is_bound, parts_of
from commonlaw.library.expansion import NotAFactorError, Product, multiplied_out
from commonlaw.library.grammar import (
    FUNCTION_NAMES,
    MAX_CHARACTERS,
    MAX_DEPTH,
    MAX_NUMBER,
    OTHER_NAMES,
    SWITCHES,
    length,
    read,
    with_names,
    write,
)
from commonlaw.library.notation import NAME, expression_latex, quoted, unquoted
from commonlaw.library.term import Term, parse_term
from commonlaw.library.variables import Variables

_SIDES = re.compile(r"(?P<left>(?:`(?:[^`]|``)+`|[^=])*+)=(?P<right>.*)", re.DOTALL)
_LEFT = re.compile(
    rf"(?P<primed>{NAME})\s*(?P<primes>'+)|(?P<next>{NAME})\s*\[\s*[kn]\s*\+\s*1\s*\]"
    rf"|d\s*(?P<first>{NAME})\s*/\s*d\s*\w+|d\s*\^?\s*2\s*(?P<second>{NAME})\s*/\s*d\s*[^\W\d]+\s*\^?\s*2"
)
_TOKEN = re.compile(
    rf"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>{NAME})(?P<mark>'|\[[kn]\])?"
    r"|(?P<sign>\*\*|[<>]=?|[-+*/^(),])|(?P<bad>\S))"
)
DERIVATIVE = re.compile(r"'\s*=|/\s*d\s*\w+\s*=|\]\s*=")
_DELAYED = re.compile(r"\(\s*(?:t|time)\s*-")
_SWITCH = re.compile(rf"[<>]|(?<![\w`])(?:{'|'.join(SWITCHES)})\s*\(")
_OPENED = re.compile(r"\s*\(")
_COMPARISONS = ("<", "<=", ">", ">=")
_LOGIC = ("if", "else", "and", "or", "not", "&", "|", "?")
"""What other languages have in conditions."""
_LETTER = re.compile(r"[^\W\d_](?:_?\w)?")
"""What is a coefficient before a parenthesis, and not the name of a function."""


@dataclass(frozen=True)
class Summand:
    """One summand of an equation: a number, coefficients that are to be found with their powers of 1 or -1, a term."""

    factor: float
    coefficients: tuple[tuple[str, int], ...]
    term: Term


class InsideError(Exception):
    """A name that is no variable stands where no multiplying out makes it a factor; it is the argument."""


class Meanings(NamedTuple):
    """What names mean in equations besides variables and coefficients.

    Other names of variables, names that mean two things, with the reason, and rates by their states: ``x'``.
    """

    others: Mapping[str, str] = {}
    unclear: Mapping[str, Diagnostic] = {}
    rates: Mapping[str, str] = {}


_PLAIN = Meanings()


CONSTANTS = {"pi": math.pi}
"""Numbers that have a name in equations."""

_NOT_FINITE = {"nan", "inf", "infinity"}


@dataclass(frozen=True)
class Equation:
    """The text of one equation, of which the left-hand side is read: the order of the derivative of a state."""

    text: str
    state: str
    order: int
    right: int
    """Where the right-hand side begins."""

    @property
    def right_hand_side(self) -> str:
        """What stands on the right."""
        return self.text[self.right :].strip()

    def summands(self, variables: Variables, meanings: Meanings = _PLAIN) -> tuple[Summand, ...]:
        """Return the summands of the right-hand side: multiplied out, and collected by their coefficients.

        However it is spelled, ``k a - k T`` is ``k (a - T)``, and ``-(p + X) G + 92 p`` is ``-p (G - 92) - X G``. Names
        that are no variables (or nonlinear parameters among them) are coefficients, factors of terms.

        Raises `CommonlawError` if the text cannot be read, with the character, and `InsideError` if another name stands
        inside a term.
        """
        return _Reader(self, variables, meanings).summands()

    def latex(self, variables: Variables, meanings: Meanings = _PLAIN) -> tuple[tuple[bool, str], ...]:
        """Return the summands of the right-hand side in LaTeX, and whether they are subtracted, see `summands`."""
        return _Reader(self, variables, meanings).latex()

    def expression(self, variables: Variables, meanings: Meanings = _PLAIN) -> tuple[str, tuple[str, ...]]:
        """Return the right-hand side over ``v<i>``, and the names that are no variables, whose columns come last."""
        reader = _Reader(self, variables, meanings)
        return reader.expression(), reader.coefficients

    def with_numbers(self, write: Mapping[str, Callable[[bool], tuple[bool, str]]]) -> str:
        """Return the text with numbers in place of coefficients; a number that is negative turns the sign before it.

        `write` has, by the name of a coefficient, what returns whether it is negative and its size, given whether it is
        a factor.

        >>> (one,) = split_equations("x' = a + b x")
        >>> one.with_numbers({"a": lambda _: (False, "3"), "b": lambda _: (True, "2")})
        "x' = 3 - 2 x"
        """
        tokens = list(_TOKEN.finditer(self.text, self.right))
        parts = [[match[0][: -len(match[0].lstrip())], match[0].lstrip()] for match in tokens]
        for i, match in enumerate(tokens):
            name = match["name"]
            if not name or match["mark"] or unquoted(name) not in write:
                continue
            before, after = (tokens[j]["sign"] if 0 <= j < len(tokens) else "" for j in (i - 1, i + 1))
            begins = i == 0 or (i == 1 and before == "-")
            negative, number = write[unquoted(name)](not (begins and after in ("", "+", "-")))
            if negative and after not in ("^", "**") and before in ("+", "-", ""):
                if before:
                    parts[i - 1][1] = "-" if before == "+" else "+" if i > 1 else ""
                else:
                    number = f"-{number}"
            elif negative:
                number = f"(-{number})"
            parts[i][1] = number
        return self.text[: self.right] + "".join(chain.from_iterable(parts))

    def refuse(self, name: str, problem: Diagnostic, variables: Variables, meanings: Meanings) -> NoReturn:
        """Raise the error for a problem with a coefficient, see `summands`."""
        _Reader(self, variables, meanings).refuse(name, problem)

    def check_apart(self, found: Sequence[Summand], variables: Variables, meanings: Meanings) -> None:
        """Refuse equal terms: only the sum of their coefficients could be found."""
        for i, summand in enumerate(found):
            for earlier in found[:i]:
                if summand.term == earlier.term:
                    for names in (summand.coefficients, earlier.coefficients):
                        if len(names) > 1:
                            self.refuse(names[1][0], only_product(names), variables, meanings)
                    name = summand.term.text(variables.names)
                    hint = ", and products with '*' or a space" if name == "1" else ""
                    raise CommonlawError("term-twice", text=self.text, term=name, hint=hint)


@dataclass(frozen=True)
class _Token:
    """A token with its position in the text; its kind is number, name, function, or the sign itself."""

    kind: str
    text: str
    position: int


def split_equations(texts: str | Sequence[str]) -> tuple[Equation, ...]:
    """Return the equations in texts, between semicolons or lines; bounds among them are left out.

    Left-hand sides are ``T'``, ``T''``, ``dT/dt``, ``d2T/dt2`` or ``T[k+1]``. Raises `CommonlawError` if one cannot be
    read, only some are in discrete time, or a state has two equations.

    >>> [(equation.state, equation.order) for equation in split_equations("H' = a H - b H P; dP/dt = c H P - d P")]
    [('H', 1), ('P', 1)]
    """
    result = tuple(_left(part) for part in parts_of(texts) if not is_bound(part))
    if not result:
        raise CommonlawError("no-equation")
    for equation in result:
        if (equation.order == 0) != (result[0].order == 0):
            raise CommonlawError("continuous-and-discrete", first=result[0].text, second=equation.text)
        if [listed.state for listed in result].count(equation.state) > 1:
            raise CommonlawError("two-equations", state=equation.state)
    return result


def with_parameters(variables: Variables, equations: Sequence[Equation], meanings: Meanings = _PLAIN) -> Variables:
    """Return variables with the nonlinear parameters of equations, in the order of the text.

    >>> with_parameters(Variables(("s",)), split_equations("s' = -V s/(K + s)")).parameters
    ('K',)
    """
    while True:
        try:
            for equation in equations:
                equation.summands(variables, meanings)
        except InsideError as error:
            variables = replace(variables, parameters=(*variables.parameters, error.args[0]))
        else:
            return variables


def only_product(coefficients: Sequence[tuple[str, int]]) -> Diagnostic:
    """Return why coefficients that stand before one term only cannot be found."""
    return Diagnostic("product-of-parameters", {"names": [name for name, _ in coefficients]})


def check_length(text: str, parentheses: int = 0) -> None:
    """Refuse an equation of more characters than `MAX_CHARACTERS`, or of more parentheses than `MAX_DEPTH`."""
    if length(text) > MAX_CHARACTERS or parentheses > MAX_DEPTH:
        raise CommonlawError("equation-too-long", text=text[:57], longest=MAX_CHARACTERS, deepest=MAX_DEPTH)


def _left(text: str) -> Equation:
    if EVENT.fullmatch(text):
        raise CommonlawError("equation-with-event", text=text)
    sides = _SIDES.fullmatch(text)
    left_side = sides["left"].strip() if sides else ""
    if re.fullmatch(NAME, left_side):
        raise CommonlawError("observation-equation", text=text, state=left_side)
    match = _LEFT.fullmatch(left_side)
    if sides is None or match is None or len(match["primes"] or "") > 2:
        raise CommonlawError("equation-syntax", text=text)
    order = len(match["primes"] or "") or {"next": 0, "first": 1, "second": 2}[str(match.lastgroup)]
    name = next(match[group] for group in ("primed", "next", "first", "second") if match[group])
    return Equation(text, unquoted(name), order, sides.start("right"))


class _Reader:
    """Reads one right-hand side from left to right."""

    def __init__(self, equation: Equation, variables: Variables, meanings: Meanings) -> None:
        self.equation, self.variables, self.meanings = equation, variables, meanings
        check_length(equation.text)
        self.tokens = [*self._tokens(), _Token("end", "", len(equation.text))]
        names = [token.text for token in self.tokens if token.kind == "name" and token.text not in variables.names]
        self.coefficients = tuple(dict.fromkeys(names))
        self.names = (*variables.names, *self.coefficients)
        self.parameters = len(self.coefficients) + len(variables.parameters)
        check_length(equation.text, sum(token.kind == "(" for token in self.tokens))

    def summands(self) -> tuple[Summand, ...]:
        first = len(self.variables.names)
        # Of how an equation is spelled nothing depends: k*a - k*T is k*(a - T)
        alike = dict[object, tuple[tuple[tuple[int, int], ...], dict[str, float]]]()
        for sign, start, text in self._addends():
            try:
                tree = read(text, self.names, self.parameters, self.variables.arities)
                for product in multiplied_out(tree, first - len(self.variables.parameters), first):
                    powers = tuple(sorted(product.parameters.items()))
                    for column, power in powers:
                        if abs(power) != 1 and column >= first:
                            raise NotAFactorError(column)
                    _, factors = alike.setdefault(powers or len(alike), (powers, {}))
                    multiplied = self._text(product)
                    factors[multiplied] = factors.get(multiplied, 0.0) + sign * product.factor
            except CommonlawError as error:
                self._fail(start, error.diagnostic)
            except NotAFactorError as error:
                raise InsideError(self.names[error.args[0]]) from None
        collected = (self._collected(*group) for group in alike.values())
        return tuple(summand for summand in collected if summand.factor)

    def expression(self) -> str:
        whole = "".join(f"{'-' if factor < 0 else '+'}({text})" for factor, _, text in self._addends())
        try:
            return write(read(whole, self.names, self.parameters, self.variables.arities))
        except CommonlawError as error:
            self._fail(self.tokens[0], error.diagnostic)

    def latex(self) -> tuple[tuple[bool, str], ...]:
        functions = self.variables.arities
        addends = self._addends()
        trees = [(factor < 0, read(text, self.names, self.parameters, functions)) for factor, _, text in addends]
        return tuple((negative, expression_latex(write(tree), self.names)) for negative, tree in trees)

    def refuse(self, name: str, problem: Diagnostic) -> NoReturn:
        self._fail(next(token for token in self.tokens if (token.kind, token.text) == ("name", name)), problem)

    def _addends(self) -> list[tuple[float, _Token, str]]:
        """Return sign, first token and text of each addend, as the grammar of terms writes it: with all signs."""
        result, opened, before = list[tuple[float, _Token, str]](), list[tuple[_Token, bool]](), ""
        factor, start, text = 1.0, self.tokens[0], ""
        depths = accumulate((token.kind == "(") - (token.kind == ")") for token in self.tokens)
        is_condition = any(
            not depth and token.kind in _COMPARISONS for token, depth in zip(self.tokens, depths, strict=True)
        )
        for token in self.tokens:
            is_sign, ends_operand = token.kind in ("+", "-"), before in ("number", "name", ")")
            if token.kind == "," and not (opened and opened[-1][1]):
                self._fail(token, Diagnostic("equation-character", {"character": ","}))
            if token.kind in ("number", "name", "function", "("):
                if before == "/" and token.kind == "number" and not float(token.text):
                    self._fail(token, Diagnostic("equation-divides-by-zero"))
                start = token if not text else start
                text += ("*" if ends_operand else "") + (quoted(token.text) if token.kind == "name" else token.text)
                opened += [(token, before == "function")] if token.kind == "(" else []
            elif is_sign and not text and not is_condition:
                factor *= -1.0 if token.kind == "-" else 1.0
            elif not ends_operand and (token.kind in _COMPARISONS or before in _COMPARISONS) and not is_sign:
                raise CommonlawError("condition-syntax", expression=self.equation.text)
            elif not ends_operand and not is_sign:
                what = "it ends" if token.kind == "end" else f"{token.text!r} stands"
                self._fail(token, Diagnostic("operand-missing", {"what": what}))
            elif token.kind == ")" and not opened:
                self._fail(token, Diagnostic("parenthesis-not-opened"))
            elif token.kind == "end" and opened:
                if any(token.kind == "function" and token.text in SWITCHES for token in self.tokens):
                    raise CommonlawError("condition-syntax", expression=self.equation.text)
                self._fail(opened[-1][0], Diagnostic("parenthesis-not-closed"))
            elif token.kind == "end" or (is_sign and ends_operand and not opened and not is_condition):
                result.append((factor, start, text))
                factor, text = -1.0 if token.kind == "-" else 1.0, ""
            else:
                text += "**" if token.kind == "^" else token.kind
                opened = opened[:-1] if token.kind == ")" else opened
            before = token.kind
        return result

    def _text(self, product: Product) -> str:
        """Return what the number and the parameters of a product multiply."""
        names = [quoted(name) for name in self.names]
        shown = [(with_names(write(tree), names), power) for tree, power in product.trees]
        text = "*".join(f"({factor})" for factor, power in shown if power > 0) or "1"
        return text + "".join(f"/({factor})" for factor, power in shown if power < 0)

    def _collected(self, powers: Sequence[tuple[int, int]], factors: Mapping[str, float]) -> Summand:
        """Return the sum of products with the same powers of coefficients and parameters as one summand."""
        # A number that is added goes last: a*(exp(u) - 1)
        ordered = [
            (text, factor) for text, factor in sorted(factors.items(), key=lambda pair: pair[0] == "1") if factor
        ]
        whole = ordered[0][1] if ordered else 0.0
        text = "".join(_addend(text, factor / whole) for text, factor in ordered).removeprefix("+") or "1"
        first, names = len(self.variables.names), self.names
        inner = "".join(f"{quoted(names[column])}**{power}*" for column, power in powers if column < first)
        outer = tuple((names[column], power) for column, power in powers if column >= first)
        return Summand(whole, outer, parse_term(f"{inner}({text})", self.variables))

    def _tokens(self) -> Iterator[_Token]:
        text, position = self.equation.text, self.equation.right
        while match := _TOKEN.match(text, position):
            kind = str(next(group for group in ("number", "name", "sign", "bad") if match[group]))
            token = _Token(kind if kind != "sign" else match["sign"], match[kind], match.start(kind))
            if (
                token.text in _LOGIC
                and token.text not in self.variables.names
                and _SWITCH.search(text, self.equation.right)
            ):
                raise CommonlawError("condition-syntax", expression=text)
            if kind == "bad":
                self._fail(token, Diagnostic("equation-character", {"character": token.text}))
            if kind == "name":
                token = self._named(token, match["mark"], match.end())
            yield token
            position = match.end()

    def _named(self, token: _Token, mark: str | None, end: int) -> _Token:
        """Return a variable, a coefficient or a function by its name, the mark behind it, and where that ends."""
        name, text = unquoted(token.text), self.equation.text
        is_called = _OPENED.match(text, end)
        if name in self.meanings.unclear and name == token.text and not mark:
            self._fail(token, self.meanings.unclear[name])
        if mark == "'":
            if name not in self.meanings.rates:
                self._fail(token, Diagnostic("rate-unknown", {"name": name}))
            return _Token("name", self.meanings.rates[name], token.position)
        if name in self.variables.names:
            if _DELAYED.match(text, end):
                self._fail(token, Diagnostic("equation-with-delay", {"name": name}))
            if text.startswith("(", end):
                self._fail(token, Diagnostic("equation-calls-variable", {"name": name}))
        elif not token.text.startswith("`"):
            if name in self.variables.arities and is_called:
                return _Token("function", name, token.position)
            if name in SWITCHES and is_called:
                return _Token("function", SWITCHES[name], token.position)
            if name in FUNCTION_NAMES:
                if not is_called:
                    self._fail(token, Diagnostic("function-not-called", {"name": name}))
                return _Token("function", OTHER_NAMES.get(name, name), token.position)
            if name in self.meanings.others:
                return _Token("name", self.meanings.others[name], token.position)
            if name.lower() in _NOT_FINITE:
                self._fail(token, Diagnostic("number-too-large", {"number": name, "limit": MAX_NUMBER}))
            if name in CONSTANTS:
                return _Token("number", repr(CONSTANTS[name]), token.position)
            if text.startswith("(", end) and not _LETTER.fullmatch(name):
                self._fail(token, unknown("function", name, (*FUNCTION_NAMES, *self.variables.arities)).diagnostic)
        return _Token("name", name, token.position)

    def _fail(self, token: _Token, problem: Diagnostic) -> NoReturn:
        text = self.equation.text
        place = f"at character {token.position + 1}" + (f", {token.text!r}" if token.text else "")
        if "unknown-name" in problem.codes:
            raise CommonlawError("equation-unreadable", text=text, place=place, problem=problem) from None
        known = self.variables.measured
        raise CommonlawError(
            "equation-unreadable-with-variables", text=text, place=place, problem=problem, variables=known
        ) from None


def _addend(text: str, factor: float) -> str:
    """Return a product as it stands in a sum, with its sign."""
    size = repr(abs(factor)).removesuffix(".0")
    return ("-" if factor < 0 else "+") + (text if size == "1" else size if text == "1" else f"{size}*{text}")
