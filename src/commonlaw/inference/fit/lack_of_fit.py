"""Whether errors of the measurements of the estimated levels explain what a law leaves of the measurements."""

import numpy as np

from commonlaw.inference.data.noise import noise_floor
from commonlaw.inference.fit.heteroscedasticity import OUTLIER, growth
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.state import SearchState


def unexplained(problem: SearchProblem, state: SearchState, *, of_law: bool = False) -> str:
    """Return what speaks against white noise of the estimated level, in words; nothing if that explains the residuals.

    A model error does; and residuals that grow with the state, or that remember each other, if an error that allows for
    it gains more in likelihood than its numbers cost. Residuals that only grow with the state are heteroscedastic
    noise, and no lack of fit `of_law`.
    """
    if state.has_model_error:
        return "the measurements depart from every law of this library by more than their noise"
    # At the floor, what is left is not of the measurements
    measured = problem.noise > 1.001 * noise_floor(problem.trials)
    return "; ".join(
        f"residuals of {name} {what}"
        for j, name in enumerate(problem.trials.schema.states)
        if name not in problem.trials.schema.starts
        for what in _of_state(problem, state, j, bool(measured[j]), of_law)
    )


def _of_state(problem: SearchProblem, state: SearchState, j: int, is_measured: bool, of_law: bool) -> list[str]:
    """Return what is odd about the residuals of one state, and about their pattern if they are of measurements."""
    squares, sizes, lags, count, whole = [], [], [], 0, 0
    for model, estimate in zip(problem.models, state.estimates, strict=True):
        for mesh, states in zip(model.meshes, estimate.states, strict=True):
            segments = np.concatenate([[0], np.cumsum(~mesh.contiguous)])
            seen = (mesh.observed & ~mesh.still)[:, j]
            standard = (model.residuals(mesh, states) / problem.std_of(mesh))[seen, j]
            usual = np.abs(standard) <= OUTLIER
            whole += len(usual)
            seen[seen], standard = usual, standard[usual]
            squares.append(standard**2)
            sizes.append(np.abs(states[seen, j]))
            lags.append((standard[1:] * standard[:-1])[np.diff(segments[seen]) == 0])
            count += len(standard)
    if 2 * count < whole:
        return [f"are mostly more than {OUTLIER:g} standard deviations of its noise"]
    if not is_measured:
        return []
    squared, found, price = np.concatenate(squares), [], np.log(max(count, 2))
    schema = problem.trials.schema
    may_grow = not of_law and schema.states[j] not in schema.logarithmic
    if may_grow and growth(squared, np.concatenate(sizes))[0] > price:
        found.append("grow with it")
    pairs = np.concatenate(lags)
    memory = float(np.clip(pairs.mean() / squared.mean(), -0.99, 0.99)) if len(pairs) > 1 and squared.any() else 0.0
    if memory > 0 and -len(pairs) * np.log1p(-(memory**2)) > 2 * price:
        found.append("remember each other")
    return found
