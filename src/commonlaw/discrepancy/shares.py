"""What the misfit of a law is made of: noise, coefficients, the function that objects share, each trial's own."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.discrepancy.trajectories import FunctionFit
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.settings import FINAL_MODEL_ERRORS, MODEL_ERRORS
from commonlaw.likelihood import fit


def shares(
    problem: SearchProblem,
    given: Floats,
    alone: Sequence[FunctionFit],
    shared: Sequence[FunctionFit],
    chosen: FunctionFit,
) -> Mapping[str, float]:
    """Return how the sum of squares that a law leaves, in units of the noise, falls step by step, as shares of it.

    Trajectories of the law with its coefficients as given, which has the shape (objects, equations, terms); with the
    best ones; with the function; with a model error, if one was chosen. What is left is noise.
    """
    steps = [_deviance(problem, given, alone[-1]), _without_error(alone), _without_error(shared), chosen.deviance]
    falling = np.minimum.accumulate(steps)
    parts = dict(zip(("coefficients", "shared discrepancy", "trial"), -np.diff(falling), strict=True))
    return {name: float(each / falling[0]) for name, each in (parts | {"noise": falling[-1]}).items()}


def _without_error(found: Sequence[FunctionFit]) -> float:
    return min(each.deviance for each in found if each is found[-1] or not each.has_model_error)


def _deviance(problem: SearchProblem, given: Floats, alone: FunctionFit) -> float:
    """Return what measurements are off the law's own trajectories, initial states being free."""
    found, none = 0.0, np.zeros_like(alone.model.own)
    for model, start, own in zip(problem.models, problem.starts, given, strict=True):
        first = replace(start, coefficients=own)
        found += fit(model, first, none, (*MODEL_ERRORS, *FINAL_MODEL_ERRORS)).deviance
    return found
