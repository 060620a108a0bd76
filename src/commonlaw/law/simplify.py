"""The simplest form of a law: numbers become whole, ratios of small whole numbers, or each other, within errors."""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.law.law import Law, shares_terms
from commonlaw.law.parameters import left_hand_sides, named_parameters
from commonlaw.law.parse import read_equations
from commonlaw.law.simplification import Replacement, Simplification, p_value
from commonlaw.law.text import rounded
from commonlaw.law.uncertainty import Uncertainty
from commonlaw.library.equation import split_equations
from commonlaw.library.notation import quoted
from commonlaw.runtime.packages import optional_import

if TYPE_CHECKING:
    import sympy


def symbolic() -> Any:
    """Return SymPy, or refuse where it is not installed."""
    return optional_import("sympy", "the simplest form of a law", "symbolic")


def symbol(name: str) -> "sympy.Symbol":
    """Return the symbol of a variable, a parameter inside terms or a letter."""
    return symbolic().Symbol(quoted(name), real=True)


def right_hand_sides(law: Law) -> "list[sympy.Expr]":
    """Return what the equations give, with symbols for letters."""
    sympy, columns = symbolic(), [symbol(name) for name in law.terms.variables.names]
    products = {(each.equation, each.term): each for each in named_parameters(law).products}
    found = []
    for j, k in np.argwhere(law.support & law.terms.is_factor).tolist():
        product = products.get((j, k))
        factors = [symbol(name) ** power for name, power in product.coefficients] if product else []
        number = product.factor if product else float(law.coefficients[0, j, k])
        found.append((j, sympy.Mul(_exact(number), *factors, law.terms.terms[k].sympy(columns))))
    return [sympy.Add(*(each for i, each in found if i == j)) for j in range(len(law.schema.states))]


def shortest(law: Law, right_hand_sides: "Sequence[sympy.Expr]") -> tuple[str, ...]:
    """Return each equation in the equivalent form of fewest operations if `commonlaw.fit` reads it, else as a sum."""
    sympy = symbolic()
    forms = (sympy.factor, sympy.factor_terms, sympy.together, sympy.collect_const, sympy.simplify)
    plain, short = list[str](), list[str]()
    for left, right in zip(left_hand_sides(law), right_hand_sides, strict=True):
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


@dataclass(frozen=True, eq=False)
class ShorterLaw:
    """A law with one number less, what took its place, and the squared distance of estimates from it."""

    law: Law
    replaced: Replacement
    chi_square: float

    def added_to(self, found: Simplification[Law]) -> Simplification[Law]:
        """Return what this law was simplified to, with what was replaced before."""
        return replace(
            found,
            replaced=(self.replaced, *found.replaced),
            chi_square=found.chi_square + self.chi_square,
            degrees_of_freedom=found.degrees_of_freedom + len(self.law.objects),
        )


def without_vanishing_part(law: Law, values: Floats, covariances: Floats, tolerance: float) -> ShorterLaw | None:
    """Return a law without a part of a fraction that vanishes within so many standard errors; none if no part does.

    Values, shape (objects, letters), and covariances are of each object by its own trials.
    """
    if not law.terms.variables.parameters:
        return None
    rights, least = right_hand_sides(law), p_value(tolerance**2, 1)
    near = [
        each
        for each in _parts(law, rights)
        if p_value(each.chi_square(law, values, covariances), len(law.objects)) >= least
    ]
    if not near:
        return None
    part = min(near, key=lambda each: each.solved(rights).count_ops())
    rights[part.equation] = part.solved(rights)
    return ShorterLaw(
        _without(law, part, shortest(law, rights), *part.constrained(law, values, covariances)),
        part.replacement(law, values, covariances),
        part.chi_square(law, values, covariances),
    )


