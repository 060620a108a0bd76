"""How PySINDy solves the problems, and a bound that no solver that looks at all rows goes far below."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.problem import Problem

Floats = NDArray[np.float64]
Run = Callable[[], Floats]


def fit(problem: Problem) -> Run:
    """One law at one threshold, from arrays."""
    return lambda: _fitted(problem, _stlsq(problem.thresholds[0])).coefficients()


def thresholds(problem: Problem) -> Run:
    """Laws at many thresholds, each a fit of its own."""
    return lambda: np.stack([_fitted(problem, _stlsq(threshold)).coefficients() for threshold in problem.thresholds])


def bootstrap(problem: Problem) -> Run:
    """Bagging: each model sees as many samples as there are, drawn with replacement."""
    import pysindy as ps

    def run() -> Floats:
        optimizer = ps.EnsembleOptimizer(_stlsq(problem.thresholds[0]), bagging=True, n_models=problem.models)
        _fitted(problem, optimizer)
        return np.stack(optimizer.coef_list)

    return run


def simulate(problem: Problem) -> Run:
    """The trajectory of a law that is given, with PySINDy's default integrator and tolerances."""
    model = _model_of(problem)
    return lambda: np.asarray(model.simulate(problem.states[0, 0], problem.times))


def simulate_odeint(problem: Problem) -> Run:
    """The same with `odeint` at its own tolerances."""
    model = _model_of(problem)
    return lambda: np.asarray(model.simulate(problem.states[0, 0], problem.times, integrator="odeint"))


def dsyrk(problem: Problem) -> Run:
    """The Gram matrix of as many rows of ``[library | targets]``, given."""
    from scipy.linalg.blas import dsyrk as product

    matrix = np.ones((problem.rows, problem.columns), order="F")
    return lambda: np.asarray(product(1.0, matrix, trans=1))


def _stlsq(threshold: float) -> Any:
    import pysindy as ps

    # Without its default ridge penalty it solves the same problem as commonlaw, in the same time.
    return ps.STLSQ(threshold=threshold, alpha=0.0)


def _fitted(problem: Problem, optimizer: Any) -> Any:
    import pysindy as ps

    model = ps.SINDy(optimizer, ps.PolynomialLibrary(problem.degree), ps.FiniteDifference(order=2))
    return model.fit(problem.states[0] if len(problem.states) == 1 else list(problem.states), problem.step)


def _model_of(problem: Problem) -> Any:
    """Return a fitted model whose coefficients are then made those of the law."""
    few = Problem(problem.times, np.random.default_rng(0).standard_normal((1, 200, 3)), problem.degree)
    model = _fitted(few, _stlsq(0.0))
    model.optimizer.coef_ = problem.law
    return model
