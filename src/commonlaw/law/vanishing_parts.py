"""Parts of fractions that vanish within their errors, as where ``a + b/(K + s)`` is ``a s/(K + s)``.

Over one denominator that is ``(a K + b + a s)/(K + s)``. Where ``a K + b`` is zero within its errors, so is one number.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.law.equivalent_forms import right_hand_sides, shortest, symbol, symbolic, written
from commonlaw.law.law import Law
from commonlaw.law.simplification import Replacement, Simplification, p_value
from commonlaw.law.uncertainty import Uncertainty

if TYPE_CHECKING:
    import sympy


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
    """Return a law without a part of a fraction that vanishes; none if no part does.

    Parameters
    ----------
    law
        That is simplified.
    values, covariances
        What its letters stand for, of each object by its own trials, shape (objects, letters), and their covariances.
    tolerance
        Standard errors: parts are as near to zero as a normal number is to so many.
    """
    if not law.terms.variables.constants:
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
        sympy, symbols = symbolic(), [symbol(name) for name in law.letters]
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
        i, count = law.letters.index(self.letter), len(values)
        error = float(np.sqrt(covariances[:, i, i].sum())) / count
        off = float(np.sqrt(self.chi_square(law, values, covariances) / count))
        return Replacement(self.letter, float(values[:, i].mean()), error, written(self.instead), off)


def _parts(law: Law, right_hand_sides: "Sequence[sympy.Expr]") -> Iterator[_Part]:
    """Yield the parts of numerators that are sums, with each letter before a term that they are linear in."""
    sympy, constants = symbolic(), law.terms.variables.constants
    measured = [symbol(name) for name in law.terms.variables.measured]
    factors = [symbol(name) for name in law.letters if name not in constants]
    for j, right in enumerate(right_hand_sides):
        above, below = sympy.fraction(sympy.together(right))
        if not below.has(*map(symbol, constants)):
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
    return next(each for each in law.letters if symbol(each) == wanted)


def _without(law: Law, part: _Part, equations: Sequence[str], values: Floats, covariances: Floats) -> Law:
    """Return the law of equations that lack a letter, with what is known of the others."""
    schema = law.schema
    known = {name: dict(zip(law.objects, own, strict=True)) for name, own in zip(law.letters, values.T, strict=True)}
    del known[part.letter]
    found = Law.from_text(equations, known, inputs=schema.inputs, time=schema.time, units=schema.units)
    indices = {index: i for i, index in enumerate(zip(*np.nonzero(found.support), strict=True))}
    slopes = np.zeros((len(law.objects), len(indices), len(law.letters)))
    own = {name: values[:, i] for i, name in enumerate(law.letters)}
    for product in found.named_products:
        for name, power in product.coefficients:
            slope = product.value(own) * power / own[name]
            slopes[:, indices[product.equation, product.term], law.letters.index(name)] = slope
    covariance = slopes @ covariances @ slopes.transpose(0, 2, 1)
    return replace(found, uncertainty=Uncertainty(covariance=covariance, noise=law.noise))