class _Part(NamedTuple):
    """What stands before products of variables in a numerator, and a letter that it vanishes for if it is `instead`."""

    equation: int
    value: "sympy.Expr"
    letter: str
    instead: "sympy.Expr"

    def solved(self, right_hand_sides: "Sequence[sympy.Expr]") -> "sympy.Expr":
        """Return its equation, if it is zero."""
        found = right_hand_sides[self.equation].subs(symbol(self.letter), self.instead)
        return symbolic().factor(found)

    def along(self, law: Law, values: Floats) -> tuple[Floats, Floats]:
        """Return the value of each object, shape (objects,), and its derivatives, shape (objects, letters)."""
        sympy, symbols = symbolic(), [symbol(name) for name in named_parameters(law).names]
        function = sympy.lambdify(symbols, [self.value, *(self.value.diff(each) for each in symbols)])
        found = np.array([function(*own) for own in values], dtype=np.float64)
        return found[:, 0], found[:, 1:]

    def chi_square(self, law: Law, values: Floats, covariances: Floats) -> float:
        """Return the squared distance of all objects from zero, in units of the variance."""
        own, slopes = self.along(law, values)
        variances = np.einsum("oi,oij,oj->o", slopes, covariances, slopes)
        return float(np.sum(own**2 / variances)) if (variances > 0).all() else np.inf

    def constrained(self, law: Law, values: Floats, covariances: Floats) -> tuple[Floats, Floats]:
        """Return the estimates of largest likelihood where it is zero, with their covariances, to first order."""
        own, slopes = self.along(law, values)
        shared = np.einsum("oij,oj->oi", covariances, slopes)
        variances = np.einsum("oi,oi->o", slopes, shared)
        moved = values - shared * (own / variances)[:, np.newaxis]
        outer = shared[:, :, np.newaxis] * shared[:, np.newaxis, :] / variances[:, np.newaxis, np.newaxis]
        return moved, covariances - outer

    def replacement(self, law: Law, values: Floats, covariances: Floats) -> Replacement:
        """Return what to say of it: means over objects."""
        i, count = named_parameters(law).names.index(self.letter), len(values)
        error = float(np.sqrt(covariances[:, i, i].sum())) / count
        off = float(np.sqrt(self.chi_square(law, values, covariances) / count))
        return Replacement(self.letter, float(values[:, i].mean()), error, written(self.instead), off)


def _parts(law: Law, right_hand_sides: "Sequence[sympy.Expr]") -> Iterator[_Part]:
    """Yield the parts of numerators that are sums, with each letter before a term that they are linear in."""
    sympy, parameters = symbolic(), law.terms.variables.parameters
    measured = [symbol(name) for name in law.terms.variables.measured]
    factors = [symbol(name) for name in named_parameters(law).names if name not in parameters]
    for j, right in enumerate(right_hand_sides):
        above, below = sympy.fraction(sympy.together(right))
        if not below.has(*map(symbol, parameters)):
            continue
        try:
            parts = sympy.Poly(sympy.expand(above), *measured).coeffs()
        except sympy.PolynomialError:
            continue
        for part in (each for each in parts if each.is_Add):
            for letter in factors:
                if part.has(letter) and not part.diff(letter).has(letter):
                    rest = part.subs(letter, 0)
                    yield _Part(j, part, _name(law, letter), sympy.factor(-rest / part.diff(letter)))


def _name(law: Law, wanted: "sympy.Symbol") -> str:
    return next(each for each in named_parameters(law).names if symbol(each) == wanted)


def _without(law: Law, part: _Part, equations: Sequence[str], values: Floats, covariances: Floats) -> Law:
    """Return the law of equations that lack a letter, with what is known of the others."""
    schema = law.schema
    parameters = named_parameters(law)
    known = {
        name: dict(zip(law.objects, own, strict=True)) for name, own in zip(parameters.names, values.T, strict=True)
    }
    del known[part.letter]
    found = Law.from_text(equations, known, inputs=schema.inputs, time=schema.time, units=schema.units)
    indices = {index: i for i, index in enumerate(zip(*np.nonzero(found.support), strict=True))}
    slopes = np.zeros((len(law.objects), len(indices), len(parameters.names)))
    own = {name: values[:, i] for i, name in enumerate(parameters.names)}
    for product in named_parameters(found).products:
        for name, power in product.coefficients:
            slope = product.value(own) * power / own[name]
            slopes[:, indices[product.equation, product.term], parameters.names.index(name)] = slope
    covariance = slopes @ covariances @ slopes.transpose(0, 2, 1)
    return replace(found, uncertainty=Uncertainty(covariance=covariance, noise=law.uncertainty.noise))


