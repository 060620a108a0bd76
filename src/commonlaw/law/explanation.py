"""What decides the coefficients of a law: its relations to the objects' properties, and how these are written."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.hierarchy import Relation, RelationKind
from commonlaw.hierarchy.dimensions import is_number, meaning
from commonlaw.law.text import Addend, coefficient_table, free_letters, latex_with_error, summed, with_error, with_units
from commonlaw.library import Terms
from commonlaw.library.notation import latex_name, powered

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Explanation:
    """The relations of a law's coefficients to its objects, see `Law.explain`; ``print(law)`` shows them.

    Parameters
    ----------
    relations
        One for each of the law's parameters, in the order of ``numpy.argwhere(law.support)``; None for coefficients
        that are known.
    covariance
        Of the factors of all relations together, in their order, shape (factors, factors).
    """

    relations: tuple[Relation | None, ...]
    covariance: Floats

    @property
    def properties(self) -> tuple[str, ...]:
        """Names of the properties that coefficients follow."""
        return tuple(dict.fromkeys(name for each in self.relations if each for name in each.properties))

    def to_frame(self, equations: Sequence[str], terms: Sequence[str], units: Sequence[str | None]) -> "pd.DataFrame":
        """Return a table with a row for each relation, given equation, term and unit of each coefficient's factor."""
        import pandas as pd

        rows = [
            {
                "equation": equation,
                "term": term,
                "kind": str(each.kind),
                "follows": dependence(each),
                "factor": each.factors[0],
                "standard error": each.errors[0],
                "unit": unit,
                "scatter": each.scatter,
                "scatter error": each.scatter_error,
                "probability": each.probability,
            }
            for equation, term, unit, each in zip(equations, terms, units, self.relations, strict=True)
            if each is not None
        ]
        return pd.DataFrame(rows)


def is_whole(relation: Relation) -> bool:
    """Return whether the numbers of a relation are as many as its kind has, and can be."""
    follows = len(relation.properties)
    powers = follows if relation.kind is RelationKind.POWER_LAW else 0
    factors = 1 + follows if relation.kind is RelationKind.AFFINE else 1
    alone = relation.kind in (RelationKind.UNIVERSAL, RelationKind.OWN) and follows
    counts = len(relation.factors), len(relation.errors), len(relation.exponents)
    numbers = (relation.scatter, relation.scatter_error, *relation.errors)
    zero = bool(powers) and 0.0 in (*relation.factors, relation.typical)
    return not alone and counts == (factors, factors, powers) and min(numbers) >= 0 and not zero


def dependence(relation: Relation) -> str:
    """Return the properties that a coefficient follows, as text: ``diameter^2/mass``; nothing without any.

    >>> powers = Fraction(2), Fraction(-1), Fraction(-1, 2)
    >>> dependence(Relation(RelationKind.POWER_LAW, (0.25,), (0.01,), ("diameter", "mass", "charge"), powers))
    'diameter^2/(mass charge^(1/2))'
    """
    if relation.kind is RelationKind.AFFINE:
        return " + ".join(relation.properties)
    above, below = (
        [_powered(name, abs(each)) for name, each in _powers(relation) if (each > 0) == wanted]
        for wanted in (True, False)
    )
    under = f"({' '.join(below)})" if len(below) > 1 else " ".join(below)
    return (" ".join(above) or ("1" if below else "")) + (f"/{under}" if below else "")


@dataclass(frozen=True)
class Notation:
    """How relations are written: numbers with errors, names, what stands between factors, and powers of properties."""

    number: Callable[..., str]
    name: Callable[[str], str]
    times: str
    powers: Callable[[Relation], str]

    def addend(self, relation: Relation, letter: str, name: str, digits: int, errors: bool, first: bool) -> Addend:
        """Return a coefficient and its term in an equation; each object's own coefficient is a letter."""
        if relation.kind is RelationKind.OWN:
            return Addend(False, self.name(letter), name)
        known = relation.errors if errors else [0.0] * len(relation.errors)
        pairs = list(zip(relation.factors, known, strict=True))
        alone = relation.kind is RelationKind.UNIVERSAL and first and name == "1"
        numbers = [self.number(abs(value), error, digits, bracket=not alone) for value, error in pairs]
        negative = [value < 0 for value in relation.factors]
        if relation.kind is RelationKind.AFFINE:
            names = ["1", *map(self.name, relation.properties)]
            return Addend(False, f"({summed(map(Addend, negative, numbers, names), self.times)})", name)
        return Addend(negative[0], numbers[0] + self.powers(relation), name)


