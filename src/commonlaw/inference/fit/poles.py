"""Whether a law has a pole where trials have been, or between."""

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.inference.fit.parameter_values import divisors
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.state import SearchState
from commonlaw.library.grammar import NUMPY, compiled
from commonlaw.likelihood import Estimate

_BETWEEN = 400
"""Points between states of an object where a divisor must not have another sign."""


def has_poles(problem: SearchProblem, state: SearchState) -> bool:
    """Return whether something that terms are divided by, with constants in it, vanishes at states or between them."""
    return any(has_pole(problem, i, each) for i, each in enumerate(state.estimates))


def has_pole(problem: SearchProblem, index: int, estimate: Estimate) -> bool:
    """Return whether something vanishes that terms are divided by, at states of an object or between them."""
    if not (codes := divisors(problem.models[index].terms)):
        return False
    values = with_points_between(values_along(problem, index, estimate))
    columns = problem.models[index].terms.at(values, estimate.coefficients).T
    with np.errstate(all="ignore"):
        return any(np.ptp(np.sign(compiled(code)(columns, NUMPY))) != 0 for code in codes)


def values_along(problem: SearchProblem, index: int, estimate: Estimate) -> Floats:
    """Return the variables along the estimated states of an object, shape (n, variables)."""
    model = problem.models[index]
    states = np.concatenate([each[:, : model.width] for each in estimate.states])
    inputs, times = (np.concatenate([getattr(mesh, name) for mesh in model.meshes]) for name in ("inputs", "times"))
    return model.terms.variables.natural(np.column_stack([states, inputs, times]))


def with_points_between(values: Floats) -> Floats:
    """Return points, shape (n, variables), with others on the straight lines between some of them."""
    generator = np.random.default_rng(0)
    first, last = generator.integers(len(values), size=(2, _BETWEEN))
    share = generator.uniform(size=(_BETWEEN, 1))
    return np.concatenate([values, share * values[first] + (1 - share) * values[last]])
