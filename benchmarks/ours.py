"""How commonlaw solves the problems. Each function prepares, and returns what is to be timed."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

import commonlaw as cl
from benchmarks.problem import Problem
from commonlaw.formulation import LeastSquaresProblem, law_variables, merge, redrawn
from commonlaw.library import Terms

Floats = NDArray[np.float64]
Run = Callable[[], Floats]

SEGMENTS = 100
"""Segments of time that are drawn as a whole by the bootstrap of blocks."""


def fit(problem: Problem) -> Run:
    """One law at one threshold, from arrays."""
    return lambda: _discovered(_trials(problem), problem)


def thresholds(problem: Problem) -> Run:
    """Laws at many thresholds: compressed once, solved at each."""

    def run() -> Floats:
        form, terms, trials = _compressing(problem)
        systems = [merge(system for trial in trials for system in form.problems(trial, terms))]
        return np.stack([_solved(systems, threshold) for threshold in problem.thresholds])

    return run


def path(problem: Problem) -> Run:
    """Laws at all thresholds there are, by exact breakpoints; returned at the thresholds that are asked for."""

    def run() -> Floats:
        form, terms, trials = _compressing(problem)
        systems = [merge(system for trial in trials for system in form.problems(trial, terms))]
        laws = np.zeros((len(problem.thresholds), problem.states.shape[2], len(terms)))
        for j in range(laws.shape[1]):
            candidates = cl.solvers.STLSQ(shared=False).path(systems, j, np.ones(len(terms), dtype=bool))
            begins = [candidate.hyperparameter for candidate in candidates]
            chosen = np.searchsorted(begins, problem.thresholds, side="right") - 1
            laws[:, j] = [candidates[i].coefficients[0] for i in chosen]
        return laws

    return run


def bootstrap_rows(problem: Problem) -> Run:
    """Bootstrap of samples: a row counts as often as it is drawn."""

    def run() -> Floats:
        form, terms, (trial,) = _compressing(problem)
        library, targets = form.rows(trial, terms)
        generator, counts = np.random.default_rng(0), np.empty((problem.models, len(library)))
        for count in counts:
            count[:] = np.bincount(generator.integers(len(library), size=len(library)), minlength=len(library))
        drawn = (LeastSquaresProblem.of(library, targets, count) for count in counts)
        return np.stack([_solved([system], problem.thresholds[0]) for system in drawn])

    return run


def bootstrap_blocks(problem: Problem) -> Run:
    """Bootstrap of segments of time: their problems count as often as they are drawn."""

    def run() -> Floats:
        form, terms, (trial,) = _compressing(problem)
        parts = form.problems(trial, terms, SEGMENTS)
        generator = np.random.default_rng(0)
        draws = (generator.integers(SEGMENTS, size=SEGMENTS) for _ in range(problem.models))
        counts = np.array([np.bincount(drawn, minlength=SEGMENTS) for drawn in draws], dtype=np.float64)
        return np.stack([_solved([redrawn(parts, count)], problem.thresholds[0]) for count in counts])

    return run


def stream(problem: Problem) -> Run:
    """One law at one threshold, from trials of 10 000 samples that are made while they are gone through."""
    schema, size = _trials(problem, 2).schema, 10_000

    def source() -> Iterator[cl.Trial]:
        for i in range(0, len(problem.times), size):
            yield cl.Trial("object", str(i), problem.times[i : i + size], problem.states[0, i : i + size])

    return lambda: _discovered(cl.TrialStream(schema, source), problem)


def simulate(problem: Problem) -> Run:
    """The trajectory of a law that is given, compilation included."""
    _, terms, trials = _compressing(problem, 1)
    law = cl.Law(terms, trials.schema, 1, trials.objects, problem.law[np.newaxis])
    (name,) = trials.objects
    return lambda: law.simulate(problem.times, problem.states[0, 0])[name].states


def _trials(problem: Problem, samples: int | None = None) -> cl.Trials:
    """Return the trials, or the first few samples of them."""
    times = problem.times[:samples]
    if len(problem.states) == 1:
        return cl.Trials.from_arrays(times, problem.states[0, :samples])
    return cl.Trials.from_arrays([times] * len(problem.states), list(problem.states[:, :samples]))


def _discovered(trials: cl.Trials | cl.TrialStream, problem: Problem) -> Floats:
    solver = cl.solvers.STLSQ(problem.thresholds[0], shared=False)
    law = cl.discover(
        trials,
        order=1,
        library=cl.library.PolynomialLibrary(problem.degree),
        method=cl.DerivativeRegression(differentiation=cl.differentiation.FiniteDifference(), solver=solver),
    )
    return np.asarray(law.coefficients[0])


def _compressing(problem: Problem, samples: int | None = None) -> tuple[cl.formulation.StrongForm, Terms, cl.Trials]:
    trials, form = _trials(problem, samples), cl.formulation.StrongForm(cl.differentiation.FiniteDifference())
    return form, cl.library.PolynomialLibrary(problem.degree).bind(law_variables(trials.schema, form.order)), trials


def _solved(systems: list[cl.formulation.LeastSquaresProblem], threshold: float) -> Floats:
    free = np.ones((systems[0].targets, systems[0].terms), dtype=bool)
    return np.array([each.coefficients[0] for each in cl.solvers.STLSQ(threshold, shared=False).solve(systems, free)])