def remarks(relation: Relation, letter: str, name: str, unit: str | None) -> Iterator[str]:
    """Yield what an equation does not say of a relation, given the unit of its factor if it is known."""
    each = with_error(relation.scatter, relation.scatter_error)
    amount = f"their logarithms scatter by {each}" if relation.relative else f"they scatter by {each}"
    if relation.kind is RelationKind.OWN:
        typical = with_error(relation.factors[0], relation.errors[0])
        yield f"{letter} is each object's own: typically {typical}, {amount}"
    elif relation.scatter:
        yield f"coefficients of {name} stray from that: {amount}"
    if relation.kind is not RelationKind.POWER_LAW or unit is None:
        return
    if is_number(unit):
        inverse = dependence(replace(relation, exponents=tuple(-power for power in relation.exponents)))
        yield f"the coefficient of {name} times {inverse} is a pi group: it has no unit"
    elif meaning(unit):
        yield f"the factor of {name} has the unit {unit}, that of {meaning(unit)}"
    else:
        yield f"the factor of {name} has the unit {unit}, that of no common constant: a property may be missing"


def _powers(relation: Relation) -> list[tuple[str, Fraction]]:
    return list(zip(relation.properties, relation.exponents, strict=True))


def _powered(name: str, power: Fraction) -> str:
    return powered(name, int(power)) if power.denominator == 1 else f"{powered(name, 1)}^({power})"


def _plain_powers(relation: Relation) -> str:
    follows = dependence(relation)
    return follows[1:] if follows.startswith("1/") else follows and f" {follows}"


def _latex_powers(relation: Relation) -> str:
    above, below = (
        r"\, ".join(
            latex_name(name) + (f"^{{{abs(power)}}}" if abs(power) != 1 else "")
            for name, power in _powers(relation)
            if (power > 0) == wanted
        )
        for wanted in (True, False)
    )
    fraction = rf"\frac{{{above or 1}}}{{{below}}}" if below else above
    return fraction and rf"\, {fraction}"


PLAIN = Notation(with_error, lambda name: powered(name, 1), " ", _plain_powers)
LATEX = Notation(latex_with_error, latex_name, r"\, ", _latex_powers)


@dataclass(frozen=True, eq=False)
class RelatedCoefficients:
    """The coefficients of a law, and what decides them.

    Parameters
    ----------
    terms
        Of the law.
    support
        Which of them are in the law, shape (equations, terms).
    coefficients
        Shape (objects, equations, terms).
    explanation
        A relation for each coefficient in the law.
    """

    terms: Terms
    support: Bools
    coefficients: Floats
    explanation: Explanation

    @cached_property
    def letters(self) -> tuple[str | None, ...]:
        """A letter for each coefficient in the law that is each object's own; a constant has its name."""
        kinds = [each and each.kind for each in self.explanation.relations]
        free = iter(free_letters(len(kinds), (*self.terms.variables.names, *self.explanation.properties)))
        own = zip(kinds, np.argwhere(self.support)[:, 1].tolist(), strict=True)
        return tuple(self.terms.constant_name(k) or next(free) if kind is RelationKind.OWN else None for kind, k in own)

    def rows(
        self, notation: Notation, lefts: Sequence[str], names: Sequence[str], digits: int, errors: bool
    ) -> list[tuple[str, list[Addend]]]:
        """Return what decides the coefficients before each equation's terms, and each constant that is no object's own.

        Left-hand sides are those of equations, then of constants.
        """
        rows: list[list[Addend]] = [[] for _ in lefts]
        equations = len(self.support)
        related = zip(np.argwhere(self.support).tolist(), self.explanation.relations, self.letters, strict=True)
        for (j, k), relation, letter in related:
            row, term = rows[j], names[k]
            if k in self.terms.constants:
                if letter:  # Its values stand in the table of what is each object's own
                    continue
                row, term = rows[equations + self.terms.constants.index(k)], "1"
            if relation is None:
                value = float(self.coefficients[0, j, k])
                row.append(Addend(value < 0, notation.number(abs(value), 0.0, digits), term))
            else:
                row.append(notation.addend(relation, letter or "", term, digits, errors, not row))
        return [(left, row) for i, (left, row) in enumerate(zip(lefts, rows, strict=True)) if row or i < equations]

    def lines(self, objects: Sequence[str], errors: Floats, units: Sequence[str | None]) -> list[str]:
        """Return the lines that hold what relations leave open, and coefficients that are objects' own.

        Standard errors have the shape (objects, equations, terms); units are those of the relations' factors.
        """
        names = [self.terms.names[k] for _, k in np.argwhere(self.support)]
        every = zip(self.explanation.relations, self.letters, names, units, strict=True)
        said = [words for each, *how in every if each is not None for words in remarks(each, how[0] or "", *how[1:])]
        lines, own = [*([""] if said else []), *said], [each is not None for each in self.letters]
        if any(own):
            values, known = self.coefficients[:, self.support][:, own], errors[:, self.support][:, own]
            pairs = zip(self.letters, units, strict=True)
            heads = with_units(*zip(*((letter, unit) for letter, unit in pairs if letter), strict=True))
            lines += ["", *coefficient_table(objects, heads, values, known)]
        return lines
