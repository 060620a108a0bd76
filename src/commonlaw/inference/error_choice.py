"""Which law, and which errors, where white noise does not explain the measurements: those of largest evidence."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.effort import unannounced
from commonlaw.errors import CommonlawError
from commonlaw.inference.hypotheses import Hypothesis
from commonlaw.inference.search_problem import SearchProblem
from commonlaw.inference.search_state import SearchState, evidence_of
from commonlaw.integration import InitialValueProblem, Inputs, simulate
from commonlaw.likelihood import NotPositiveError
from commonlaw.solvers import AbstractSolver
from commonlaw.spacing import evenly_spaced

_OBJECTS = 20
"""Objects whose trajectories are followed at most, evenly spread."""

_FITTED = 4
"""Supports of largest linearised evidence that are fitted under each kind of errors, with levels of their own."""


@unannounced()
def candidates(found: Sequence[Hypothesis], others: Sequence[Bools], solver: AbstractSolver) -> list[Hypothesis]:
    """Return the supports that were found under any kind of errors under each: those of largest evidence there."""
    most = found[0].problem.most_terms
    listed = [*(each for own in found for each in own.pool(solver)), *others]
    pool = list({each.tobytes(): each for each in listed if each.sum(axis=1).max() <= most}.values())
    compared = []
    for hypothesis in found:
        values = evidence_of(hypothesis.problem, hypothesis.state, pool)
        for i in np.argsort(values)[:_FITTED]:
            with suppress(CommonlawError, NotPositiveError):
                fitted = hypothesis.fit(pool[i])
                compared.append(replace(hypothesis, problem=fitted[0], state=fitted[1]))
    return compared


def chosen(compared: Sequence[Hypothesis]) -> Hypothesis:
    """Return the hypothesis of largest evidence whose solutions exist along the trials that it was learned from."""
    listed = sorted(compared, key=lambda each: each.state.value)
    return next((each for each in listed if not runs_away(each.problem, each.state)), listed[0])


@unannounced()
def runs_away(problem: SearchProblem, state: SearchState) -> bool:
    """Whether a trajectory of a trial that the law was learned from diverges there, from its fitted start."""
    found, between = [], problem.trials.schema.input_between
    for i in evenly_spaced(len(problem.models), _OBJECTS):
        model, estimate = problem.models[i], state.estimates[i]
        for mesh, states in zip(model.meshes, estimate.states, strict=True):
            cuts = [0, *(np.flatnonzero(~mesh.contiguous) + 1).tolist(), len(mesh)]
            for first, last in pairwise(cuts):
                times = mesh.times[first:last]
                field = replace(
                    model.field(estimate.coefficients), inputs=Inputs.of(times, mesh.inputs[first:last], between)
                )
                found.append(InitialValueProblem(field, states[first, : model.width], times, ""))
    return any(each.outcome for each in simulate(found, tolerance=1e-6))
