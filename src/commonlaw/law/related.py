"""What decides the coefficients of a law, as it is written."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.hierarchy import RelationKind
from commonlaw.law import text
from commonlaw.law.explanation import Explanation, Notation, remarks
from commonlaw.library import Terms


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
        free = iter(text.free_letters(len(kinds), (*self.terms.variables.names, *self.explanation.properties)))
        own = zip(kinds, np.argwhere(self.support)[:, 1].tolist(), strict=True)
        return tuple(self.terms.constant_name(k) or next(free) if kind is RelationKind.OWN else None for kind, k in own)

    def rows(
        self, notation: Notation, lefts: Sequence[str], names: Sequence[str], digits: int, errors: bool
    ) -> list[tuple[str, list[text.Addend]]]:
        """Return what decides the coefficients before each equation's terms, and each constant that is no object's own.

        Left-hand sides are those of equations, then of constants.
        """
        rows: list[list[text.Addend]] = [[] for _ in lefts]
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
                row.append(text.Addend(value < 0, notation.number(abs(value), 0.0, digits), term))
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
            heads = text.with_units(*zip(*((letter, unit) for letter, unit in pairs if letter), strict=True))
            lines += ["", *text.coefficient_table(objects, heads, values, known)]
        return lines
