"""Which law, and which errors, where white noise does not explain the measurements: those of largest evidence."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.effort import unannounced
from commonlaw.errors import CommonlawError
from commonlaw.inference.fit.discretization import is_solved
from commonlaw.inference.fit.state import evidence_of
from commonlaw.inference.search.error_models import Hypothesis
from commonlaw.solvers import AbstractSolver

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
            with suppress(CommonlawError):
                fitted = hypothesis.fit(pool[i])
                compared.append(replace(hypothesis, problem=fitted[0], state=fitted[1]))
    return compared


def chosen(compared: Sequence[Hypothesis], needed: float = 0.0) -> Hypothesis:
    """Return the hypothesis of largest evidence whose solutions exist along the trials that it was learned from.

    Errors other than white noise, under which coefficients are those of least squares, need so much evidence (2 log B).
    """
    listed = sorted(compared, key=lambda each: each.state.score.total + (0.0 if each.kind == "white" else needed))
    return next((each for each in listed if is_solved(each.problem, each.state)), listed[0])
