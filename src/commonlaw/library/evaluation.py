"""Computing many terms from one another, each distinct part once."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.library.term import AbstractTerm

Operation = tuple[np.ufunc, int, int]


def slope(operation: np.ufunc, left: Floats, right: Floats, d_left: Floats, d_right: Floats) -> Floats:
    """Return the derivative of a product (`numpy.multiply`) or a quotient (`numpy.divide`).

    The values of the two parts have shape (n,), their derivatives by every variable (variables, n).
    """
    if operation is np.multiply:
        return np.asarray(d_left * right + left * d_right)
    return np.asarray((d_left - left / right * d_right) / right)


@dataclass(frozen=True)
class Plan:
    """The order in which terms are computed: what has parts after its parts, the rest directly.

    A polynomial then costs one multiplication a term: ``x^2 v`` is the column ``x^2`` times the column ``v``. Each
    term has one way of being computed, so its value does not depend on the others.
    """

    steps: tuple[tuple[AbstractTerm, Operation | None], ...]
    """What is computed, in order: a term, and either the operation and the earlier steps that make it, or nothing."""
    indices: tuple[int, ...]
    """The step that gives each wanted term."""

    @classmethod
    def of(cls, terms: Sequence[AbstractTerm]) -> "Plan":
        """Return the plan that computes these terms."""
        found: dict[AbstractTerm, int] = {}
        steps: list[tuple[AbstractTerm, Operation | None]] = []

        def index(term: AbstractTerm) -> int:
            if term not in found:
                parts = term.parts()
                operation = None if parts is None else (parts[0], index(parts[1]), index(parts[2]))
                found[term] = len(steps)
                steps.append((term, operation))
            return found[term]

        indices = tuple(index(term) for term in terms)
        return cls(tuple(steps), indices)

    def evaluate(self, values: Floats, out: Floats | None = None) -> Floats:
        """Return the wanted terms as the columns of a matrix in Fortran order, shape (n, terms)."""
        matrix = np.empty((len(values), len(self.indices)), order="F") if out is None else out
        self._fill(values, matrix)
        return matrix

    def jacobian(self, values: Floats) -> Floats:
        """Return the derivatives of the wanted terms by every variable, shape (n, terms, variables)."""
        columns = self._fill(values, np.empty((len(values), len(self.indices)), order="F"))
        slopes: list[Floats] = []
        with np.errstate(all="ignore"):
            for term, operation in self.steps:
                if operation is None:
                    slopes.append(term.gradient(values).T)
                else:
                    kind, left, right = operation
                    slopes.append(slope(kind, columns[left], columns[right], slopes[left], slopes[right]))
        result = np.empty((len(self.indices), values.shape[1], len(values)))
        for block, step in zip(result, self.indices, strict=True):
            block[:] = slopes[step]
        return result.transpose(2, 0, 1)

    def _fill(self, values: Floats, matrix: Floats) -> list[Floats]:
        """Fill the matrix of wanted terms and return the column of every step."""
        columns: list[Floats | None] = [None] * len(self.steps)
        wanted = list(matrix.T)
        for column, step in zip(wanted, self.indices, strict=True):
            columns[step] = column
        done: list[Floats] = []
        with np.errstate(all="ignore"):
            for (term, operation), out in zip(self.steps, columns, strict=True):
                if operation is not None:
                    kind, left, right = operation
                    done.append(kind(done[left], done[right], out))
                elif out is None:
                    done.append(term.evaluate(values))
                else:
                    out[:] = term.evaluate(values)
                    done.append(out)
        for column, step in zip(wanted, self.indices, strict=True):
            if done[step] is not column:  # A term that is wanted twice
                column[:] = done[step]
        return done