_LARGEST_DENOMINATOR = 12

_TOLERANCE = 2.0
"""Standard errors: one in twenty numbers that are simple is not shown as such."""

_BIT = 2 * np.log(2)
"""What a bit is worth in squared standard errors."""


def simplified(law: Law, tolerance: float) -> Simplification[Law]:
    """Return the simplest form of a law, see `Law.simplify`."""
    if not tolerance > 0:
        raise CommonlawError("simplify-tolerance", tolerance=tolerance)
    if not shares_terms(law):
        raise CommonlawError("simplify-own-terms")
    start = _Estimates.of(law)
    if shorter := without_vanishing_part(law, start.values[:-1], start.covariances[:-1], tolerance):
        return shorter.added_to(simplified(shorter.law, tolerance))
    constraints, found = _constrained(law, start, tolerance)
    chi_square, degrees = start.chi_square(constraints)
    gone = {each.letter for each in constraints}
    parameters = named_parameters(law)
    left = [i for i, name in enumerate(parameters.names) if name not in gone]
    return Simplification(
        equations=_shortest(law, constraints),
        replaced=tuple(each.replacement(parameters.names, start) for each in constraints),
        chi_square=chi_square,
        degrees_of_freedom=degrees,
        objects=law.objects,
        letters=tuple(parameters.names[i] for i in left),
        values=found.values[:-1, left],
        errors=np.sqrt(np.maximum(np.diagonal(found.covariances, axis1=1, axis2=2), 0.0))[:-1, left],
    )


def within_errors(law: Law) -> tuple[str, ...]:
    """Return the equations with letters replaced that are within errors of 1, -1, another letter or its opposite.

    Nothing if no letter is, or estimates of each object by its own trials are unknown. Of one object, the other letters
    are numbers: those of largest likelihood then.
    """
    known = law.uncertainty
    by_own_trials = known.shared_factor is None or known.unpooled is not None
    if not (shares_terms(law) and by_own_trials and known.explanation is None):
        return ()
    if known.covariance is None or not np.isfinite(known.covariance).all():
        return ()
    constraints, found = _constrained(law, _Estimates.of(law), _TOLERANCE, lambda each: abs(each.number) == 1)
    if not constraints:
        return ()
    errors = np.sqrt(np.maximum(np.diagonal(found.covariances[-1]), 0.0))
    parameters = named_parameters(law)
    written = {name: (False, name) for name in parameters.names}
    if len(law.objects) == 1:
        values = zip(parameters.names, found.values[0].tolist(), errors.tolist(), strict=True)
        written = {name: (value < 0, rounded(abs(value), error)) for name, value, error in values}
    for each in constraints:
        negative, text = (False, "1") if each.other is None else written[parameters.names[each.other]]
        written[each.letter] = (negative != (each.number < 0), text)
    write = {name: (lambda _, own=own: own) for name, own in written.items()}
    return tuple(_without_ones(each.with_numbers(write)) for each in split_equations(law.structure))


def _without_ones(equation: str) -> str:
    """Return an equation without factors, divisors and exponents of one.

    >>> _without_ones("u' = 3.44 1/(1^2 + w^2) - 1 u + v^1/1")
    "u' = 3.44/(1 + w^2) - u + v"
    """
    one = r"(?<![\w.^])1(?![\w.])"
    for pattern, instead in (
        (rf"{one}\^[\d.]+", "1"),
        (rf"(?<!/){one}(?: | ?\* ?)(?=[\w(])", ""),
        (r"[/^]1(?![\w.])", ""),
        (r"(?<=[\w)]) 1/", "/"),
    ):
        equation = re.sub(pattern, instead, equation)
    return equation


