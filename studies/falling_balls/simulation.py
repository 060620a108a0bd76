"""Noise on simulated drops, drawn as the authors' program did, and what makes many simulated drops cheap."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from commonlaw.array_types import Bools, Floats
from commonlaw.differentiation import AbstractDifferentiator, Rates, parse_differentiation
from commonlaw.law import Law, average_law
from commonlaw.plots import Figure
from commonlaw.report import Table
from commonlaw.trials import Trial, Trials
from studies.falling_balls.method import group_law, single_law
from studies.falling_balls.plots import plot_heat_maps
from studies.falling_balls.settings import AVERAGE_DIGITS


def simulated(clean: Trials, noises: Sequence[float], seed: int) -> dict[float, Trials]:
    """Return the drops with noise, by its standard deviation in m.

    Standard normals come from NumPy's legacy generator: one draw for each drop, drops outermost and noise levels
    innermost.
    """
    generator = np.random.RandomState(seed)
    noisy: dict[float, list[Trial]] = {noise: [] for noise in noises}
    for trial in clean:
        for noise in noises:
            states = trial.states + noise * generator.standard_normal(trial.states.shape)
            noisy[noise].append(Trial(trial.object, trial.name, trial.times, states, trial.inputs))
    return {noise: clean.with_trials(trials) for noise, trials in noisy.items()}


def learned(drops: Mapping[float, Trials], thresholds: Mapping[str, float]) -> dict[str, dict[float, Law]]:
    """Return the laws of the ``"single"`` and the ``"group"`` method at their thresholds, by noise."""
    return {
        method: {noise: learn(trials, thresholds[method]) for noise, trials in drops.items()}
        for method, learn in (("single", single_law), ("group", group_law))
    }


def mean_coefficients(law: Law) -> dict[str, float]:
    """Return the coefficients that some object has, averaged over all objects, by term."""
    return {
        term: float(value)
        for term, value in zip(law.terms.names, average_law(law).coefficients[0, 0], strict=True)
        if value
    }


def captures(law: Law) -> Bools:
    """Return for which objects a law has a v^2 that slows a falling ball, and nothing but 1 and v beside it."""
    names = law.terms.names
    others = [index for index, name in enumerate(names) if name not in ("1", "v", "v^2")]
    found = law.coefficients[:, 0]
    return np.asarray((found[:, names.index("v^2")] > 0) & ~found[:, others].any(axis=1))


@dataclass(frozen=True, eq=False)
class OnGrid(AbstractDifferentiator):
    """A linear method on one grid of times, as matrices: drops by the thousand are differentiated at little cost.

    Parameters
    ----------
    method
        Gives each rate as a weighted sum of the states.
    smoothing, slopes
        The weights of the smoothed states, and of the first and second derivatives, each of shape (n, n).
    """

    method: AbstractDifferentiator
    smoothing: Floats
    slopes: tuple[Floats, ...]

    def reach(self, order: int) -> int | None:
        return self.method.reach(order)

    def differentiate(self, times: Floats, states: Floats, order: int) -> Rates:
        return Rates(self.smoothing @ states, tuple(weights @ states for weights in self.slopes[:order]))


def on_grid(differentiation: str, times: Floats) -> OnGrid:
    """Return the method that a text names, for trials at these times only."""
    method = parse_differentiation(differentiation)
    weights = method.differentiate(times, np.eye(len(times)), 2)
    return OnGrid(method, weights.states, weights.derivatives)


def agrees(
    found: Mapping[float, Mapping[str, float]], reference: Sequence[Mapping[str, float]], units: float = 0.5
) -> bool:
    """Return whether averages by noise have the terms of the reference, and differ by few units of its last digit."""
    return all(
        own.keys() == known.keys()
        and all(abs(own[term] - known[term]) * 10**AVERAGE_DIGITS <= 1.01 * units for term in own)
        for own, known in zip(found.values(), reference, strict=True)
    )


def averages_table(
    name: str, caption: str, found: Mapping[float, Mapping[str, float]], reference: Sequence[Mapping[str, float]]
) -> Table:
    """Return averages by noise beside those of the authors' program, as text with all decimals."""
    terms = list(dict.fromkeys(term for each in reference for term in each))
    rows = [
        {"noise (m)": noise}
        | {
            f"{term}, {whose}": f"{each[term]:.{AVERAGE_DIGITS}f}" if term in each else None
            for term in terms
            for whose, each in (("program", known), ("found", own))
        }
        for (noise, own), known in zip(found.items(), reference, strict=True)
    ]
    return Table(name, caption, pd.DataFrame(rows))


def by_noise(values: Mapping[float, Any]) -> dict[str, Any]:
    """Return values by noise as text, for the results."""
    return {f"{noise:g}": value for noise, value in values.items()}


def heat_maps(laws: Mapping[str, Mapping[float, Law]]) -> Figure:
    """Draw laws as a grid: a row for each title, a column for each noise."""
    flat = {f"{title}, noise {noise:g} m": law for title, row in laws.items() for noise, law in row.items()}
    return plot_heat_maps(flat, len(next(iter(laws.values()))), row_titles=list(laws))


def equation(law: Law, digits: int = 3) -> str:
    """Return the equation of a law, averaged over its objects, as text."""
    (text,) = average_law(law).equations(digits=digits)
    return text.replace("-", "−").replace("^2", "²").replace("^3", "³")


def listed(names: Sequence[str]) -> str:
    """Return names with commas between them, and an "and".

    >>> listed(["1", "v", "v^2"])
    '1, v and v^2'
    """
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)
