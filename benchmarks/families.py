"""Grouped experiments with known laws: one structure, several objects with coefficients of their own."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

import commonlaw as cl
from benchmarks.variational import Equations, Run, cramer_rao, solve

Floats = NDArray[np.float64]
Draw = Callable[[np.random.Generator], list[float]]


@dataclass(frozen=True)
class Family:
    """A structure, and how an object's coefficients and starts are drawn.

    Parameters
    ----------
    variables
        The states; of a law of second order, whose states alone are measured, with their rates after them.
    equations
        The terms of each equation.
    coefficients
        Draws those of an object, equation by equation.
    start
        Draws where a trial begins.
    end, samples
        Of a trial, which begins at time 0.
    library
        Candidate terms.
    """

    variables: tuple[str, ...]
    equations: Equations
    coefficients: Draw
    start: Draw
    end: float
    samples: int
    library: str = "poly:3"

    @property
    def order(self) -> int:
        """Of the law."""
        return len(self.variables) // len(self.equations)

    @property
    def times(self) -> Floats:
        """When every trial is sampled."""
        return np.linspace(0, self.end, self.samples)


@dataclass(frozen=True, eq=False)
class Experiment:
    """Objects of a family, and their trials without noise.

    Parameters
    ----------
    family
        Their structure.
    coefficients
        Shape (objects, parameters).
    runs
        The trials of each object.
    """

    family: Family
    coefficients: Floats
    runs: tuple[tuple[Run, ...], ...]

    def noise(self, level: float) -> Floats:
        """Return the standard deviation of the noise: the level times each measured state's, its mean over trials."""
        return np.asarray(level * np.mean([each.std(axis=0) for each in self.clean()], axis=0))

    def bounds(self, level: float) -> Floats:
        """Return the Cramer-Rao bound of each coefficient's standard deviation, shape (objects, parameters)."""
        return np.stack([cramer_rao(runs, self.noise(level)) for runs in self.runs])

    def measured(self, level: float, seed: int) -> cl.Trials:
        """Return the trials with white noise."""
        generator, noise = np.random.default_rng([seed, round(1e6 * level)]), self.noise(level)
        return self.trials([clean + noise * generator.standard_normal(clean.shape) for clean in self.clean()])

    def clean(self) -> list[Floats]:
        """Return the measured states of every trial without noise, each of shape (n, d), object by object."""
        return [run.states[:, : len(self.family.equations)] for runs in self.runs for run in runs]

    def trials(self, states: Sequence[Floats]) -> cl.Trials:
        """Return the trials with these measured states, in the order of `clean`."""
        objects = [f"object {i + 1}" for i, runs in enumerate(self.runs) for _ in runs]
        names = self.family.variables[: len(self.family.equations)]
        return cl.Trials.from_arrays([self.family.times] * len(states), states, object=objects, names=names)

    def discover(self, trials: cl.Trials) -> cl.Law:
        """Return what commonlaw finds with nothing given but the order and the library."""
        return cl.discover(trials, order=self.family.order, library=self.family.library)

    def estimates(self, law: cl.Law) -> Floats | None:
        """Return the coefficients as those here are ordered; nothing if an object's support is not the true one."""
        indices = self._places(law)
        support = np.zeros(law.support.shape, dtype=bool)
        support[tuple(indices.T)] = True
        if not np.all((law.coefficients != 0) == support):
            return None
        return np.asarray(law.coefficients[:, indices[:, 0], indices[:, 1]])

    def errors(self, law: cl.Law) -> Floats:
        """Return the standard errors of a law of the true support, as the coefficients here are ordered."""
        assert law.uncertainty.covariance is not None
        listed = [tuple(index) for index in np.argwhere(law.support)]
        order = [listed.index(tuple(index)) for index in self._places(law)]
        return np.asarray(np.sqrt(law.uncertainty.covariance[:, order, order]))

    def _places(self, law: cl.Law) -> NDArray[np.int_]:
        """Return equation and term of each coefficient, shape (parameters, 2)."""
        equations = enumerate(self.family.equations)
        return np.array([(j, law.terms.index(term)) for j, equation in equations for term in equation])


@cache
def experiment(name: str, objects: int = 5, trials: int = 2) -> Experiment:
    """Return objects of a family, always the same."""
    family, generator = FAMILIES[name], np.random.default_rng(list(name.encode()))
    coefficients = np.array([family.coefficients(generator) for _ in range(objects)])
    runs = tuple(
        tuple(
            solve(family.variables, family.equations, coefficient, np.array(family.start(generator)), family.times)
            for _ in range(trials)
        )
        for coefficient in coefficients
    )
    return Experiment(family, coefficients, runs)


def _uniform(*ranges: tuple[float, float]) -> Draw:
    low, high = np.transpose(ranges)
    return lambda generator: generator.uniform(low, high).tolist()


def _brusselator(generator: np.random.Generator) -> list[float]:
    feed, turn = generator.uniform([0.8, 1.7], [1.2, 2.8]).tolist()
    return [feed, -(turn + 1), 1.0, turn, -1.0]


FAMILIES: Mapping[str, Family] = {
    "pendulum": Family(
        ("x", "y"),
        (("y",), ("y", "sin(x)")),
        _uniform((1, 1), (-0.4, -0.05), (-3, -0.8)),
        _uniform((1, 2.5), (-0.5, 0.5)),
        end=12.0,
        samples=150,
        library="poly:2 + fourier:1",
    ),
    "Lotka-Volterra": Family(
        ("x", "y"),
        (("x", "x y"), ("y", "x y")),
        _uniform((0.7, 1.5), (-1.4, -0.6), (-1.5, -0.7), (0.4, 1.2)),
        _uniform((0.6, 2.5), (0.4, 2)),
        end=12.0,
        samples=150,
    ),
    "heights of balls": Family(
        ("x", "v"),
        (("1", "v"),),
        _uniform((-9.8, -9.8), (-0.7, -0.1)),
        _uniform((46, 49), (-0.5, 0.5)),
        end=3.2,
        samples=49,
    ),
    "Van der Pol": Family(
        ("x", "y"),
        (("y",), ("x", "y", "x^2 y")),
        _uniform((1, 1), (-1.6, -0.6), (0.5, 2), (-2, -0.5)),
        _uniform((-2.5, 2.5), (-2.5, 2.5)),
        end=14.0,
        samples=150,
    ),
    "Brusselator": Family(
        ("x", "y"),
        (("1", "x", "x^2 y"), ("x", "x^2 y")),
        _brusselator,
        _uniform((0.5, 2.5), (0.8, 3)),
        end=14.0,
        samples=150,
    ),
    "Lorenz": Family(
        ("x", "y", "z"),
        (("x", "y"), ("x", "y", "x z"), ("z", "x y")),
        _uniform((-12, -8), (8, 12), (24, 35), (-1, -1), (-1, -1), (-3.2, -2.2), (1, 1)),
        _uniform((-10, 10), (-10, 10), (15, 30)),
        end=6.0,
        samples=300,
        library="poly:2",
    ),
}
