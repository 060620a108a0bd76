"""Integration by heyoka: Taylor series of the right-hand side, compiled when first needed (Biscani and Izzo 2021).

Compiling takes 10 to 300 ms for each structure of a law. Coefficients are parameters of what is compiled, so that all
objects share it. heyoka keeps what it has compiled on disk, where its HEYOKA_CACHE_DIR says.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import heyoka
import numpy as np

from commonlaw.array_types import Floats
from commonlaw.integration.base import FAR, AbstractIntegrator, largest_state, most_steps, not_integrated
from commonlaw.integration.event import EventFunctions, occurrences
from commonlaw.integration.heyoka.compiled import Compiled, Found, Structure, compiled
from commonlaw.integration.initial_value_problem import InitialValueProblem, OutputOptions
from commonlaw.integration.trajectory import Trajectory, diverged
from commonlaw.integration.vector_field import VectorField
from commonlaw.outcomes import Outcome

Dense = Callable[[Floats], Floats]

_NOT_FINITE = "a state is not finite"

_LOOK = 1000
"""Steps after which to look whether a state ran away: on its way to infinity steps may become shorter without end."""


@dataclass(frozen=True)
class HeyokaIntegrator(AbstractIntegrator):
    """The fast back end, compiled for all vector fields of one structure."""

    options: OutputOptions
    compiled: Compiled

    @classmethod
    def of(cls, vector_field: VectorField, options: OutputOptions) -> "HeyokaIntegrator":
        """Return the integrator for vector fields of this one's terms, order and support, see `translated`."""
        return cls(options, compiled(Structure.of(vector_field, options), threading.get_ident()))

    def integrate(self, problem: InitialValueProblem) -> Trajectory:
        """Return the trajectory of a problem; the outcome "not integrated" calls for another integrator."""
        width = len(problem.initial)
        with np.errstate(all="ignore"):
            self.compiled.start(problem, self._levels(problem))
            path = _propagate(self.compiled, problem, self.options)
            rows = np.full((len(problem.times), path.rows.shape[1]), np.nan)
            reached = _before_runaway(problem, self.options, path.rows[:, :width])
            rows[:reached] = path.rows[:reached]
            ended, outcome = path.ended, None
            if path.broke or reached < len(path.rows):
                last = rows[reached - 1], float(problem.times[reached - 1])
                ended, outcome = _runaway(self.compiled, problem, self.options, *last)
            elif ended is not None and path.failure:
                outcome = not_integrated(ended, path.failure, problem.where)
        found = [each for each in path.found if ended is None or each[1] <= ended]
        sensitivities = rows[:, width:].reshape(len(rows), width, -1) if self.options.sensitivities else None
        events = occurrences(self.options.events, found, width)
        return Trajectory(problem.times, rows[:, :width], outcome, ended, events, sensitivities, path.dense, "heyoka")

    def _levels(self, problem: InitialValueProblem) -> Floats:
        """Return the levels of the events.

        One that the start is on is moved by a rounding error, away from where the trajectory goes: heyoka would take
        the start for a crossing, and may miss others in the same step.
        """
        functions = EventFunctions(self.options.events, problem.field)
        if not functions.events:
            return functions.levels
        before = functions(problem.start, problem.initial)
        after = functions.at_start(problem.start, problem.initial, float(np.ptp(problem.times)))
        values = functions.levels + before
        aside = values - np.sign(after) * np.maximum(np.spacing(np.abs(values)), 1e-300)
        return np.where(before == after, functions.levels, aside)


@dataclass(frozen=True, eq=False)
class _Path:
    """How far heyoka came: rows at the first times (at least at the first), what happened, and the states at any time.

    `ended` says when a terminal event or want of steps ended it early, `failure` why it is not integrated to the end,
    `broke` whether a state was not finite, or ran away.
    """

    rows: Floats
    found: Found
    dense: Dense | None
    ended: float | None = None
    failure: str = ""
    broke: bool = False


