"""Iteratively reweighted least squares: the weak form's coefficients and weights, each by the other."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.formulation.least_squares_problem import LeastSquaresProblem, merge
from commonlaw.formulation.weak import WeakForm
from commonlaw.formulation.weak_rows import WeakRows
from commonlaw.library import Terms
from commonlaw.trials import Trials

_CONVERGED = 1e-6
"""Relative change of a fit below which reweighting ends; the steps after it would change no digit that noise leaves."""


_SWEEPS = 30
"""How many there are at most."""


def reweight(trials: Trials, terms: Terms, form: WeakForm) -> tuple[WeakForm, dict[str, Floats]]:
    """Return the form with coefficients that fit the rows that these same coefficients whiten, and the coefficients.

    Each sweep is generalised least squares with the covariance at the coefficients before it, for each equation its
    own; the first is ordinary least squares. Iteratively reweighted least squares so converges in a handful of sweeps.

    Parameters
    ----------
    trials
        Their objects have coefficients of their own.
    terms
        The library.
    form
        How rows are made; its own coefficients are not used.

    Raises
    ------
    CommonlawError
        If a trial cannot be used; the message names it.
    """
    states = len(trials.schema.states)
    found = {
        name: _coefficients([form.tested(trial, terms) for trial in trials.of_object(name)], states)
        for name in trials.objects
    }
    return replace(form, coefficients=found), found


def _coefficients(tested: Sequence[WeakRows], equations: int) -> Floats:
    """Return the coefficients of one object, shape (equations, terms)."""
    plain = merge(LeastSquaresProblem.of(each.library, each.targets) for each in tested)
    used = np.ones(plain.terms, dtype=np.bool_)
    found = np.array([plain.least_squares(used, j) for j in range(equations)])
    for j in range(equations):
        for _ in range(_SWEEPS):
            problem = merge(LeastSquaresProblem.of(*each.whitened(found, (j,))) for each in tested)
            before, found[j] = found[j].copy(), problem.least_squares(used, j)
            change, size = (np.linalg.norm(problem.norms * each) for each in (found[j] - before, found[j]))
            if change <= _CONVERGED * size:
                break
    return found
