"""Integration of many objects at once, by whichever back end takes their law."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, unknown
from commonlaw.integration.problem import (
    FAR,
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
from commonlaw.outcomes import OutcomeKind
from commonlaw.runtime.progress import announced


@dataclass(frozen=True)
class Iteration(AbstractIntegrator):
    """``x[k+1] = f(x[k])``, one step for each time; inputs are those of the earlier time."""

    options: OutputOptions

    def __post_init__(self) -> None:
        if self.options.events or self.options.dense:
            raise CommonlawError("discrete-without-dense-output")

    def integrate(self, problem: InitialValueProblem) -> Trajectory:
        """Return the trajectory of a problem; "diverged" says at which time a state ran away."""
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
                limit = limit or FAR * float(np.max(np.abs([states[k], following])))
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
"""Points that LSODA gives sooner than heyoka is imported and has compiled the law."""


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
    """Integrate many objects, each from its own start; those of one law share what is compiled.

    Raises `CommonlawError` if there is no such method, heyoka is asked for and is not installed or does not take the
    law, an event cannot be read, or events or dense output are asked of a law in discrete time.

    Parameters
    ----------
    problems
        What to integrate; all must be of one kind of law if there are events.
    method
        ``"heyoka"``: Taylor series, compiled (the extra ``fast``); laws with abs or sign are refused, and inputs with
        dense output. ``"scipy"``: LSODA. ``"auto"``: heyoka where it is installed and there is enough to do (5000
        points, 500 changes of inputs, or sensitivities); LSODA otherwise, for laws that heyoka does not take, and for
        problems that it cannot finish: stiff ones, which need too many of its steps, and those through points where the
        law has no derivatives. `Trajectory.method` says which one it was, and why.
    tolerance
        Relative error of a step.
    events
        What to look for on the way, see `Event`.
    dense
        Whether `Trajectory.at` is to give states at any time.
    sensitivities
        Whether to integrate the derivatives by the coefficients and the initial states too.
    limit
        A state larger than this ran away; by default 1e10 times the initial states and their change over the first
        sample.

    Returns
    -------
    tuple of Trajectory
        In the order of the problems. Where states ran away, they are NaN and the outcome is "diverged", with the time.
    """
    options = OutputOptions(tolerance, tuple(events), dense, sensitivities, limit)
    return tuple(simulate_each(problems, options, method))


def simulate_each(
    problems: Iterable[InitialValueProblem], options: OutputOptions, method: str = "auto"
) -> Iterator[Trajectory]:
    """Yield the trajectories of `simulate`, each integrated when it is asked for."""
    if method not in METHODS:
        raise unknown("method of integration", method, METHODS)
    problems = tuple(problems)
    # A stop, where inputs change their course, takes LSODA as long as ten points
    points = sum(len(problem.times) + 10 * (len(problem.stops) - 1) for problem in problems)
    if method == "auto" and not options.sensitivities and points < _FEW_POINTS:
        method = "scipy"
    choices: dict[tuple[int, Order, int, bytes], _Choice] = {}
    what = f"integrating {len(problems)} trajectories"
    for problem in announced(problems, what, "take fewer trials or a shorter time"):
        vector_field = problem.field
        masks = vector_field.kept.tobytes() + vector_field.parameter_mask.tobytes()
        powers = 0 if vector_field.inputs is None else vector_field.inputs.powers
        key = (id(vector_field.terms), vector_field.order, powers, masks)
        if key not in choices:
            choices[key] = _choice(vector_field, method, options)
        yield choices[key].integrate(problem)


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
        Where the states are wanted, increasing, shape (n,).
    jacobian
        Exact derivatives of the field by the states, shape (d, d); found by differences if not given.
    relative_tolerance
        Of each state; the absolute tolerance is a thousandth of it times the size of the initial states and of their
        change over the first sample.
    where
        What is integrated, for the outcome.

    Returns
    -------
    Trajectory
        With the outcome "diverged" and NaN after it when the states ran away or no step was small enough.
    """
    from commonlaw.integration.lsoda import RightHandSide, solve

    initial, times = np.asarray(initial, dtype=np.float64), np.asarray(times, dtype=np.float64)
    check_start(initial, times, where)
    return solve(RightHandSide(field, jacobian), initial, times, relative_tolerance, where)


@dataclass(frozen=True)
class _Choice:
    """The integrator for a law, one for problems that it cannot finish, and why it is not the first choice."""

    first: AbstractIntegrator
    second: Callable[[], AbstractIntegrator] | None = None
    reason: str = ""

    def integrate(self, problem: InitialValueProblem) -> Trajectory:
        trajectory = self.first.integrate(problem)
        outcome, reason = trajectory.outcome, self.reason
        if self.second is not None and outcome is not None and outcome.kind is OutcomeKind.NOT_INTEGRATED:
            trajectory, reason = self.second().integrate(problem), f"heyoka stopped, {outcome.text}"
        return replace(trajectory, method=f"{trajectory.method} ({reason})") if reason else trajectory


def _choice(vector_field: VectorField, method: str, options: OutputOptions) -> _Choice:
    """Return what integrates a law; refuse a method that cannot."""
    if vector_field.order == 0:
        return _Choice(Iteration(options))

    def lsoda() -> AbstractIntegrator:
        # SciPy's integrators take longer to import than a law to compile
        from commonlaw.integration.lsoda import LsodaIntegrator

        return LsodaIntegrator(options)

    fast = "" if method == "scipy" else _fast(vector_field, options)
    if not isinstance(fast, str):
        return _Choice(fast, lsoda if method == "auto" else None)
    if method == "heyoka":
        raise CommonlawError("heyoka-failed", reason=fast)
    return _Choice(lsoda(), reason=fast)


def _fast(vector_field: VectorField, options: OutputOptions) -> AbstractIntegrator | str:
    """Return the compiled integrator of a law, or why there is none."""
    if vector_field.terms.variables.inputs and options.dense:
        return "the law has inputs, and states between the times are wanted"
    if find_spec("heyoka") is None:
        return "heyoka is not installed, pip install 'commonlaw[fast]'"
    from commonlaw.integration.heyoka import HeyokaIntegrator, UnsupportedError

    try:
        return HeyokaIntegrator.of(vector_field, options)
    except UnsupportedError as error:
        return str(error)
