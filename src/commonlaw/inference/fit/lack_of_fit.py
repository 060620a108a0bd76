"""Whether white noise of the estimated level explains the residuals of a law."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.inference.data.noise import noise_floor
from commonlaw.inference.fit.heteroscedasticity import growth
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.settings import MAX_STANDARDIZED_RESIDUAL
from commonlaw.likelihood import Estimate


@dataclass(frozen=True)
class Departure:
    """Something in which residuals depart from white noise of the estimated level, in words.

    Heteroscedastic residuals are a matter of the noise; whatever else departs is lack of fit.
    """

    words: str
    is_of_noise: bool = False


NO_LAW = Departure("lack of fit: no law of this library fits the measurements within their noise")
"""Of a law with a model error."""


def departures(problem: SearchProblem, estimates: Sequence[Estimate]) -> tuple[Departure, ...]:
    """Return in what the residuals of a law depart from white noise.

    They are heteroscedastic or autocorrelated, if an error that allows for it gains more in likelihood than its numbers
    cost.
    """
    # At the floor, what is left is not of the measurements
    measured = problem.noise > 1.001 * noise_floor(problem.trials)
    return tuple(
        Departure(f"residuals of {name} are {each.words}", each.is_of_noise)
        for j, name in enumerate(problem.trials.schema.states)
        if name not in problem.trials.schema.starts
        for each in _of_state(problem, estimates, j, bool(measured[j]))
    )


def in_words(listed: Iterable[Departure]) -> str:
    """Return departures in words; nothing if there are none."""
    return "; ".join(each.words for each in listed)


def _of_state(problem: SearchProblem, estimates: Sequence[Estimate], j: int, is_measured: bool) -> list[Departure]:
    """Return what is odd about the residuals of one state, and about their pattern if they are of measurements."""
    squares, sizes, lags, count, whole = [], [], [], 0, 0
    for model, estimate in zip(problem.models, estimates, strict=True):
        for mesh, states in zip(model.meshes, estimate.states, strict=True):
            segments = np.concatenate([[0], np.cumsum(~mesh.contiguous)])
            seen = (mesh.observed & ~mesh.still)[:, j]
            standard = (model.residuals(mesh, states) / problem.std_of(mesh))[seen, j]
            usual = np.abs(standard) <= MAX_STANDARDIZED_RESIDUAL
            whole += len(usual)
            seen[seen], standard = usual, standard[usual]
            squares.append(standard**2)
            sizes.append(np.abs(states[seen, j]))
            lags.append((standard[1:] * standard[:-1])[np.diff(segments[seen]) == 0])
            count += len(standard)
    if 2 * count < whole:
        return [Departure(f"mostly more than {MAX_STANDARDIZED_RESIDUAL:g} standard deviations of its noise")]
    if not is_measured:
        return []
    squared, found, price = np.concatenate(squares), [], np.log(max(count, 2))
    schema = problem.trials.schema
    if schema.states[j] not in schema.logarithmic and growth(squared, np.concatenate(sizes))[0] > price:
        found.append(Departure("heteroscedastic", is_of_noise=True))
    pairs = np.concatenate(lags)
    memory = float(np.clip(pairs.mean() / squared.mean(), -0.99, 0.99)) if len(pairs) > 1 and squared.any() else 0.0
    if memory > 0 and -len(pairs) * np.log1p(-(memory**2)) > 2 * price:
        found.append(Departure("autocorrelated"))
    return found
