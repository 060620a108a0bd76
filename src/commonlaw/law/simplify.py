"""The simplest form of a law: numbers become whole, ratios of small whole numbers, or each other, within errors."""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.law.law import Law, shares_terms
from commonlaw.law.objects import average_law
from commonlaw.law.parameters import Parameters, left_hand_sides, named_parameters
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
    """Return the symbol of a variable, or a parameter."""
    return symbolic().Symbol(quoted(name), real=True)


def right_hand_sides(law: Law) -> "list[sympy.Expr]":
    """Return what the equations give, with symbols for parameters."""
    sympy, columns = symbolic(), [symbol(name) for name in law.terms.variables.names]
    products = {(product.equation, product.term): product for product in named_parameters(law).products}
    summands = []
    for j, k in np.argwhere(law.support & law.terms.is_factor).tolist():
        product = products.get((j, k))
        factors = [symbol(name) ** power for name, power in product.coefficients] if product else []
        number = product.factor if product else float(law.coefficients[0, j, k])
        ratio = Fraction(number).limit_denominator(1000)
        exact = sympy.Rational(ratio.numerator, ratio.denominator) if float(ratio) == number else sympy.Float(number)
        summands.append((j, sympy.Mul(exact, *factors, law.terms.terms[k].sympy(columns))))
    return [sympy.Add(*(summand for i, summand in summands if i == j)) for j in range(len(law.schema.states))]


def shortest(law: Law, right_hand_sides: "Sequence[sympy.Expr]") -> tuple[str, ...]:
    """Return each equation in the equivalent form of fewest operations if `commonlaw.fit` reads it, else as a sum."""
    sympy = symbolic()
    forms = (sympy.factor, sympy.factor_terms, sympy.together, sympy.collect_const, sympy.simplify)
    plain, short = list[str](), list[str]()
    for left_side, right in zip(left_hand_sides(law), right_hand_sides, strict=True):
        candidates = [
            (expression.count_ops(), f"{left_side} = {written(expression, order)}")
            for expression in (form(right) for form in (sympy.expand, *forms))
            for order in ("lex", "rev-lex")
        ]
        plain.append(candidates[0][1])
        short.append(min((operations, len(text), text) for operations, text in candidates)[2])
    try:
        read_equations(short, law.schema)
    except CommonlawError:
        return tuple(plain)
    return tuple(short)


def written(expression: "sympy.Expr", order: str = "lex") -> str:
    """Return an expression in the words of equations."""
    text = str(symbolic().sstr(expression, order=order))
    for theirs, ours in (("**", "^"), ("Abs(", "abs("), ("atan(", "arctan("), ("ceiling(", "ceil(")):
        text = text.replace(theirs, ours)
    return text


@dataclass(frozen=True, eq=False)
class _VanishingPart:
    """A sum before products of variables in a numerator, and the parameter that takes a form where it is zero.

    Values of the sum have the shape (objects,), its derivatives by all parameters (objects, parameters).
    """

    equation: "sympy.Expr"
    index: int
    parameter: str
    form: "sympy.Expr"
    values: Floats
    slopes: Floats

    def chi_square(self, covariances: Floats) -> float:
        """Return the squared distance of all objects from zero, in units of the variance."""
        variances = np.einsum("oi,oij,oj->o", self.slopes, covariances, self.slopes)
        return float(np.sum(self.values**2 / variances)) if (variances > 0).all() else np.inf


def _vanishing_part(law: Law, estimates: "_Estimates", tolerance: float) -> _VanishingPart | None:
    """Return the part whose absence leaves the shortest equation; none if no part is zero within its errors."""
    sympy, parameters = symbolic(), law.terms.variables.parameters
    if not parameters:
        return None
    measured = [symbol(name) for name in law.terms.variables.measured]
    names = estimates.parameters.names
    symbols, candidates = [symbol(name) for name in names], list[_VanishingPart]()
    limited = [symbol(name) for name in estimates.limited]
    for j, right in enumerate(right_hand_sides(law)):
        above, below = sympy.fraction(sympy.together(right))
        if not below.has(*map(symbol, parameters)):
            continue
        try:
            parts = sympy.Poly(sympy.expand(above), *measured).coeffs()
        except sympy.PolynomialError:
            continue
        for part in (part for part in parts if part.is_Add and not part.has(*limited)):
            gradient = sympy.lambdify(symbols, [part, *(part.diff(unknown) for unknown in symbols)])
            along = np.array([gradient(*value) for value in estimates.values[:-1]], dtype=np.float64)
            for name, unknown in zip(names, symbols, strict=True):
                slope = part.diff(unknown)  # Linear in factors of terms only
                if name not in parameters and part.has(unknown) and not slope.has(unknown):
                    form = sympy.factor(-part.subs(unknown, 0) / slope)
                    equation = sympy.factor(right.subs(unknown, form))
                    candidates.append(_VanishingPart(equation, j, name, form, along[:, 0], along[:, 1:]))
    least, covariances = p_value(tolerance**2, 1), estimates.covariances[:-1]
    near = [part for part in candidates if p_value(part.chi_square(covariances), len(law.objects)) >= least]
    return min(near, key=lambda part: part.equation.count_ops(), default=None)


