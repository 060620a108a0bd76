"""Trajectories of a law, their derivatives by its coefficients and by the start, and what data can say of coefficients.

SymPy and SciPy only: nothing here is commonlaw's, so that commonlaw can be measured by it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Floats = NDArray[np.float64]
Equations = tuple[tuple[str, ...], ...]


@dataclass(frozen=True, eq=False)
class Run:
    """A trajectory of n samples of D states and its derivatives by P coefficients.

    Parameters
    ----------
    states
        Shape (n, D).
    by_coefficients
        Shape (n, D, P).
    by_start
        Shape (n, D, D).
    """

    states: Floats
    by_coefficients: Floats
    by_start: Floats


def solve(
    variables: tuple[str, ...],
    equations: Equations,
    coefficients: Floats,
    start: Floats,
    times: Floats,
    force: Callable[[float], Floats] | None = None,
) -> Run:
    """Integrate a law and its variational equations to a relative error of 1e-10.

    Parameters
    ----------
    variables
        The states; of a law of second order, with their rates after them.
    equations
        The terms of each equation, such as ``x^2 y``. With half as many equations as variables, the law is of second
        order.
    coefficients
        Of these terms, equation by equation, shape (P,).
    start
        Shape (D,).
    times
        Shape (n,); the first is that of the start.
    force
        Of time, which the law does not know: what it adds to the equations, shape (equations,).
    """
    field, size, count = _field(variables, equations), len(variables), len(coefficients)
    numbers = coefficients.tolist()

    def grow(time: float, joined: Floats) -> Floats:
        rates, by_states, by_coefficients = field(joined[:size].tolist(), numbers)
        if force is not None:
            rates = [*rates[: -len(equations)], *(rates[-len(equations) :] + force(time))]
        growth = np.array(by_states) @ joined[size:].reshape(size, count + size)
        growth[:, :count] += by_coefficients
        return np.concatenate([rates, growth.ravel()])

    begin = np.concatenate([start, np.eye(size, count + size, count).ravel()])
    found = solve_ivp(grow, (times[0], times[-1]), begin, "DOP853", times, rtol=1e-10, atol=1e-10)
    if not found.success:
        raise RuntimeError(f"cannot integrate {equations} from {start}: {found.message}")
    derivatives = found.y[size:].T.reshape(len(times), size, count + size)
    return Run(found.y[:size].T, derivatives[:, :, :count], derivatives[:, :, count:])


def cramer_rao(runs: Sequence[Run], noise: Floats) -> Floats:
    """Return the least standard deviations that unbiased estimates of an object's coefficients can have, shape (P,).

    Each trial's start is unknown too, and the noise is white and normal (Kay 1993, "Estimation Theory", section 3.9:
    the Schur complement of the starts in the Fisher information).

    Parameters
    ----------
    runs
        The object's trials at its true coefficients.
    noise
        Standard deviation for each of the states that are measured, the first of the run's, shape (d,).
    """
    rows = []
    for run in runs:
        moved, started = (_whitened(each, noise) for each in (run.by_coefficients, run.by_start))
        of_start, _ = np.linalg.qr(started)
        rows.append(moved - of_start @ (of_start.T @ moved))
    factor = np.linalg.qr(np.concatenate(rows), mode="r")
    return np.asarray(np.linalg.norm(np.linalg.inv(factor), axis=1))


def term_values(term: str, variables: Sequence[str], values: Floats) -> Floats:
    """Return a term at values of the variables, shape (n, D), as a column (n,)."""
    column = sympy.lambdify(sympy.symbols(variables), _expression(term), "numpy")(*values.T)
    return np.broadcast_to(np.asarray(column, dtype=np.float64), len(values))


def _whitened(derivatives: Floats, noise: Floats) -> Floats:
    seen = derivatives[:, : len(noise)] / noise[:, np.newaxis]
    return np.asarray(seen.reshape(-1, derivatives.shape[2]))


@cache
def _field(
    variables: tuple[str, ...], equations: Equations
) -> Callable[[list[float], list[float]], tuple[Any, Any, Any]]:
    """Return the function of states and coefficients that gives rates, their derivatives by states, by coefficients."""
    states = sympy.symbols(variables)
    coefficients = sympy.symbols(f"c:{sum(map(len, equations))}")
    numbers = iter(coefficients)
    given = [sum(next(numbers) * _expression(term) for term in equation) for equation in equations]
    rates = sympy.Matrix([*states[len(equations) :], *given])
    wanted = [list(rates), rates.jacobian(states).tolist(), rates.jacobian(coefficients).tolist()]
    function: Callable[[list[float], list[float]], tuple[Any, Any, Any]]
    function = sympy.lambdify((states, coefficients), wanted, "math", cse=True)
    return function


def _expression(term: str) -> sympy.Expr:
    return sympy.sympify(term.replace(" ", "*").replace("^", "**"))
