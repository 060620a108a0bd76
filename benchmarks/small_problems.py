"""Small problems drawn at random: a law, few objects, few noisy samples, and how surely the terms could be known.

A draw is kept if its trajectories stay bounded and if the Cramer-Rao bound says of every coefficient what the kind of
problem asks for: with its terms given, a strong term is known to an eighth of itself by all objects together, a weak
one to a sixth to a half.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np
from numpy.typing import NDArray

import commonlaw as cl
from benchmarks.variational import Equations, Run, cramer_rao, solve

Floats = NDArray[np.float64]

STRONG = 8.0
"""Least size of a strong coefficient in units of its bound, all objects taken together."""

WEAK = (2.0, 6.0)
"""Sizes of a weak one."""

SCATTER = 0.3
"""Of coefficients over objects, relative to them, where objects scatter."""

NOISE = (0.01, 0.15)
SAMPLES = (12, 30)
OBJECTS = (2, 4)
_BOUND = 10.0
"""States of a trajectory that is kept stay below; they begin near one."""

_STEPS = 400


@dataclass(frozen=True)
class Shape:
    """States and library of a problem: the variables that terms are made of, and how the library is called."""

    variables: tuple[str, ...]
    equations: tuple[str, ...]
    library: str
    terms: tuple[str, ...]

    @property
    def order(self) -> int:
        """Of the law: 2 where some variables are rates of others."""
        return len(self.variables) // len(self.equations)

    @property
    def states(self) -> tuple[str, ...]:
        """What is measured."""
        return self.variables[: len(self.equations)]


SHAPES = (
    Shape(("x",), ("x'",), "poly:3", ("1", "x", "x^2", "x^3")),
    Shape(("x", "v"), ("x''",), "poly:2", ("1", "x", "v", "x^2", "x v", "v^2")),
    Shape(("x", "y"), ("x'", "y'"), "poly:2", ("1", "x", "y", "x^2", "x y", "y^2")),
)


@dataclass(frozen=True)
class Kind:
    """What is hard about a problem."""

    name: str
    objects: tuple[int, int]
    scatter: float
    weak: bool


KINDS = (
    Kind("one object", (1, 1), 0.0, False),
    Kind("objects alike", OBJECTS, 0.0, False),
    Kind("objects that scatter", OBJECTS, SCATTER, False),
    Kind("a weak term", (1, OBJECTS[1]), 0.0, True),
)


@dataclass(frozen=True, eq=False)
class SmallProblem:
    """Trials of a law that is known.

    Parameters
    ----------
    coefficients
        Of the true terms, equation by equation, shape (objects, parameters).
    noise
        Standard deviation of each state, relative to that of its values.
    """

    kind: Kind
    seed: int
    shape: Shape
    support: Equations
    coefficients: Floats
    noise: float
    trials: cl.Trials

    @property
    def truth(self) -> Mapping[tuple[str, str], Floats]:
        """The coefficients of every equation's true terms, shape (objects,)."""
        pairs = [
            (equation, term) for equation, own in zip(self.shape.equations, self.support, strict=True) for term in own
        ]
        return dict(zip(pairs, self.coefficients.T, strict=True))


def draw(kind: Kind, seed: int) -> SmallProblem:
    """Return the problem of a seed: the first of its draws that is kept."""
    for attempt in count():
        found = _attempt(kind, seed, np.random.default_rng([seed, attempt, *kind.name.encode()]))
        if found is not None:
            return found
    raise AssertionError