def _propagate(law: Compiled, problem: InitialValueProblem, options: OutputOptions) -> _Path:
    """Integrate over the times from where the law was placed."""
    stepper, row, times, most = law.stepper, law.stepper.state.copy(), problem.times, most_steps(problem.stops)
    if len(times) == 1:
        return _Path(row[np.newaxis], [], _dense(None, row, law.width) if options.dense else None)
    if options.dense:
        result, _, _, _, output, _ = stepper.propagate_until(times[-1], max_steps=most, c_output=True)
        done = result == heyoka.taylor_outcome.time_limit
        rows = (
            np.empty((0, len(row))) if output is None else output(times if done else times[times <= output.bounds[1]])
        )
        states = _dense(output, row, law.width)
    else:
        result, rows = _rows(law, problem, options)
        states = None
    # A state that is not finite at once leaves no row at all.
    rows, found, time = rows if len(rows) else row[np.newaxis], list(law.found), float(stepper.time)
    match result:
        case heyoka.taylor_outcome.time_limit:
            return _Path(rows, found, states)
        case heyoka.taylor_outcome.err_nf_state:
            return _Path(rows, found, states, None, _NOT_FINITE, broke=True)
        case heyoka.taylor_outcome.step_limit:
            failure = f"{most} steps were not enough"
            return _Path(rows, found, states, time, failure, broke=_ran_away(law, problem, options))
    found.append((law.terminal[-1 - int(result)], time, stepper.state[: law.width].copy()))
    return _Path(rows, found, states, time)


def _rows(law: Compiled, problem: InitialValueProblem, options: OutputOptions) -> tuple[Any, Floats]:
    """Return how heyoka ended and the rows at the times, as far as it came; inputs change their course at stops."""
    stepper, times, left = law.stepper, problem.times, most_steps(problem.stops)
    parts, reached = [law.stepper.state.copy()[np.newaxis]], 1
    while True:
        stop = law.follow(problem)
        until = int(np.searchsorted(times, stop, side="right"))
        wanted = times[reached:until]
        grid = np.unique(np.concatenate([[stepper.time], wanted, [stop]]))
        result, _, _, steps, _, rows = stepper.propagate_grid(grid, max_steps=max(1, min(left, _LOOK)))
        if result == heyoka.taylor_outcome.step_limit and stepper.time >= stop:  # But for a rounding error of the time
            result, rows = heyoka.taylor_outcome.time_limit, np.concatenate([rows, stepper.state[np.newaxis]])
        parts.append(rows[1 : 1 + len(wanted)])
        left, reached = left - steps, reached + len(parts[-1])
        goes_on = left > 0 and result == heyoka.taylor_outcome.step_limit and not _ran_away(law, problem, options)
        if not goes_on and (result != heyoka.taylor_outcome.time_limit or stop == times[-1]):
            return result, np.concatenate(parts)


def _dense(output: Any, row: Floats, width: int) -> Dense:
    """Return the states at any time; heyoka gives no output where not even a first step was possible."""
    if output is None:
        return lambda times: np.tile(row[:width], (len(times), 1))
    # heyoka may write its next answer where this one is.
    return lambda times: np.array(output(np.minimum(times, output.bounds[1]))[:, :width])


def _ran_away(law: Compiled, problem: InitialValueProblem, options: OutputOptions) -> bool:
    """Whether a state is too far, or no number any more."""
    return not np.max(np.abs(law.stepper.state[: law.width])) <= largest_state(problem, options)


def _runaway(
    law: Compiled, problem: InitialValueProblem, options: OutputOptions, row: Floats, time: float
) -> tuple[float, Outcome]:
    """Go on from a row, step by step; return when a state ran away, or where heyoka can go no further."""
    limit = largest_state(problem, options)
    law.reset(time, row)
    for _ in range(most_steps(problem.stops)):
        law.stepper.step(law.follow(problem) - law.stepper.time)
        peak = float(np.max(np.abs(law.stepper.state[: law.width])))
        if not np.isfinite(peak):
            break
        time = float(law.stepper.time)
        if peak > limit:
            return time, diverged(time, f"a state reached {peak:.3g}", problem.where)
    return time, not_integrated(time, _NOT_FINITE, problem.where)


def _before_runaway(problem: InitialValueProblem, options: OutputOptions, states: Floats) -> int:
    """Return how many of the first rows are finite and not too far."""
    # The largest state of most trajectories is not even far from the initial ones: then the rates need not be known.
    if options.limit is None and np.max(np.abs(states)) <= FAR * np.max(np.abs(problem.initial)):
        return len(states)
    limit = largest_state(problem, options)
    return int(np.logical_and.accumulate((np.abs(states) <= limit).all(axis=1)).sum())