def _without(law: Law, part: _VanishingPart, estimates: "_Estimates") -> Law:
    """Return the law without a part, the other parameters at their largest likelihood given that, to first order."""
    values, covariances = estimates.values[:-1], estimates.covariances[:-1]
    shared = np.einsum("oij,oj->oi", covariances, part.slopes)
    variances = np.einsum("oi,oi->o", part.slopes, shared)[:, np.newaxis]
    values = values - shared * (part.values[:, np.newaxis] / variances)
    covariances = covariances - shared[:, :, np.newaxis] * shared[:, np.newaxis, :] / variances[:, np.newaxis]
    rights, schema, names = right_hand_sides(law), law.schema, estimates.parameters.names
    rights[part.index] = part.equation
    by_name = dict(zip(names, values.T, strict=True))
    known = {
        name: dict(zip(law.objects, numbers, strict=True))
        for name, numbers in by_name.items()
        if name != part.parameter
    }
    result = Law.from_text(shortest(law, rights), known, inputs=schema.inputs, time=schema.time, units=schema.units)
    indices = {index: i for i, index in enumerate(zip(*np.nonzero(result.support), strict=True))}
    slopes = np.zeros((len(law.objects), len(indices), len(names)))
    for product in named_parameters(result).products:
        for name, power in product.coefficients:
            slope = product.value(by_name) * power / by_name[name]
            slopes[:, indices[product.equation, product.term], names.index(name)] = slope
    covariance = slopes @ covariances @ slopes.transpose(0, 2, 1)
    before = law.uncertainty
    uncertainty = Uncertainty(
        covariance=covariance, noise=before.noise, huber_threshold=before.huber_threshold, limits=before.limits
    )
    return replace(result, uncertainty=uncertainty)


_BIT = 2 * np.log(2)
"""What a bit is worth in squared standard errors."""


def simplified(law: Law, tolerance: float) -> Simplification:
    """Return the simplest form of a law, see `Law.simplify`."""
    if not tolerance > 0:
        raise CommonlawError("simplify-tolerance", tolerance=tolerance)
    if not shares_terms(law):
        raise CommonlawError("simplify-own-terms")
    start = _Estimates.of(law)
    if part := _vanishing_part(law, start, tolerance):
        rest, i = simplified(_without(law, part, start), tolerance), start.parameters.names.index(part.parameter)
        count, chi_square = len(law.objects), part.chi_square(start.covariances[:-1])
        mean, error = float(start.values[:-1, i].mean()), float(np.sqrt(start.covariances[:-1, i, i].sum())) / count
        off = float(np.sqrt(chi_square / count))
        return replace(
            rest,
            replaced=(Replacement(part.parameter, mean, error, written(part.form), off), *rest.replaced),
            chi_square=rest.chi_square + chi_square,
            degrees_of_freedom=rest.degrees_of_freedom + count,
        )
    constraints, estimates = _constrained(start, tolerance)
    chi_square, degrees = start.chi_square(constraints)
    names, gone = start.parameters.names, {constraint.parameter for constraint in constraints}
    rights = right_hand_sides(law)
    kept = [i for i, name in enumerate(names) if name not in gone]
    for constraint in constraints:
        number = symbolic().Rational(constraint.number.numerator, constraint.number.denominator)
        form = number if constraint.other is None else number * symbol(names[constraint.other])
        rights = [right.subs(symbol(constraint.parameter), form) for right in rights]
    return Simplification(
        equations=shortest(law, rights),
        replaced=tuple(constraint.replacement(names, start) for constraint in constraints),
        chi_square=chi_square,
        degrees_of_freedom=degrees,
        objects=law.objects,
        parameters=tuple(names[i] for i in kept),
        values=estimates.values[:-1, kept],
        errors=np.sqrt(np.maximum(np.diagonal(estimates.covariances, axis1=1, axis2=2), 0.0))[:-1, kept],
        limits=law.uncertainty.limits,
    )


