"""The selection of every equation of a law, and the law that follows from it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.diagnostics import Outcome, note
from commonlaw.formulation import (
    AbstractFormulation,
    CompressedTrials,
    LeastSquaresProblem,
    StrongForm,
    differentiation_bias,
    effective_share,
)
from commonlaw.law import Alternative, Law
from commonlaw.law.parameters import left_hand_sides
from commonlaw.library import Terms
from commonlaw.selection.cross_validation import CrossValidationScore, stability
from commonlaw.selection.rules import Selection, choose
from commonlaw.solvers import STLSQ, AbstractSolver, Candidate
from commonlaw.trials import Trial

SEGMENTS = 4
"""Segments of time into which a trial is cut, so that single trials can be held out in part and resampled."""


@dataclass(frozen=True, eq=False)
class Accuracy:
    """How accurate the rows of each object are, estimated from some of its trials."""

    form: AbstractFormulation
    terms: Terms
    samples: Sequence[Sequence[Trial]]

    def rows(self, counts: Sequence[int]) -> Floats:
        """Return the number of independent rows of each object that has so many rows."""
        if not isinstance(self.form, StrongForm):
            return np.array(counts, dtype=np.float64)
        shares = [np.mean([effective_share(self.form, trial) for trial in trials]) for trials in self.samples]
        return np.array(counts) * np.array(shares)

    def differentiation_bias(self, target: int, coefficients: Floats) -> Floats:
        """Return the mean squared error that the derivatives of an equation have without noise, shape (objects,)."""
        if not isinstance(self.form, StrongForm):
            return np.zeros(len(self.samples))
        pairs = zip(self.samples, coefficients, strict=True)
        return np.array(
            [differentiation_bias(self.form, self.terms, trials, target, of_equation) for trials, of_equation in pairs]
        )


def select(
    data: CompressedTrials,
    known: Floats,
    solvers: Sequence[AbstractSolver],
    accuracy: Accuracy,
    *,
    rule: str = "one-standard-error",
    n_resamples: int = 0,
    seed: int = 0,
    scores: Sequence[Callable[[Bools], CrossValidationScore]] | None = None,
) -> tuple[Selection, ...]:
    """Return the selection of every equation among the candidates on the paths of some solvers.

    Coefficients that are known, shape (objects, equations, terms), NaN where they are fitted, are moved to the
    left-hand side. For the rule see `choose`; resamples, for the stability of the candidates, go to the first solver.
    Scores, one for each equation, take a support to its errors on held-out data; default: residuals.
    """
    given, free = np.nan_to_num(known), np.isnan(known[0])
    rest = data.subtract(given)
    rows = accuracy.rows([problem.rows for problem in rest.problems])

    def selection(target: int) -> Selection:
        paths = [partial(solver.path, target=target, allowed=free[target]) for solver in solvers]
        listed = [candidate for path in paths for candidate in path(rest.problems)]
        return choose(
            listed if len(solvers) == 1 else [replace(candidate, hyperparameter=np.nan) for candidate in listed],
            rest.groups,
            target,
            free[target],
            rule=rule,
            rows=rows,
            differentiation_bias=lambda fitted: accuracy.differentiation_bias(target, fitted + given[:, target]),
            score=None if scores is None else scores[target],
            stability=stability(rest.groups, paths[0], n_resamples, seed) if n_resamples else None,
        )

    return tuple(selection(target) for target in range(len(free)))


def chosen_law(law: Law, selections: Sequence[Selection]) -> Law:
    """Return the law with the chosen equations besides its known terms, and what they were chosen from."""
    outcomes, alternatives = [], []
    for equation, selection in zip(left_hand_sides(law), selections, strict=True):
        outcomes.append(note("chosen-from-path", equation, reason=selection.reason))
        for i, scored in enumerate(selection.table):
            names = tuple(law.terms.names[k] for k in np.flatnonzero(scored.candidate.support.any(axis=0)))
            chosen = i == selection.index
            alternatives.append(
                Alternative(equation, names, scored.measures(), scored.candidate.proven, chosen, scored.hyperparameters)
            )
    provenance = replace(law.provenance, outcomes=tuple(outcomes), alternatives=tuple(alternatives))
    return replace(law, coefficients=_with(law, [selection.chosen for selection in selections]), provenance=provenance)


def fitted_law(law: Law, candidates: Sequence[Candidate], solver: AbstractSolver) -> Law:
    """Return the law with the coefficients of a solver and fixed ones, and its outcomes."""
    result, outcomes = replace(law, coefficients=_with(law, candidates)), list[Outcome]()
    if isinstance(solver, STLSQ) and solver.shared and len(law.objects) == 1:
        outcomes.append(note("one-object", law.objects[0]))
    if not all(candidate.converged for candidate in candidates):
        outcomes.append(note("solver-stopped"))
    for equation, support, candidate in zip(left_hand_sides(law), result.support, candidates, strict=True):
        if not support.any():
            outcomes.append(note("support-empty", equation, largest=candidate.largest))
    return replace(result, provenance=replace(result.provenance, outcomes=tuple(outcomes)))


def _with(law: Law, candidates: Sequence[Candidate]) -> Floats:
    """Return the coefficients of a law with those of a candidate for each equation."""
    return law.coefficients + np.stack([candidate.coefficients for candidate in candidates], axis=1)


def ill_conditions(law: Law, problems: Sequence[LeastSquaresProblem]) -> Iterator[Outcome]:
    """Yield the equations whose coefficients mean little because their terms nearly depend on each other."""
    for j, equation in enumerate(left_hand_sides(law)):
        for problem, name, support in zip(problems, law.objects, law.coefficients[:, j] != 0, strict=True):
            condition = problem.condition(support)
            if condition > 1e8:  # Half of the digits of double precision are gone
                yield note("terms-collinear", f"{equation} of {name}", condition=condition)
