"""Equations as people write them: ``T' = a + b T``, ``x'' = -9.81 - c v``, ``x[k+1] = r x (1 - x)``."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NoReturn

from commonlaw.errors import CommonlawError, unknown
from commonlaw.library.grammar import DEEPEST, FUNCTIONS, LONGEST, OTHER_NAMES, constant, read
from commonlaw.library.naming import quoted
from commonlaw.library.parse import parse_term
from commonlaw.library.term import AbstractTerm
from commonlaw.library.terms import Variables

_NAME = r"`(?:[^`]|``)+`|[^\W\d]\w*"
_LEFT = re.compile(
    rf"(?P<primed>{_NAME})\s*(?P<primes>'+)|(?P<next>{_NAME})\s*\[\s*[kn]\s*\+\s*1\s*\]"
    rf"|d\s*(?P<first>{_NAME})\s*/\s*d\s*\w+|d\s*\^?\s*2\s*(?P<second>{_NAME})\s*/\s*d\s*[^\W\d]+\s*\^?\s*2"
)
_TOKEN = re.compile(
    rf"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>{_NAME})(?P<mark>'|\[[kn]\])?"
    r"|(?P<sign>\*\*|[-+*/^()])|(?P<bad>\S))"
)
_LETTER = re.compile(r"[^\W\d_](?:_?\w)?")
"""What is a coefficient before a parenthesis, and not the name of a function."""


@dataclass(frozen=True)
class Summand:
    """One summand of an equation: a factor, the coefficient that is to be found (None if the factor is all), a term.

    The coefficient is a factor or, with a power of -1, a divisor.
    """

    factor: float
    coefficient: str | None
    term: AbstractTerm
    power: int = 1


@dataclass(frozen=True)
class Equation:
    """The text of one equation, of which the left-hand side is read: the order of the derivative of a state."""

    text: str
    state: str
    order: int
    right: int
    """Where the right-hand side begins."""

    def summands(self, variables: Variables, state_rates: Sequence[tuple[str, str]] = ()) -> tuple[Summand, ...]:
        """Return the summands of the right-hand side.

        Parameters
        ----------
        variables
            What terms are functions of; other names are coefficients, which stand as factors before terms.
        state_rates
            The names of states, and of their rates among the variables: ``x'`` is the rate of x.

        Raises
        ------
        CommonlawError
            If the text cannot be read; the message says at which character, and lists the variables.
        """
        return _Reader(self, variables, dict(state_rates)).summands()


@dataclass(frozen=True)
class _Token:
    """A token with its place in the text; its kind is number, name, function, or the sign itself."""

    kind: str
    text: str
    place: int


def split_equations(texts: str | Sequence[str]) -> tuple[Equation, ...]:
    """Return the equations in a text, between semicolons or lines, or in several texts.

    Left-hand sides are ``T'``, ``T''``, ``dT/dt``, ``d2T/dt2`` or ``T[k+1]``.

    Raises
    ------
    CommonlawError
        If a left-hand side cannot be read, orders differ, or a state has two equations.

    Examples
    --------
    >>> [(each.state, each.order) for each in split_equations("H' = a H - b H P; dP/dt = c H P - d P")]
    [('H', 1), ('P', 1)]
    """
    parts = [texts] if isinstance(texts, str) else texts
    found = tuple(_left(each.strip()) for part in parts for each in re.split(r"[;\n]", part) if each.strip())
    if not found:
        raise CommonlawError('there is no equation: write one like "T\' = a + b T"')
    for each in found:
        if each.order != found[0].order:
            raise CommonlawError(f"{found[0].text!r} and {each.text!r} are of different orders: give one order to all")
        if [other.state for other in found].count(each.state) > 1:
            raise CommonlawError(f"{each.state} has two equations: give each state one")
    return found


def _left(text: str) -> Equation:
    left, sign, _ = text.partition("=")
    match = _LEFT.fullmatch(left.strip())
    if not sign or match is None or len(match["primes"] or "") > 2:
        raise CommonlawError(
            f'cannot read {text!r}: an equation begins with "T\' =", "T\'\' =", "dT/dt =", "d2T/dt2 =" or "T[k+1] =", '
            "and a name that is no plain word stands between backticks"
        )
    order = len(match["primes"] or "") or {"next": 0, "first": 1, "second": 2}[str(match.lastgroup)]
    name = next(match[each] for each in ("primed", "next", "first", "second") if match[each])
    return Equation(text, _unquoted(name), order, len(left) + 1)


class _Reader:
    """Reads one right-hand side from left to right."""

    def __init__(self, equation: Equation, variables: Variables, rates: dict[str, str]) -> None:
        self.equation, self.variables, self.rates = equation, variables, rates
        self.tokens = [*self._tokens(), _Token("end", "", len(equation.text))]
        self.index = 0
        if len(equation.text) > LONGEST or sum(each.kind == "(" for each in self.tokens) > DEEPEST:
            raise CommonlawError(
                f"cannot read {equation.text[:57]!r}...: an equation has at most {LONGEST} characters and {DEEPEST} "
                "parentheses"
            )

    def summands(self) -> tuple[Summand, ...]:
        found = [self._summand()]
        while self.now.kind != "end":
            if self.now.kind not in "+-":
                self._fail(self.now, "a parenthesis closes that was not opened")
            found.append(self._summand())
        self._check_apart(found)
        return tuple(each for each in found if each.factor)

    @property
    def now(self) -> _Token:
        return self.tokens[self.index]

    def _summand(self) -> Summand:
        """Read signs, then factors as long as there are any."""
        factor, coefficient, parts, start = self._sign(), None, "", self.now
        sign, power = "*", 1
        while True:
            first = self.now
            text = self._power()
            number = constant(read(text, ())) if first.kind == "number" or not self._names(first) else None
            if number is not None:
                if sign == "/" and not number:
                    self._fail(first, "this divides by zero")
                factor = factor * number if sign == "*" else factor / number
            elif self._is_coefficient(first):
                self._check_only(first, coefficient)
                coefficient, power = first.text, 1 if sign == "*" else -1
            else:
                parts += f"{sign if parts else '1/' if sign == '/' else ''}{text}"
            if self.now.kind in ("*", "/"):
                sign = self._next().kind
            elif self._begins_operand(self.now):
                sign = "*"
            else:
                break
        try:
            return Summand(factor, coefficient, parse_term(parts or "1", self.variables), power)
        except CommonlawError as error:
            self._fail(start, str(error))

    def _sign(self) -> float:
        factor = 1.0
        while self.now.kind in ("+", "-"):
            factor *= -1.0 if self._next().kind == "-" else 1.0
        return factor

    def _power(self) -> str:
        """Read an operand with its power, as the grammar of terms writes it."""
        text = self._operand()
        if self.now.kind in ("^", "**"):
            self._next()
            sign = "-" if self._sign() < 0 else ""
            text += f"**{sign}{self._operand()}"
        return text

    def _operand(self) -> str:
        token = self._next()
        if token.kind == "number":
            return token.text
        if token.kind == "function":
            return f"{OTHER_NAMES.get(token.text, token.text)}{self._operand()}"
        if token.kind == "name":
            return quoted(token.text)
        if token.kind != "(":
            what = "it ends" if token.kind == "end" else f"{token.text!r} stands"
            self._fail(token, f"{what} where a number, a name or a parenthesis is expected")
        text = "("
        while True:
            text += ("-" if self._sign() < 0 else "") + self._power()
            if self._begins_operand(self.now):
                text += "*"
            elif self.now.kind == ")":
                self._next()
                return f"{text})"
            elif self.now.kind == "end":
                self._fail(token, "this parenthesis is not closed")
            else:
                text += self._next().kind

    def _next(self) -> _Token:
        self.index += 1
        return self.tokens[self.index - 1]

    def _tokens(self) -> Iterator[_Token]:
        text, place = self.equation.text, self.equation.right
        while match := _TOKEN.match(text, place):
            kind = str(next(each for each in ("number", "name", "sign", "bad") if match[each]))
            token = _Token(kind if kind != "sign" else match["sign"], match[kind], match.start(kind))
            if kind == "bad":
                self._fail(token, f"the character {token.text!r} has no place in an equation")
            if kind == "name":
                token = self._named(token, match["mark"], text[match.end() :])
            yield token
            place = match.end()

    def _named(self, token: _Token, mark: str | None, rest: str) -> _Token:
        """Return a variable, a coefficient or a function by its name, the mark behind it, and what follows."""
        name = _unquoted(token.text)
        if mark == "'":
            if name not in self.rates:
                self._fail(token, f"{name}' is no rate that the right-hand side may hold")
            return _Token("name", self.rates[name], token.place)
        if name in self.variables.names:
            if rest.startswith("("):
                self._fail(token, f"{name} is a variable, not a function: write products with '*', variables alone")
        elif not token.text.startswith("`"):
            if name in (*FUNCTIONS, *OTHER_NAMES):
                if not rest.lstrip().startswith("("):
                    self._fail(token, f"{name} is a function: write {name}(...)")
                return _Token("function", name, token.place)
            if rest.startswith("(") and not _LETTER.fullmatch(name):
                self._fail(token, str(unknown("function", name, FUNCTIONS)))
        return _Token("name", name, token.place)

    def _begins_operand(self, token: _Token) -> bool:
        return token.kind in ("number", "name", "function", "(")

    def _names(self, first: _Token) -> list[_Token]:
        """Return the names from a token on that was just read."""
        return [each for each in self.tokens[self.tokens.index(first) : self.index] if each.kind == "name"]

    def _is_coefficient(self, first: _Token) -> bool:
        """Say whether what was just read, from a token on, is a coefficient; names within a term are variables."""
        others = [each for each in self._names(first) if each.text not in self.variables.names]
        if others and (first.kind != "name" or self.tokens.index(first) + 1 < self.index):
            wrong = others[0]
            problem = unknown("variable", wrong.text, self.variables.names)
            self._fail(wrong, f"{problem}; a coefficient stands as a factor before a term: multiply parentheses out")
        return bool(others)

    def _check_only(self, token: _Token, before: str | None) -> None:
        if before is not None:
            problem = f"{before} and {token.text} are both no variables, and a term has one coefficient"
            self._fail(token, f"{problem}: write one letter for them, or correct the name")

    def _check_apart(self, found: Sequence[Summand]) -> None:
        """Refuse equal terms and equal coefficients: only their sum or nothing could be found."""
        for i, each in enumerate(found):
            for other in found[:i]:
                name = each.term.text(self.variables.names)
                if each.term == other.term:
                    hint = ", and products with '*' or a space" if name == "1" else ""
                    raise CommonlawError(f"{self.equation.text!r} has the term {name} twice: write it once{hint}")

    def _fail(self, token: _Token, problem: str) -> NoReturn:
        where = f"at character {token.place + 1}" + (f", {token.text!r}" if token.text else "")
        known = f"; variables: {', '.join(self.variables.names)}"
        raise CommonlawError(
            f"cannot read {self.equation.text!r} {where}: {problem}{'' if 'Known:' in problem else known}"
        ) from None


def _unquoted(name: str) -> str:
    return name[1:-1].replace("``", "`") if name.startswith("`") else name
