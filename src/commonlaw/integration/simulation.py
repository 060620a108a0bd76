"""Simulation of many objects by Taylor series, LSODA, or iteration of maps."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.diagnostics import OutcomeKind
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.integration.problem import (
    MAX_RELATIVE_STATE,
    AbstractIntegrator,
    Event,
    InitialValueProblem,
    OutputOptions,
    Trajectory,
    check_start,
    diverged,
)
from commonlaw.integration.vector_field import VectorField
from commonlaw.library import Order
from commonlaw.runtime.progress import announced


@dataclass(frozen=True)
class Iteration(AbstractIntegrator):
    """``x[k+1] = f(x[k])``, one step for each time; inputs are those of the earlier time."""

    options: OutputOptions

    def __post_init__(self) -> None:
        if self.options.events or self.options.dense:
            raise CommonlawError("discrete-without-dense-output")

    def integrate(self, problem: InitialValueProblem) -> Trajectory:
        vector_field, width = problem.field, len(problem.initial)
        states = np.full((len(problem.times), width), np.nan)
        states[0] = problem.initial
        sensitivities, limit, outcome, ended = None, self.options.limit, None, None
        if self.options.sensitivities:
            parameters = len(vector_field.parameters)
            sensitivities = np.full((*states.shape, parameters + width), np.nan)
            sensitivities[0] = np.eye(width, parameters + width, parameters)
        with np.errstate(all="ignore"):
            for k, t in enumerate(problem.times[:-1]):
                following = vector_field(t, states[k])
                limit = limit or MAX_RELATIVE_STATE * float(np.max(np.abs([states[k], following])))
                peak = np.max(np.abs(following))
                if not peak <= limit:
                    why = f"a state reached {peak:.3g}" if np.isfinite(peak) else "a state is not finite"
                    ended = float(problem.times[k + 1])
                    outcome = diverged(ended, why, problem.where)
                    break
                if sensitivities is not None:
                    _, (by_states,), (by_parameters,) = vector_field.linearize(vector_field.point(t, states[k]))
                    sensitivities[k + 1] = by_states @ sensitivities[k]
                    sensitivities[k + 1, :, :-width] += by_parameters
                states[k + 1] = following
        return Trajectory(problem.times, states, outcome, ended, (), sensitivities, method="steps")


METHODS = ("auto", "heyoka", "scipy")

_FEW_POINTS = 5000
"""Points up to which LSODA is faster than the import of heyoka and the compilation of a law."""


def simulate(
    problems: Iterable[InitialValueProblem],
    *,
    method: str = "auto",
    tolerance: float = 1e-8,
    events: Sequence[Event] = (),
    dense: bool = False,
    sensitivities: bool = False,
    limit: float | None = None,
) -> tuple[Trajectory, ...]:
    """Integrate initial value problems; those of one law share the compiled integrator.

    Raises `CommonlawError` if there is no such method, heyoka is requested and is not installed or does not apply to
    the law, an event cannot be parsed, or events or dense output are requested for a law in discrete time.

    Parameters
    ----------
    problems
        The problems; with events, all of the same variables.
    method
        ``"heyoka"``: compiled Taylor series (the extra ``fast``), not for laws with abs or sign, nor for inputs with
        dense output. ``"scipy"``: LSODA. ``"auto"``: heyoka if it is installed and there are at least 5000 points, 500
        changes of inputs, or sensitivities; LSODA otherwise, for laws to which heyoka does not apply, and for problems
        that it does not complete: stiff ones, and those through singular points. `Trajectory.method` is the integrator
        with the reason.
    tolerance
        Relative error of a step.
    events
        Events to locate, see `Event`.
    dense
        Whether `Trajectory.at` interpolates.
    sensitivities
        Whether to integrate derivatives by coefficients and initial states.
    limit
        Limit beyond which states diverge. Default: 1e10 times the initial states and their change over a sample.

    Returns
    -------
    tuple of Trajectory
        In the order of the problems. Diverged states are NaN, with the outcome "diverged" and the time.
    """
    options = OutputOptions(tolerance, tuple(events), dense, sensitivities, limit)
    return tuple(simulate_each(problems, options, method))


def simulate_each(
    problems: Iterable[InitialValueProblem], options: OutputOptions, method: str = "auto"
) -> Iterator[Trajectory]:
    """Yield the trajectories of `simulate`, one after the other."""
    check_choice("method of integration", method, METHODS)
    problems = tuple(problems)
    # A knot of the inputs costs LSODA as much as ten points
    points = sum(len(problem.times) + 10 * (len(problem.stops) - 1) for problem in problems)
    if method == "auto" and not options.sensitivities and points < _FEW_POINTS:
        method = "scipy"
    choices: dict[tuple[int, Order, int, bytes], Callable[[InitialValueProblem], Trajectory]] = {}
    what = f"integrating {len(problems)} trajectories"
    for problem in announced(problems, what, "take fewer trials or a shorter time"):
        vector_field = problem.field
        masks = vector_field.kept.tobytes() + vector_field.parameter_mask.tobytes()
        powers = 0 if vector_field.inputs is None else vector_field.inputs.powers
        key = (id(vector_field.terms), vector_field.order, powers, masks)
        if key not in choices:
            choices[key] = _integrator(vector_field, method, options)
        yield choices[key](problem)


def integrate(
    field: Callable[[float, Floats], Floats],
    initial: Floats,
    times: Floats,
    *,
    jacobian: Callable[[float, Floats], Floats] | None = None,
    relative_tolerance: float = 1e-8,
    where: str = "",
) -> Trajectory:
    """Integrate any function, ``y' = field(t, y)`` from ``y(times[0]) = initial``, with LSODA (Petzold 1983).

    Laws are integrated faster by `simulate`.

    Raises `CommonlawError` if the initial states or the times are not finite, or the times do not increase.

    Parameters
    ----------
    field
        From time and states, shape (d,), to derivatives, shape (d,).
    initial
        States at the first time, shape (d,).
    times
        Of the output, increasing, shape (n,).
    jacobian
        Exact derivatives of the field by the states, shape (d, d); found by differences if not given.
    relative_tolerance
        Of each state; the absolute tolerance is a thousandth of it times the size of the initial states and of their
        change over the first sample.
    where
        Name of the trajectory in its outcome.

    Returns
    -------
    Trajectory
        With the outcome "diverged" and NaN after it if states diverged, or no step was small enough.
    """
    from commonlaw.integration.lsoda import RightHandSide, solve

    initial, times = np.asarray(initial, dtype=np.float64), np.asarray(times, dtype=np.float64)
    check_start(initial, times, where)
    return solve(RightHandSide(field, jacobian), initial, times, relative_tolerance, where, len(initial))


def _integrator(
    vector_field: VectorField, method: str, options: OutputOptions
) -> Callable[[InitialValueProblem], Trajectory]:
    """Return what integrates a law.

    Raises `CommonlawError` if the requested method does not apply.
    """
    if vector_field.order == 0:
        return Iteration(options).integrate

    def lsoda(problem: InitialValueProblem, why_not_first: str = "") -> Trajectory:
        # The import of scipy.integrate takes longer than the compilation of a law
        from commonlaw.integration.lsoda import LsodaIntegrator

        trajectory = LsodaIntegrator(options).integrate(problem)
        return replace(trajectory, method=f"{trajectory.method} ({why_not_first})") if why_not_first else trajectory

    if method == "scipy":
        return lsoda
    if vector_field.terms.variables.inputs and options.dense:
        reason = "the law has inputs, and states between the times are wanted"
    elif find_spec("heyoka") is None:
        reason = "heyoka is not installed, pip install 'commonlaw[fast]'"
    else:
        from commonlaw.integration.heyoka import HeyokaIntegrator, UnsupportedError

        def heyoka(problem: InitialValueProblem) -> Trajectory:
            trajectory = compiled.integrate(problem)
            outcome = trajectory.outcome
            if method == "auto" and outcome is not None and outcome.kind is OutcomeKind.NOT_INTEGRATED:
                return lsoda(problem, f"heyoka stopped, {outcome.text}")
            return trajectory

        try:
            compiled = HeyokaIntegrator.of(vector_field, options)
            return heyoka
        except UnsupportedError as error:
            reason = str(error)
    if method == "heyoka":
        raise CommonlawError("heyoka-failed", reason=reason)
    return partial(lsoda, why_not_first=reason)
