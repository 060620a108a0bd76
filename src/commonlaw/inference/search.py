"""The search for the supports of a law, from many terms to few, while the trajectories become solutions of it.

At each model error the likelihood is linearised about the trajectories and coefficients so far, the supports of largest
evidence are chosen on it, and both are fitted again. Supports and model errors are compared by their evidence: where
the measurements follow a law of the library, the smallest model error wins; where they do not, one wins that is not
negligible, a random walk that pushes the states off their course (weak constraint; Evensen 2009, chapter 7).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.errors import CommonlawError
from commonlaw.inference.search_problem import SearchProblem
    prices = FACTOR * problem.models[0].terms.complexities
    extra = offset(problem, linear, model_error)
    return SupportEvidence(problems, problem.allowed, sum(problem.measured), prices, problem.most_terms, extra)


def offset(problem: SearchProblem, linear: Sequence[Linearization], model_error: float) -> float:
    """Return what is added to minus twice the log-evidence of all supports, for its errors.

    A model error is one more number to be found, at the price of any (BIC), and so is every level of other errors.
    """
    numbers = int(model_error > NEGLIGIBLE) + problem.errors.hyperparameters
    return sum(each.log_determinant for each in linear) + numbers * float(np.log(sum(problem.measured)))


def _restricted(
    problem: SearchProblem, evidence: SupportEvidence, estimates: Sequence[Estimate], supports: Bools
) -> tuple[Estimate, ...]:
    """Return the estimates with the coefficients that the linearised likelihood gives for these supports."""
    coefficients = evidence.coefficients(supports) + np.nan_to_num(problem.known)
    return tuple(replace(each, coefficients=own) for each, own in zip(estimates, coefficients, strict=True))


def fitted(
    problem: SearchProblem, estimates: Sequence[Estimate], supports: Bools, model_error: float
) -> tuple[SearchState, SupportEvidence]:
    """Return the state fitted with these supports at a model error, with none where it is negligible; its evidence."""
    model_errors = FINAL if model_error <= NEGLIGIBLE else (model_error,)
    pairs = zip(problem.models, estimates, strict=True)
    done = tuple(fit(model, estimate, supports, model_errors) for model, estimate in pairs)
    evidence = _evidence(problem, done, model_error)
    return SearchState(supports, done, model_error, evidence.value(supports)), evidence
