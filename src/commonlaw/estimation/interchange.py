"""Equal maxima of a likelihood: parameters that change places, as absorption and elimination do (flip-flop).

After a single dose D the amount of a depot falls with the rate ka, and the concentration
``D/V ka/(ka - k) (exp(-k t) - exp(-ka t))`` is the same with ka and k exchanged and the volume V k/ka (Gibaldi and
Perrier 1982, Pharmacokinetics).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.estimation.model import Model
from commonlaw.estimation.problem import Problem
from commonlaw.estimation.search import Bounds, Objective, Optimum, minimum, summarized
from commonlaw.library.grammar import columns_in

_EQUAL = 0.02
"""Twice the log-likelihood ratio of equal maxima: what is left of it after rounding."""
_HOPELESS = 10.0
"""Twice the log-likelihood ratio beyond which a search from exchanged parameters, the others fitted, is given up."""


@dataclass(frozen=True, eq=False)
class EqualMaximum:
    """Another maximum of the same likelihood: some objects, and what their parameters are there."""

    objects: tuple[str, ...]
    parameters: dict[str, float]

    def __str__(self) -> str:
        values = ", ".join(f"{name} = {value:.3g}" for name, value in self.parameters.items())
        return f"{', '.join(self.objects[:3])}: {values}"


def with_fastest_latent_states(
    problem: Problem, optimum: Optimum, bounds: Bounds
) -> tuple[Optimum, tuple[EqualMaximum, ...]]:
    """Return the optimum whose latent states change fastest among equal ones, and the others.

    From each pair of exchanged parameters of an object, or of objects that share some, the likelihood is maximized
    again, first over the other unknowns, then over all. Maxima outside of the bounds do not count, and the largest one
    is taken where priors or measurements tell them apart. The rate of latent states, which no observable depends on, is
    ``sum_j mean |df_j/dx_j|`` over the samples; where it is the same, the first parameter is the largest.
    """
    model, unknowns, others = problem.model, optimum.unknowns, list[EqualMaximum]()
    outputs = [output.removeprefix("+") for output in model.expressions[model.width :]]
    # States that were measured themselves leave no parameter to exchange
    if problem.events_move or all(f"v{j}" in outputs for j in range(len(model.schema.states))):
        return optimum, ()
    unknowns = unknowns.copy()
    for indices, part in problem.apart():
        free = ~optimum.at_bound[indices]
        maxima = _maxima(part, optimum.unknowns[indices], optimum.noise, bounds.of(indices), free)
        chosen = max(maxima, key=partial(_speed, part))
        unknowns[indices] = chosen
        owners = tuple(dict.fromkeys(data.trial.object for data in part.trials))
        for maximum in maxima:
            moved = np.abs(maximum - chosen) > 0.01 * np.abs(chosen)
            if maximum is not chosen:
                at = part.trials[0].parameter
                named = zip(model.parameters, at.tolist(), strict=True)
                others.append(
                    EqualMaximum(owners, {name: float(maximum[k]) for name, k in named if k >= 0 and moved[k]})
                )
    if np.array_equal(unknowns, optimum.unknowns):
        return optimum, tuple(others)
    return summarized(problem, unknowns, optimum.noise, bounds, optimum.starts_alike), tuple(others)


def latent_states(model: Model) -> list[int]:
    """Return the states and rates, by index, that no observable depends on."""
    seen = {column for output in model.expressions[model.width :] for column in columns_in(output)}
    return [j for j in range(model.width) if j not in seen]


def _maxima(problem: Problem, unknowns: Floats, noise: Floats, bounds: Bounds, free: Bools) -> list[Floats]:
    """Return the unknowns of equal maxima: the optimum, or larger ones, and those from exchanged parameters."""
    objective = Objective(problem, noise)
    coarse = Objective(replace(problem, tolerance=1e-6), noise)
    residuals = objective.residuals(unknowns)
    maxima = [(float(residuals @ residuals), unknowns)]
    for start, exchanged in _exchanges(problem, unknowns, free):
        held = free & ~exchanged & (start != 0)
        point, squares = minimum(coarse, start, held, scale=start, tolerance=1e-6, steps=30)
        if squares > maxima[0][0] + _HOPELESS:
            continue
        point, squares = minimum(objective, point, free & (point != 0), scale=point, tolerance=1e-13, steps=200)
        within = np.all((point > bounds.low) & (point < bounds.high) | ~free)
        is_new = all(np.any(np.abs(point - known) > 0.01 * np.abs(known)) for _, known in maxima)
        if within and is_new and np.isfinite(squares):
            maxima.append((squares, point))
    least = min(squares for squares, _ in maxima)
    return [point for squares, point in maxima if squares <= least + _EQUAL]


def _exchanges(problem: Problem, unknowns: Floats, free: Bools) -> Iterator[tuple[Floats, Bools]]:
    """Yield unknowns in which two parameters of all trials changed places, and which these are."""
    parameters = np.array([data.parameter for data in problem.trials])
    for i, j in combinations(range(parameters.shape[1]), 2):
        pairs = np.unique(parameters[:, [i, j]], axis=0)
        one, two = pairs.T
        if (pairs < 0).any() or not free[pairs].all() or len({*pairs.ravel().tolist()}) < pairs.size:
            continue
        values = unknowns[pairs]
        if (values[:, 0] * values[:, 1] <= 0).any():
            continue
        start = unknowns.copy()
        start[one], start[two] = unknowns[two], unknowns[one]
        yield start, np.isin(np.arange(len(unknowns)), pairs)


def _speed(problem: Problem, unknowns: Floats) -> tuple[float, float]:
    """Return the mean rate of latent states, to a few digits, and the first parameter."""
    model, latent, total = problem.model, latent_states(problem.model), 0.0
    for data in problem.trials:
        states, parameters = problem.predicted(data, unknowns, False).states, data.parameters(unknowns)
        times = data.times[data.rows]
        point = model.point(states, data.inputs.at(times, parameters), times, parameters)
        total += float(np.abs(model.rates.jacobian(point)[:, latent, latent]).mean(axis=0).sum())
    first = problem.trials[0].parameter
    return float(f"{total:.4g}"), float(np.append(unknowns, 0.0)[first[:1]].sum())