def within_errors(law: Law) -> list[str]:
    """Return a line of equations, parameters replaced that are within errors of 1, -1, another or its opposite.

    No line if none is, or estimates of each object by its own trials are unknown. Of one object, the other parameters
    are numbers: those of largest likelihood then.
    """
    known = law.uncertainty
    by_own_trials = known.shared_factor is None or known.unpooled is not None
    if not (shares_terms(law) and by_own_trials and known.explanation is None):
        return []
    if known.covariance is None or not np.isfinite(known.covariance).all():
        return []
    # Standard errors: one in twenty numbers that are simple is not shown as such
    constraints, estimates = _constrained(_Estimates.of(law), 2.0, lambda constraint: abs(constraint.number) == 1)
    if not constraints:
        return []
    errors, parameters = np.sqrt(np.maximum(np.diagonal(estimates.covariances[-1]), 0.0)), estimates.parameters
    written = {name: (False, name) for name in parameters.names}
    if len(law.objects) == 1:
        values = zip(parameters.names, estimates.values[0].tolist(), errors.tolist(), strict=True)
        numbers = {name: (value < 0, rounded(abs(value), error)) for name, value, error in values}
        written |= {name: number for name, number in numbers.items() if name not in estimates.limited}
    for constraint in reversed(constraints):  # what replaces a parameter may be replaced by a later constraint
        negative, text = (False, "1") if constraint.other is None else written[parameters.names[constraint.other]]
        written[constraint.parameter] = (negative != (constraint.number < 0), text)
    write = {name: (lambda _, pair=pair: pair) for name, pair in written.items()}
    equations = (_without_ones(equation.with_numbers(write)) for equation in split_equations(law.structure))
    return [f"within errors: {'; '.join(equations)}"]


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
    start: "_Estimates", tolerance: float, is_wanted: "Callable[[_Constraint], bool]" = lambda _: True
) -> "tuple[list[_Constraint], _Estimates]":
    """Return what is replaced, the largest gain first, as far as estimates bear all of it, and estimates given that."""
    result, constraints = start, list[_Constraint]()
    while True:
        wanted = filter(is_wanted, _candidates(result, constraints))
        free = [constraint for constraint in wanted if constraint.gain(result, tolerance) > 0]
        borne = [constraint for constraint in free if start.bear([*constraints, constraint], tolerance)]
        if not borne:
            return constraints, result
        constraints.append(max(borne, key=lambda constraint: constraint.gain(result, tolerance)))
        result = start.given(constraints)


@dataclass(frozen=True)
class _Constraint:
    """What a parameter is replaced by, a number, or a number times another parameter, and the bits to write it."""

    parameter: str
    index: int
    number: Fraction
    other: int | None
    bits: float

    def row(self, parameters: int) -> tuple[Floats, float]:
        """Return what is constrained, a sum of parameters with these factors, and to which number."""
        row = np.zeros(parameters)
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
        error = estimates.error(row)
        if not error > 0 or (off := self.off(estimates)) > tolerance:
            return -np.inf
        if self.number == 0:
            return float((tolerance**2 - off**2) / _BIT)
        value = abs(estimates.values[-1, self.index])
        return float(np.log2(value / error) - self.bits - off**2 / _BIT) if value > 0 else -np.inf

    def replacement(self, names: Sequence[str], estimates: "_Estimates") -> Replacement:
        """Return what to say of it."""
        mean, error = float(estimates.values[-1, self.index]), estimates.error(np.eye(len(names))[self.index])
        form = str(self.number) if self.other is None else f"{'-' if self.number < 0 else ''}{names[self.other]}"
        return Replacement(self.parameter, mean, error, form, float(self.off(estimates)))


