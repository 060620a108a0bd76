"""Linear equality constraints on coefficients, within and across objects."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.solvers.base import AbstractSolver, Candidates, Problems, StandardizedProblem, Values

_RANK = 1e-12
"""Singular values of constraints, with rows of unit norm, that count as zero."""


@dataclass(frozen=True, eq=False)
class ConstrainedSolver(AbstractSolver):
    """Another solver's terms, with coefficients refitted under linear equality constraints.

    The terms are chosen without the constraints. Objects count relative to their residual variance, see
    `StandardizedProblem`. Wrap once for each equation that has constraints.

    Raises `CommonlawError` when it solves, if the constraints depend on each other, do not fit the library, or cannot
    be met.

    Parameters
    ----------
    solver
        Chooses the terms.
    equal
        Indices of the terms that have one coefficient for all objects that have the term.
    matrix, right
        Further constraints ``matrix @ coefficients.ravel() = right`` on coefficients of shape (objects, terms): shapes
        (constraints, objects * terms) and (constraints,). Absent terms have the coefficient 0.
    equation
        The equation that is constrained.

    """

    solver: AbstractSolver
    equal: tuple[int, ...] = ()
    matrix: Floats | None = None
    right: Floats | None = None
    equation: int = 0

    def __post_init__(self) -> None:
        if (self.matrix is None) != (self.right is None):
            raise CommonlawError("constraints-incomplete")

    @property
    def hyperparameter_name(self) -> str:
        return self.solver.hyperparameter_name

    @property
    def hyperparameter(self) -> float | None:
        return self.solver.hyperparameter

    def path(self, problems: Problems, target: int, allowed: Bools, values: Values = None) -> Candidates:
        """Return those of the solver's candidates that can meet the constraints, refitted; none of them is proven.

        The whole path ends early where constraints need terms. Raises `CommonlawError` if constraints depend on each
        other or do not fit the library; with values, if they cannot be met.
        """
        path = self.solver.path(problems, target, allowed, values)
        if target != self.equation:
            return path
        refitted = []
        for candidate in path:
            support, (matrix, right) = candidate.support, self._constraints(candidate.support)
            if values is None and _solutions(matrix[:, support.ravel()], right) is None:
                continue
            variance = StandardizedProblem.of(problems, self.equation, np.asarray(support.any(axis=0))).variance
            weighted = [problem.weighted(weight) for problem, weight in zip(problems, 1 / variance, strict=True)]
            coefficients = constrained_least_squares(weighted, support, self.equation, matrix, right)
            refitted.append(replace(candidate, coefficients=coefficients, proven=False))
        return tuple(refitted)

    def _constraints(self, support: Bools) -> tuple[Floats, Floats]:
        """Return all constraints that hold for a support, as a matrix and a right-hand side."""
        objects, terms = support.shape
        if any(not 0 <= index < terms for index in self.equal):
            raise CommonlawError("constraints-index", equal=self.equal, last=terms - 1)
        pairs = [pair for index in self.equal for pair in pairwise(np.flatnonzero(support[:, index]) * terms + index)]
        matrix = np.zeros((len(pairs), objects * terms))
        for row, pair in zip(matrix, pairs, strict=True):
            row[[*pair]] = 1.0, -1.0
        right = np.zeros(len(matrix))
        if self.matrix is None or self.right is None:
            return matrix, right
        _check(self.matrix, self.right, support)
        return np.concatenate([matrix, self.matrix]), np.concatenate([right, self.right])


def constrained_least_squares(problems: Problems, support: Bools, target: int, matrix: Floats, right: Floats) -> Floats:
    """Return the coefficients of all objects, shape (objects, terms), of least squared residuals under constraints.

    By the null-space method (Golub and Van Loan, Matrix Computations, section 6.2), on columns of unit norm. Terms
    outside the support, shape (objects, terms), get zero; constraints are ``matrix @ coefficients.ravel() = right``, of
    shapes (constraints, objects * terms) and (constraints,). Raises `CommonlawError` if they are not of these shapes,
    depend on each other, or cannot be met with this support.
    """
    # LAPACK's gglse asks for independent columns; here dependent ones get the solution of least norm
    from scipy.linalg import block_diag

    _check(matrix, right, support)
    norms = np.array([problem.norms for problem in problems])
    scales = np.where(norms > 0, norms, 1.0)
    terms = problems[0].terms
    listed = zip(problems, scales, support, strict=True)
    blocks = [(problem.factor[:, :terms] / scale)[:, row] for problem, scale, row in listed]
    columns, goal = block_diag(*blocks), np.concatenate([problem.factor[:, terms + target] for problem in problems])
    solutions = _solutions(matrix[:, support.ravel()] / scales[support], right)
    if solutions is None:
        raise CommonlawError("constraints-not-met")
    point, along = solutions
    point = point + along @ np.linalg.lstsq(columns @ along, goal - columns @ point, rcond=1e-14)[0]
    coefficients = np.zeros(support.shape)
    coefficients[support] = point / scales[support]
    return coefficients


def _check(matrix: Floats, right: Floats, support: Bools) -> None:
    if np.shape(matrix) != (len(right), support.size):
        (objects, terms), shape = support.shape, np.shape(matrix)
        raise CommonlawError(
            "constraints-shape", shape=shape, objects=objects, terms=terms, constraints=len(right), columns=support.size
        )
    values = _unit_rows(matrix, right)[0]
    if np.linalg.matrix_rank(values, tol=_RANK * max(values.shape)) < len(values):
        raise CommonlawError("constraints-dependent")


def _unit_rows(matrix: Floats, right: Floats) -> tuple[Floats, Floats]:
    norms = np.linalg.norm(matrix, axis=1)
    norms[norms == 0] = 1.0
    return matrix / norms[:, np.newaxis], right / norms


def _solutions(matrix: Floats, right: Floats) -> tuple[Floats, Floats] | None:
    """Return one solution of ``matrix @ x = right``, if any, and an orthonormal basis of the ways to move from it."""
    matrix, right = _unit_rows(matrix, right)
    columns, values, rows = np.linalg.svd(matrix)
    rank = int(np.sum(values > _RANK * max(matrix.shape, default=1)))
    point = rows[:rank].T @ ((columns[:, :rank].T @ right) / values[:rank])
    if np.abs(matrix @ point - right).max(initial=0.0) > 1e-9 * np.abs(right).max(initial=0.0):
        return None
    return point, rows[rank:].T
