"""What decides the coefficients of a law, by `Law.explain`: its relations to the objects' properties, as text."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.hierarchy import Relation, RelationKind
from commonlaw.hierarchy.dimensions import is_number, meaning, quotient_unit
from commonlaw.law.equations import left_hand_sides
from commonlaw.law.law import Law
from commonlaw.law.parameters import coefficient_units, standard_errors
from commonlaw.law.text import Addend, coefficient_table, free_letters, latex_with_error, summed, with_error, with_units
from commonlaw.law.uncertainty import Explanation
from commonlaw.library.notation import latex_name, powered

if TYPE_CHECKING:
    import pandas as pd


def relations_frame(law: Law) -> "pd.DataFrame":
    """Return a row for each relation, see `Law.relations`."""
    import pandas as pd

    lefts, indices = left_hand_sides(law), np.argwhere(law.support).tolist()
    rows = [
        {
            "equation": lefts[j],
            "term": law.terms.names[k],
            "kind": str(relation.kind),
            "follows": dependence(relation),
            "factor": relation.factors[0],
            "standard error": relation.errors[0],
            "unit": unit,
            "scatter": relation.scatter,
            "scatter error": relation.scatter_error,
            "probability": relation.probability,
        }
        for (j, k), unit, relation in zip(indices, _factor_units(law), _explanation(law).relations, strict=True)
        if relation is not None
    ]
    return pd.DataFrame(rows)


def dependence(relation: Relation) -> str:
    """Return the properties that a coefficient follows, as text: ``diameter^2/mass``; nothing without any.

    >>> powers = Fraction(2), Fraction(-1), Fraction(-1, 2)
    >>> dependence(Relation(RelationKind.POWER_LAW, (0.25,), (0.01,), ("diameter", "mass", "charge"), powers))
    'diameter^2/(mass charge^(1/2))'
    """
    if relation.kind is RelationKind.AFFINE:
        return " + ".join(relation.properties)
    above, below = (
        [
            powered(name, int(abs(power))) if power.denominator == 1 else f"{powered(name, 1)}^({abs(power)})"
            for name, power in _powers(relation)
            if (power > 0) == wanted
        ]
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
        alone = relation.kind is RelationKind.UNIVERSAL and first and name == "1"
        pairs = zip(relation.factors, known, strict=True)
        numbers = [self.number(abs(value), error, digits, bracket=not alone) for value, error in pairs]
        negative = [value < 0 for value in relation.factors]
        if relation.kind is RelationKind.AFFINE:
            names = ["1", *map(self.name, relation.properties)]
            return Addend(False, f"({summed(map(Addend, negative, numbers, names), self.times)})", name)
        return Addend(negative[0], numbers[0] + self.powers(relation), name)


def _powers(relation: Relation) -> list[tuple[str, Fraction]]:
    return list(zip(relation.properties, relation.exponents, strict=True))


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


def related_rows(
    law: Law, notation: Notation, lefts: Sequence[str], names: Sequence[str], digits: int, errors: bool
) -> list[tuple[str, list[Addend]]]:
    """Return equations with relations before their terms, then shared constants; left-hand sides are those of both."""
    rows: list[list[Addend]] = [[] for _ in lefts]
    equations, constants = len(law.support), law.terms.constants
    related = zip(np.argwhere(law.support).tolist(), _explanation(law).relations, _letters(law), strict=True)
    for (j, k), relation, letter in related:
        row, term = rows[j], names[k]
        if k in constants:
            if letter:  # Its values stand in the table of object-specific coefficients
                continue
            row, term = rows[equations + constants.index(k)], "1"
        if relation is None:
            value = float(law.coefficients[0, j, k])
            row.append(Addend(value < 0, notation.number(abs(value), 0.0, digits), term))
        else:
            row.append(notation.addend(relation, letter or "", term, digits, errors, not row))
    return [(left, row) for i, (left, row) in enumerate(zip(lefts, rows, strict=True)) if row or i < equations]


def relation_lines(law: Law) -> list[str]:
    """Return the lines on what relations leave open, and a table of object-specific coefficients."""
    units, letters = _factor_units(law), _letters(law)
    names = [law.terms.names[k] for _, k in np.argwhere(law.support)]
    related = zip(_explanation(law).relations, letters, names, units, strict=True)
    said = [words for relation, *how in related if relation for words in _remarks(relation, *how)]
    lines, specific = [*([""] if said else []), *said], [letter is not None for letter in letters]
    if any(specific):
        values, errors = law.coefficients[:, law.support][:, specific], standard_errors(law)[:, law.support]
        pairs = zip(letters, units, strict=True)
        heads = with_units(*zip(*((letter, unit) for letter, unit in pairs if letter), strict=True))
        lines += ["", *coefficient_table(law.objects, heads, values, errors[:, specific])]
    return lines


def _remarks(relation: Relation, letter: str | None, name: str, unit: str | None) -> Iterator[str]:
    """Yield what an equation does not say of a relation, given the unit of its factor if it is known."""
    scatter = with_error(relation.scatter, relation.scatter_error)
    amount = f"standard deviation between objects{' in logarithms' if relation.relative else ''} {scatter}"
    if relation.kind is RelationKind.OWN:
        typical = with_error(relation.factors[0], relation.errors[0])
        yield f"{letter} is object-specific: typical value {typical}, {amount}"
    elif relation.scatter:
        yield f"coefficients of {name} deviate from this: {amount}"
    if relation.kind is not RelationKind.POWER_LAW or unit is None:
        return
    if is_number(unit):
        inverse = dependence(replace(relation, exponents=tuple(-power for power in relation.exponents)))
        yield f"the coefficient of {name} times {inverse} is a pi group: it has no unit"
    elif meaning(unit):
        yield f"the factor of {name} has the unit {unit}, that of {meaning(unit)}"
    else:
        yield f"the factor of {name} has the unit {unit}, which no common constant has: a property may be missing"


def _letters(law: Law) -> list[str | None]:
    """Return a letter for each coefficient in the law that is object-specific; a constant has its name."""
    explanation, columns = _explanation(law), np.argwhere(law.support)[:, 1].tolist()
    variables = law.terms.variables.names
    free = iter(free_letters(len(columns), (*variables, *explanation.properties)))
    return [
        law.terms.constant_name(k) or next(free) if relation and relation.kind is RelationKind.OWN else None
        for relation, k in zip(explanation.relations, columns, strict=True)
    ]


def _factor_units(law: Law) -> list[str | None]:
    """Return the units of the relations' factors, as far as they are known."""
    found: list[str | None] = []
    known, units, lefts = coefficient_units(law), law.schema.units, left_hand_sides(law)
    for (j, k), relation in zip(np.argwhere(law.support), _explanation(law).relations, strict=True):
        unit = known.get((lefts[j], law.terms.names[k]))
        if unit is None or relation is None or not {*relation.properties} <= units.keys():
            found.append(None)
        else:
            powers = zip(relation.properties, map(float, relation.exponents), strict=False)
            found.append(quotient_unit(unit, [(units[name], power) for name, power in powers]))
    return found


def _explanation(law: Law) -> Explanation:
    if law.uncertainty.explanation is None:
        raise CommonlawError("relations-missing")
    return law.uncertainty.explanation