def _constrained(
    law: Law,
    start: "_Estimates",
    tolerance: float,
    is_wanted: "Callable[[_Constraint], bool]" = lambda _: True,
) -> "tuple[list[_Constraint], _Estimates]":
    """Return what is replaced, the largest gain first, as far as estimates bear all of it, and estimates given that."""
    found, constraints = start, list[_Constraint]()
    while True:
        wanted = filter(is_wanted, _candidates(law, found, constraints))
        free = [each for each in wanted if each.gain(found, tolerance) > 0]
        borne = [each for each in free if start.bear([*constraints, each], tolerance)]
        if not borne:
            return constraints, found
        constraints.append(max(borne, key=lambda each: each.gain(found, tolerance)))
        found = start.given(constraints)


@dataclass(frozen=True)
class _Constraint:
    """What a letter is replaced by: a number, or a number times another letter; and the bits that it takes to write."""

    letter: str
    index: int
    number: Fraction
    other: int | None
    bits: float

    def row(self, letters: int) -> tuple[Floats, float]:
        """Return what is constrained, a sum of letters with these factors, and to which number."""
        row = np.zeros(letters)
        row[self.index] = 1.0
        if self.other is None:
            return row, float(self.number)
        row[self.other] = -float(self.number)
        return row, 0.0

    def off(self, estimates: "_Estimates") -> float:
        """Return how many standard errors the mean over objects is off."""
        row, number = self.row(estimates.values.shape[1])
        return float(abs(row @ estimates.values[-1] - number) / estimates.error(row))

    def gain(self, estimates: "_Estimates", tolerance: float) -> float:
        """Return how many bits shorter the law gets: digits of a number that are known, less what replaces them."""
        row, _ = self.row(estimates.values.shape[1])
        error, off = estimates.error(row), self.off(estimates)
        if not error > 0 or off > tolerance:
            return -np.inf
        if self.number == 0:
            return float((tolerance**2 - off**2) / _BIT)
        return float(np.log2(abs(estimates.values[-1, self.index]) / error) - self.bits - off**2 / _BIT)

    def form(self, letters: Sequence[str]) -> str:
        """Return it as text."""
        if self.other is None:
            return str(self.number)
        return f"{'-' if self.number < 0 else ''}{letters[self.other]}"

    def expression(self, letters: Sequence[str]) -> "sympy.Expr":
        """Return what takes the place of the letter."""
        number = symbolic().Rational(self.number.numerator, self.number.denominator)
        return number if self.other is None else number * symbol(letters[self.other])

    def replacement(self, letters: Sequence[str], estimates: "_Estimates") -> Replacement:
        """Return what to say of it."""
        mean, error = float(estimates.values[-1, self.index]), estimates.error(np.eye(len(letters))[self.index])
        return Replacement(self.letter, mean, error, self.form(letters), float(self.off(estimates)))


