"""Products and quotients of terms, in one form each."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.library.evaluation import slope
from commonlaw.library.expression import Expression
from commonlaw.library.grammar import HIGHEST_POWER
from commonlaw.library.monomial import Monomial
from commonlaw.library.naming import quoted
from commonlaw.library.term import AbstractTerm


@dataclass(frozen=True)
class Product(AbstractTerm):
    """A product of terms, divided by others: ``x sin(x)``, ``v*abs(v)``, ``x/(1 + x^2)``.

    `multiply` and `multiply_powers` make it, in the one form in which equal products compare equal: a monomial first
    if there is one, then sines and cosines, then expressions; what stands above and below is cancelled.

    Parameters
    ----------
    factors
        What is multiplied; a power is written as repeated factors.
    divisors
        What the product is divided by.
    size
        The number of variables.
    """

    factors: tuple[AbstractTerm, ...]
    divisors: tuple[AbstractTerm, ...]
    size: int

    def evaluate(self, values: Floats) -> Floats:
        operation, left, right = self.parts()
        with np.errstate(all="ignore"):
            return np.asarray(operation(left.evaluate(values), right.evaluate(values)))

    def gradient(self, values: Floats) -> Floats:
        operation, left, right = self.parts()
        d_left, d_right = left.gradient(values).T, right.gradient(values).T
        with np.errstate(all="ignore"):
            return slope(operation, left.evaluate(values), right.evaluate(values), d_left, d_right).T

    def parts(self) -> tuple[np.ufunc, AbstractTerm, AbstractTerm]:
        """Return numerator and denominator, or without one the last factor and all before it."""
        if self.divisors:
            return np.divide, _product(self.factors, (), self.size), _product(self.divisors, (), self.size)
        return np.multiply, _product(self.factors[:-1], (), self.size), self.factors[-1]

    def below(self) -> tuple[AbstractTerm, ...]:
        return self.divisors

    def columns(self) -> frozenset[int]:
        return frozenset().union(*(each.columns() for each in (*self.factors, *self.divisors)))

    def complexity(self) -> float:
        return sum(each.complexity() for each in (*self.factors, *self.divisors))

    def text(self, names: Sequence[str]) -> str:
        """Return ``x^2 sin(x)``, ``v*abs(v)``, ``x/(1 + x^2)``."""
        loose = not any(isinstance(each, Expression) for each in self.factors)
        above, below = (_powers(side, names, "^") for side in (self.factors, self.divisors))
        return _fraction(above, below, " " if loose else "*")

    def expression(self, names: Sequence[str]) -> str:
        """Return ``x**2*sin(x)``."""
        above, below = (_powers(side, names, "**") for side in (self.factors, self.divisors))
        return _fraction(above, below, "*")


def multiply(terms: Iterable[AbstractTerm], size: int) -> AbstractTerm:
    """Return the product of terms over `size` variables: a product of monomials is one monomial, and so on."""
    return multiply_powers(Counter(terms), size)


def multiply_powers(powers: Mapping[AbstractTerm, int], size: int) -> AbstractTerm:
    """Return the product of whole powers of terms over `size` variables; a negative power divides."""
    exponents, others = [0] * size, Counter[AbstractTerm]()

    def collect(term: AbstractTerm, power: int) -> None:
        if isinstance(term, Monomial):
            for i, exponent in enumerate(term.exponents):
                exponents[i] += exponent * power
        elif isinstance(term, Product):
            for sign, side in ((1, term.factors), (-1, term.divisors)):
                for each in side:
                    collect(each, sign * power)
        else:
            others[term] += power

    for term, power in powers.items():
        collect(term, power)
    if sum(map(abs, (*exponents, *others.values()))) > HIGHEST_POWER:
        raise CommonlawError("term-powers-too-high", limit=HIGHEST_POWER)
    above, below = (
        _side([max(0, sign * each) for each in exponents], {key: sign * each for key, each in others.items()})
        for sign in (1, -1)
    )
    return _product(above, below, size)


def _side(exponents: Sequence[int], others: Mapping[AbstractTerm, int]) -> tuple[AbstractTerm, ...]:
    """Return the factors of positive power, in their fixed order."""
    ordered = sorted(others, key=lambda each: (isinstance(each, Expression), repr(each)))
    repeated = tuple(each for each in ordered for _ in range(others[each]))
    return (Monomial(tuple(exponents)), *repeated) if any(exponents) else repeated


def _product(factors: tuple[AbstractTerm, ...], divisors: tuple[AbstractTerm, ...], size: int) -> AbstractTerm:
    """Return the product of factors that are in their fixed order; one factor is no product."""
    if divisors or len(factors) > 1:
        return Product(factors, divisors, size)
    return factors[0] if factors else Monomial((0,) * size)


def _powers(factors: Sequence[AbstractTerm], names: Sequence[str], sign: str) -> list[str]:
    """Return the powers of the factors: as texts, or if the sign is that of expressions as those."""
    powers = []
    for term, power in Counter(factors).items():
        if isinstance(term, Monomial):
            powers += term.powers(names if sign == "^" else [quoted(name) for name in names], sign)
        else:
            powers.append(_raised(term, term.text(names) if sign == "^" else term.expression(names), power, sign))
    return powers


def _fraction(above: list[str], below: list[str], separator: str) -> str:
    numerator = separator.join(above) or "1"
    if not below:
        return numerator
    return f"{numerator}/{below[0]}" if len(below) == 1 else f"{numerator}/({separator.join(below)})"


def _raised(term: AbstractTerm, text: str, power: int, sign: str) -> str:
    """Return a power of a factor, in parentheses where they are needed."""
    if isinstance(term, Expression) and term.needs_parentheses(power):
        text = f"({text})"
    return text if power == 1 else f"{text}{sign}{power}"
