"""From selected or solved equations to the law, with what a user should know about it."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.formulation import LeastSquaresProblem
from commonlaw.law import Alternative, Law
from commonlaw.outcomes import Outcome, note
from commonlaw.selection.rules import Selection
from commonlaw.solvers import STLSQ, AbstractSolver, Candidate

_ILL_CONDITIONED = 1e8
"""Above it, half of the digits of double precision are gone."""


def chosen_law(law: Law, selections: Sequence[Selection]) -> Law:
    """Return the law with the chosen equations besides its known terms, and what they were chosen from."""
    outcomes, alternatives = [], []
    for equation, selection in zip(law.left_hand_sides, selections, strict=True):
        outcomes.append(note("chosen-from-path", equation, reason=selection.reason))
        for i, each in enumerate(selection.table):
            names = tuple(law.terms.names[k] for k in np.flatnonzero(each.candidate.support.any(axis=0)))
            chosen = i == selection.index
            alternatives.append(
                Alternative(equation, names, each.measures(), each.candidate.proven, chosen, each.hyperparameters)
            )
    provenance = replace(law.provenance, outcomes=tuple(outcomes), alternatives=tuple(alternatives))
    return replace(law, coefficients=_with(law, [each.chosen for each in selections]), provenance=provenance)


def fitted_law(law: Law, candidates: Sequence[Candidate], solver: AbstractSolver) -> Law:
    """Return the law with what a solver found besides the known terms, and what a user should know about it."""
    found = replace(law, coefficients=_with(law, candidates))
    outcomes = tuple(_outcomes(found, candidates, solver))
    return replace(found, provenance=replace(found.provenance, outcomes=outcomes))


def _with(law: Law, candidates: Sequence[Candidate]) -> Floats:
    """Return the coefficients of a law with those of a candidate for each equation."""
    return law.coefficients + np.stack([each.coefficients for each in candidates], axis=1)


def _outcomes(law: Law, candidates: Sequence[Candidate], solver: AbstractSolver) -> Iterator[Outcome]:
    """Yield what a user should know about what a solver found."""
    if isinstance(solver, STLSQ) and solver.shared and len(law.objects) == 1:
        yield note("one-object", law.objects[0])
    if not all(each.converged for each in candidates):
        yield note("solver-stopped")
    for j, (equation, candidate) in enumerate(zip(law.left_hand_sides, candidates, strict=True)):
        if not law.support[j].any():
            yield note("support-empty", equation, largest=candidate.largest)


def ill_conditions(law: Law, problems: Sequence[LeastSquaresProblem]) -> Iterator[Outcome]:
    """Yield the equations whose coefficients mean little because their terms nearly depend on each other."""
    for j, equation in enumerate(law.left_hand_sides):
        for problem, name, support in zip(problems, law.objects, law.coefficients[:, j] != 0, strict=True):
            condition = problem.condition(support)
            if condition > _ILL_CONDITIONED:
                yield note("terms-collinear", f"{equation} of {name}", condition=condition)