def _attempt(kind: Kind, seed: int, generator: np.random.Generator) -> SmallProblem | None:
    shape = SHAPES[generator.integers(len(SHAPES))]
    support = tuple(_terms(shape, generator) for _ in shape.equations)
    size = sum(map(len, support))
    objects, trials = generator.integers(*kind.objects, endpoint=True), generator.integers(1, 2, endpoint=True)
    samples, noise = generator.integers(*SAMPLES, endpoint=True), float(np.exp(generator.uniform(*np.log(NOISE))))
    typical = generator.choice((-1.0, 1.0), size) * np.exp(generator.normal(0.0, 0.7, size))
    coefficients = typical * np.exp(kind.scatter * generator.standard_normal((objects, size)))
    times = np.linspace(0.0, generator.uniform(2.0, 8.0), samples)
    starts = generator.normal(0.0, 1.0, (objects, trials, len(shape.variables)))
    runs = [_runs(shape, support, *each, times) for each in zip(coefficients, starts, strict=True)]
    if not all(runs):
        return None
    spread = np.concatenate([run.states[:, : len(shape.states)] for own in runs for run in own]).std(axis=0)
    sigma = noise * spread
    if not _kept(kind, coefficients, runs, sigma):
        return None
    measured = [[_measured(run, sigma, generator) for run in own] for own in runs]
    return SmallProblem(kind, seed, shape, support, coefficients, noise, _trials(shape, times, measured))


def _terms(shape: Shape, generator: np.random.Generator) -> tuple[str, ...]:
    """Return one to three terms of an equation, those of the library equally probable."""
    chosen = generator.choice(len(shape.terms), generator.integers(1, 3, endpoint=True), replace=False)
    return tuple(shape.terms[i] for i in sorted(chosen))


def _runs(shape: Shape, support: Equations, coefficients: Floats, starts: Floats, times: Floats) -> list[Run]:
    """Return the trajectories of an object's trials; none if one of them leaves the bound."""
    if _bounded(shape, support, coefficients, starts, float(times[-1])):
        return [solve(shape.variables, support, coefficients, start, times) for start in starts]
    return []


def _bounded(shape: Shape, support: Equations, coefficients: Floats, starts: Floats, end: float) -> bool:
    """Whether trajectories stay below the bound, by the Runge-Kutta method of fourth order with many steps."""
    powers = [np.array([_powers(term, shape.variables) for term in own]) for own in support]
    parts = np.split(coefficients, np.cumsum([len(own) for own in support])[:-1])
    pairs = list(zip(powers, parts, strict=True))

    def field(states: Floats) -> Floats:
        given = [np.prod(states[:, np.newaxis] ** own, axis=2) @ each for own, each in pairs]
        return np.column_stack([states[:, len(pairs) :], *given])

    states, step = starts, end / _STEPS
    for _ in range(_STEPS):
        first = field(states)
        second = field(states + step / 2 * first)
        third = field(states + step / 2 * second)
        states = states + step / 6 * (first + 2 * second + 2 * third + field(states + step * third))
        if not np.all(np.abs(states) < _BOUND):
            return False
    return True


def _powers(term: str, variables: Sequence[str]) -> list[int]:
    factors = {name: int(power or 1) for name, _, power in (each.partition("^") for each in term.split())}
    return [factors.get(name, 0) for name in variables]


def _kept(kind: Kind, coefficients: Floats, runs: Sequence[Sequence[Run]], sigma: Floats) -> bool:
    """Whether the coefficients are as well known as the kind asks for, by the Cramer-Rao bounds of all objects."""
    if not np.all(sigma > 0):
        return False
    try:
        bounds = np.array([cramer_rao(run, sigma) for run in runs])
    except np.linalg.LinAlgError:
        return False
    told = np.sort(np.sqrt(np.sum((coefficients / bounds) ** 2, axis=0)))
    weak, strong = (told[:1], told[1:]) if kind.weak else (told[:0], told)
    low, high = WEAK
    return bool(np.all(strong >= STRONG) and np.all((weak >= low) & (weak <= high)))


def _measured(run: Run, sigma: Floats, generator: np.random.Generator) -> Floats:
    clean = run.states[:, : len(sigma)]
    return np.asarray(clean + sigma * generator.standard_normal(clean.shape))


def _trials(shape: Shape, times: Floats, measured: Sequence[Sequence[Floats]]) -> cl.Trials:
    names, states = zip(*((f"object {i + 1}", each) for i, own in enumerate(measured) for each in own), strict=True)
    return cl.Trials.from_arrays([times] * len(states), list(states), object=list(names), names=list(shape.states))
