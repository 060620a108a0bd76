"""Integration of a vector field, with divergence as an outcome."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from commonlaw.errors import CommonlawError
from commonlaw.outcomes import Outcome

Floats = NDArray[np.float64]

_FAR = 1e10
"""A state this many times larger than the initial states and their change over the first sample counts as infinite."""

_MOST_STEPS = 100_000


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States of one object over time.

    Parameters
    ----------
    times
        Shape (n,).
    states
        Shape (n, states), followed by rates for a law of second order; NaN after a divergence.
    outcome
        None when the whole span was integrated.
    """

    times: Floats
    states: Floats
    outcome: Outcome | None = None


def integrate(
    field: Callable[[float, Floats], Floats],
    initial: Floats,
    times: Floats,
    *,
    jacobian: Callable[[float, Floats], Floats] | None = None,
    relative_tolerance: float = 1e-8,
    where: str = "",
) -> Trajectory:
    """Integrate ``y' = field(t, y)`` from ``y(times[0]) = initial`` with LSODA (Petzold 1983), stiff or not.

    Parameters
    ----------
    field
        From time and states, shape (d,), to rates, shape (d,).
    initial
        States at the first time, shape (d,).
    times
        Where the states are wanted, increasing, shape (n,).
    jacobian
        Exact derivatives of the rates by the states, shape (d, d); found by differences if not given.
    relative_tolerance
        Of each state; the absolute tolerance is a thousandth of it times the size of the initial states and of their
        change over the first sample.
    where
        What is integrated, for the outcome.

    Returns
    -------
    Trajectory
        With the outcome "diverged" and NaN after it when the states ran away or no step was small enough.

    Raises
    ------
    CommonlawError
        If the initial states or the times are not finite, or the times do not increase.
    """
    from scipy.integrate import LSODA

    initial, times = np.asarray(initial, dtype=np.float64), np.asarray(times, dtype=np.float64)
    _check(initial, times, where)
    states = np.full((len(times), len(initial)), np.nan)
    states[0] = initial
    if len(times) == 1:
        return Trajectory(times, states)
    with np.errstate(all="ignore"):
        first = field(times[0], initial)
        if not np.all(np.isfinite(first)):
            return Trajectory(times, states, _diverged(float(times[0]), "the law is not finite there", where))
        size = np.max(np.abs(initial)) + np.max(np.abs(first)) * (times[1] - times[0]) + np.finfo(float).tiny
        solver = LSODA(
            field,
            times[0],
            initial,
            times[-1],
            rtol=relative_tolerance,
            atol=1e-3 * relative_tolerance * size,
            jac=jacobian,
        )
        reached = 1
        for _ in range(_MOST_STEPS):
            message = _step(solver)
            bad = message or _runaway(solver.y, size)
            if bad:
                return Trajectory(times, states, _diverged(float(solver.t), bad, where))
            until = int(np.searchsorted(times, solver.t, side="right"))
            if until > reached:
                states[reached:until] = solver.dense_output()(times[reached:until]).T
                reached = until
            if solver.status == "finished":
                return Trajectory(times, states)
    return Trajectory(times, states, _diverged(float(solver.t), f"{_MOST_STEPS} steps were not enough", where))


def _step(solver: object) -> str | None:
    """Take one step; return why it failed, or None."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return solver.step()  # type: ignore[attr-defined, no-any-return]


def _runaway(states: Floats, size: float) -> str | None:
    if not np.all(np.isfinite(states)):
        return "a state is not finite"
    if np.max(np.abs(states)) > _FAR * size:
        return f"a state reached {np.max(np.abs(states)):.3g}"
    return None


def _diverged(time: float, why: str, where: str) -> Outcome:
    return Outcome(
        "diverged",
        where,
        f"the forecast ran away at t = {time:.6g} ({why})",
        "forecast a shorter time, or choose a sparser law",
    )


def _check(initial: Floats, times: Floats, where: str) -> None:
    place = f"{where}: " if where else ""
    if not np.all(np.isfinite(initial)):
        raise CommonlawError(f"{place}the initial state {initial} is not finite; give numbers")
    if times.ndim != 1 or not len(times) or not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0):
        raise CommonlawError(f"{place}the times to forecast must be finite and increase")