@dataclass(frozen=True, eq=False)
class _Estimates:
    """Parameters by object and last on average, shape (objects + 1, parameters), with their covariances."""

    parameters: Parameters
    values: Floats
    covariances: Floats

    @property
    def limited(self) -> list[str]:
        """Names of the parameters that have only a limit in some object, which nothing replaces."""
        limited = self.parameters.limited
        return [name for i, name in enumerate(self.parameters.names) if limited[:, i].any()]

    @classmethod
    def of(cls, law: Law) -> "_Estimates":
        parameters = named_parameters(law)
        law = replace(law, uncertainty=replace(law.uncertainty, covariance=parameters.covariance_given_limits))
        estimates = law.uncertainty.own_estimates(law.coefficients[:, law.support])
        mean = average_law(law)
        coefficients = np.zeros((len(law.objects) + 1, *law.support.shape))
        coefficients[:-1, law.support], coefficients[-1] = estimates.coefficients, mean.coefficients[0]
        average = np.zeros_like(estimates.covariance[:1])
        rows, columns = np.ix_(mean.support[law.support], mean.support[law.support])
        average[:, rows, columns] = mean.uncertainty.known_covariance()
        covariances = np.concatenate([estimates.covariance, average])
        values = parameters.of(coefficients)
        # A parameter at a bound of zero has no error
        slopes = np.nan_to_num(parameters.slopes(coefficients), posinf=np.inf, neginf=-np.inf)
        with np.errstate(all="ignore"):
            covariances = slopes @ covariances @ slopes.transpose(0, 2, 1)
        # An infinite estimate is replaced by nothing: without an error it is no candidate
        beyond = ~(np.isfinite(values) & np.isfinite(np.diagonal(covariances, axis1=1, axis2=2))).all(axis=0)
        values[:, beyond] = 0.0
        beyond |= parameters.limited.any(axis=0)
        covariances[:, beyond] = covariances[:, :, beyond] = 0.0
        return cls(parameters, values, covariances)

    def error(self, row: Floats) -> float:
        """Return the standard error of a sum of parameters with these factors, of the mean over objects."""
        return float(np.sqrt(max(row @ self.covariances[-1] @ row, 0.0)))

    def _distances(self, constraints: Sequence[_Constraint]) -> tuple[Floats, Floats, Floats]:
        rows, numbers = zip(*(constraint.row(self.values.shape[1]) for constraint in constraints), strict=True)
        distances = self.values @ np.array(rows).T - np.array(numbers)
        shared = self.covariances @ np.array(rows).T
        inverse = np.linalg.pinv(np.array(rows) @ shared, rcond=1e-12, hermitian=True)
        return distances, shared, inverse

    def chi_square(self, constraints: Sequence[_Constraint]) -> tuple[float, int]:
        """Return the squared distance of all objects from constraints, and how many numbers these take away."""
        if not constraints:
            return 0.0, 0
        distances, _, inverse = self._distances(constraints)
        squares = np.einsum("oi,oij,oj->o", distances, inverse, distances)[:-1]
        return float(squares.sum()), len(squares) * len(constraints)

    def bear(self, constraints: Sequence[_Constraint], tolerance: float) -> bool:
        """Whether all objects together, and their mean, are as near as a normal number is to so many errors."""
        distances, _, inverse = self._distances(constraints)
        squares = np.einsum("oi,oij,oj->o", distances, inverse, distances)
        least = p_value(tolerance**2, 1)
        of_objects = p_value(float(squares[:-1].sum()), len(constraints) * (len(squares) - 1))
        return min(of_objects, p_value(float(squares[-1]), len(constraints))) >= least

    def given(self, constraints: Sequence[_Constraint]) -> "_Estimates":
        """Return the estimates of largest likelihood under constraints, with their covariance."""
        distances, shared, inverse = self._distances(constraints)
        values = self.values - np.einsum("oli,oij,oj->ol", shared, inverse, distances)
        covariances = self.covariances - shared @ inverse @ shared.transpose(0, 2, 1)
        errors = np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2))
        small = np.diagonal(covariances, axis1=1, axis2=2) < (1e-6 * errors) ** 2  # Zero, but for rounding
        covariances = np.where(small[:, :, np.newaxis] | small[:, np.newaxis], 0.0, covariances)
        return replace(self, values=values, covariances=covariances)


def _candidates(found: _Estimates, constraints: Sequence[_Constraint]) -> Iterator[_Constraint]:
    """Yield what each remaining parameter could be replaced by.

    Ratios of whole numbers have the bits of both (Elias 1975, the gamma code).
    """
    parameters, inside = found.parameters, found.parameters.law.terms.variables.parameters
    gone, units = {constraint.index for constraint in constraints}, parameters.units
    gone |= {parameters.names.index(name) for name in found.limited}
    powers = [pair for product in parameters.products for pair in product.coefficients]
    for i, name in enumerate(parameters.names):
        if i in gone:
            continue
        if name not in inside and all(power > 0 for factor, power in powers if factor == name):
            yield _Constraint(name, i, Fraction(0), None, 0.0)
        if units[i] in (None, ""):
            value = float(found.values[-1, i])
            near = {Fraction(round(value * below), below) for below in range(1, 13)}
            for ratio in near - {Fraction(0)}:
                bits = 2 + 2 * (math.log2(abs(ratio.numerator)) + math.log2(ratio.denominator))
                yield _Constraint(name, i, ratio, None, bits)
        for k in range(len(parameters.names)):
            if k != i and k not in gone and units[k] == units[i]:
                yield from (_Constraint(name, i, Fraction(sign), k, 1 + np.log2(len(units))) for sign in (1, -1))