@dataclass(frozen=True, eq=False)
class _Estimates:
    """What letters stand for by object and last on average, shape (objects + 1, letters), with their covariances."""

    values: Floats
    covariances: Floats

    @classmethod
    def of(cls, law: Law) -> "_Estimates":
        own = law.uncertainty.own_estimates(law.coefficients[:, law.support])
        mean = law.average()
        coefficients = np.zeros((len(law.objects) + 1, *law.support.shape))
        coefficients[:-1, law.support], coefficients[-1] = own.coefficients, mean.coefficients[0]
        covariances = np.concatenate([own.covariance, mean.uncertainty.known_covariance()])
        indices = {(j, k): i for i, (j, k) in enumerate(np.argwhere(law.support).tolist())}
        parameters = named_parameters(law)
        slopes = np.zeros((len(coefficients), len(parameters.names), len(indices)))
        values = np.zeros(slopes.shape[:2])
        for i, each in enumerate(parameters.definitions):
            values[:, i] = each.of(coefficients)
            slopes[:, i, [indices[part.equation, part.term] for part in each.parts]] = each.gradient(coefficients)
        return cls(values, slopes @ covariances @ slopes.transpose(0, 2, 1))

    def error(self, row: Floats) -> float:
        """Return the standard error of a sum of letters with these factors, of the mean over objects."""
        return float(np.sqrt(max(row @ self.covariances[-1] @ row, 0.0)))

    def _distances(self, constraints: Sequence[_Constraint]) -> tuple[Floats, Floats, Floats]:
        rows, numbers = zip(*(each.row(self.values.shape[1]) for each in constraints), strict=True)
        left = self.values @ np.array(rows).T - np.array(numbers)
        shared = self.covariances @ np.array(rows).T
        inverse = np.linalg.pinv(np.array(rows) @ shared, rcond=1e-12, hermitian=True)
        return left, shared, inverse

    def chi_square(self, constraints: Sequence[_Constraint]) -> tuple[float, int]:
        """Return the squared distance of all objects from constraints, and how many numbers these take away."""
        if not constraints:
            return 0.0, 0
        left, _, inverse = self._distances(constraints)
        return float(np.einsum("oi,oij,oj->o", left, inverse, left)[:-1].sum()), len(left[:-1]) * len(constraints)

    def bear(self, constraints: Sequence[_Constraint], tolerance: float) -> bool:
        """Whether all objects together, and their mean, are as near as a normal number is to so many errors."""
        left, _, inverse = self._distances(constraints)
        squares = np.einsum("oi,oij,oj->o", left, inverse, left)
        least = p_value(tolerance**2, 1)
        of_objects = p_value(float(squares[:-1].sum()), len(constraints) * (len(squares) - 1))
        return min(of_objects, p_value(float(squares[-1]), len(constraints))) >= least

    def given(self, constraints: Sequence[_Constraint]) -> "_Estimates":
        """Return the estimates of largest likelihood under constraints, with their covariance."""
        left, shared, inverse = self._distances(constraints)
        values = self.values - np.einsum("oli,oij,oj->ol", shared, inverse, left)
        covariances = self.covariances - shared @ inverse @ shared.transpose(0, 2, 1)
        errors = np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2))
        small = np.diagonal(covariances, axis1=1, axis2=2) < (1e-6 * errors) ** 2  # Zero, but for rounding
        covariances = np.where(small[:, :, np.newaxis] | small[:, np.newaxis], 0.0, covariances)
        return replace(self, values=values, covariances=covariances)


def _candidates(law: Law, found: _Estimates, constraints: Sequence[_Constraint]) -> Iterator[_Constraint]:
    """Yield what each letter that is left could be replaced by."""
    parameters = named_parameters(law)
    gone, units = {each.index for each in constraints}, parameters.units
    for i, letter in enumerate(parameters.names):
        if i in gone:
            continue
        if all(power > 0 for power in _powers(law, letter)):
            yield _Constraint(letter, i, Fraction(0), None, 0.0)
        if units[i] in (None, ""):
            yield from _ratios(letter, i, float(found.values[-1, i]))
        for k in range(len(parameters.names)):
            if k != i and k not in gone and units[k] == units[i]:
                yield from (_Constraint(letter, i, Fraction(sign), k, 1 + np.log2(len(units))) for sign in (1, -1))


def _powers(law: Law, letter: str) -> list[int]:
    """Return the powers with which a letter stands before terms; none for a parameter inside them."""
    found = [power for each in named_parameters(law).products for name, power in each.coefficients if name == letter]
    return [0] if letter in law.terms.variables.parameters else found


def _ratios(letter: str, index: int, value: float) -> Iterator[_Constraint]:
    """Yield the ratios of small whole numbers near a value, with the bits of both (Elias 1975, the gamma code)."""
    near = {Fraction(round(value * each), each) for each in range(1, _LARGEST_DENOMINATOR + 1)} - {Fraction(0)}
    for each in near:
        bits = 2 + 2 * (math.log2(abs(each.numerator)) + math.log2(each.denominator))
        yield _Constraint(letter, index, each, None, bits)


def _shortest(law: Law, constraints: Sequence[_Constraint]) -> tuple[str, ...]:
    """Return each equation in its shortest form, with what takes the place of letters that are replaced."""
    sums = right_hand_sides(law)
    parameters = named_parameters(law)
    for each in constraints:
        sums = [own.subs(symbol(each.letter), each.expression(parameters.names)) for own in sums]
    return shortest(law, sums)
