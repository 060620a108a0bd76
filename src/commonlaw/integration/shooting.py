"""Solutions of given equations with sensitivities to parameters and initial values, for single shooting.

The kernel has Radau IIA of order 5 with the derivatives of its steps (Hairer and Wanner 1996, IV.8); without it, states
and their variational equations, ``S' = J S + df/dp``, are integrated together by SciPy.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count as count_from, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Floats
from commonlaw.integration.problem import ABSOLUTE_TOLERANCE
from commonlaw.integration.vector_field import Inputs
from commonlaw.kernel import CONSTANTS, ProgramStructure, address, kernel
from commonlaw.library.program import Program
from commonlaw.runtime.forking import cached_property

MAX_STEPS = 200_000
"""Steps of a solution by the kernel."""

_MAX_EVALUATIONS = 100_000
"""Evaluations of a right-hand side by SciPy; some laws with infinite slopes would need as many as one likes."""

(_MAX_CROSSINGS,), (_MIN_INTERVAL,), (_CROSSING,) = (
    CONSTANTS[name] for name in ("MAX_CROSSINGS", "MIN_INTERVAL", "CROSSING")
)


class Solution(NamedTuple):
    """States at n times, shape (n, D), NaN after the end of the solution, and their derivatives.

    Derivatives are by the parameters, and then by the initial values, shape (n, D, P + D). A solution is endless if it
    ends where its switches or events are infinitely many.
    """

    states: Floats
    derivatives: Floats | None
    is_endless: bool = False


@dataclass(frozen=True, eq=False)
class DelayedInputs:
    """Delayed inputs: the `column` of each in the inputs, and the index of its `delay` among the parameters, or -1."""

    inputs: Inputs
    column: tuple[int, ...]
    delay: tuple[int, ...]

    @cached_property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """Knots, polynomials, columns and delays, as arguments of the kernel."""
        numbers = (np.array(indices, dtype=np.int64) for indices in (self.column, self.delay))
        return *map(np.ascontiguousarray, (self.inputs.knots, self.inputs.coefficients)), *numbers

    def delays(self, parameters: Floats) -> Floats:
        """Return the delay of each input."""
        return np.array([0.0 if index < 0 else parameters[index] for index in self.delay])

    def at(self, times: Floats, parameters: Floats) -> Floats:
        """Return the inputs at times of shape (n,), shape (n, inputs)."""
        delays = self.delays(parameters)
        if not delays.any():
            return self.inputs.at(times)[:, self.arrays[2]]
        columns = [self.inputs.at(times - delay)[:, c] for c, delay in zip(self.column, delays, strict=True)]
        return np.column_stack(columns)

    def rate(self, index: int, time: float, parameters: Floats) -> float:
        """Return the derivative of an input by time."""
        since = time - self.delays(parameters)[index]
        piece = self.inputs.piece(since)
        polynomial = self.inputs.coefficients[piece, :, self.column[index]]
        since -= self.inputs.knots[piece]
        return float(np.polynomial.Polynomial(polynomial).deriv()(since)) if since >= 0 else 0.0


NO_INPUTS = DelayedInputs(Inputs(np.zeros(1), np.zeros((1, 1, 0))), (), ())


def shoot(
    program: Program,
    parameters: Floats,
    initial: Floats,
    times: Floats,
    sizes: Floats,
    inputs: DelayedInputs = NO_INPUTS,
    *,
    derivatives: bool = True,
    tolerance: float = 1e-8,
    max_steps: int = MAX_STEPS,
) -> Solution:
    """Solve ``x' = f(x, u, t, p)`` from the initial values at the first of the times.

    Where the condition of an event, ``g(x, u, t, p) > 0``, becomes true, x becomes ``r(x, u, t, p)``, and derivatives S
    by parameters and initial values q become ``r_x S + r_q + (dr/dt - f) dt/dq``, with f after the event and
    ``dt/dq = -(g_x S + g_q) / (dg/dt)`` (Galán, Feehery and Barton 1999, Appl. Numer. Math. 31, 17). An event that
    another one or a jump of the inputs brings about has the time of that. A condition that is true at first is no event
    before it has been false. States at the time of an event are those before it.

    Parameters
    ----------
    program
        f over the variables states, inputs, time, parameters and K switches, followed by the K switching functions: a
        switch is 1 where its function is positive, else 0. Their roots are located, and f is smooth between them. The
        last E of these are the g of events, whose r, D functions each, follow.
    parameters, initial, sizes
        Values of the P parameters, of the D states at the first time, and scales of the states, for the tolerance.
    times
        Increasing, shape (n,).
    inputs
        The inputs, if there are any.
    max_steps
        Of the kernel, after which the solution ends.
    """
    states = np.full((len(times), len(initial)), np.nan)
    states[0] = initial
    library = kernel()
    slopes = np.full((len(times), len(initial), len(parameters) + len(initial)), np.nan) if derivatives else None
    if library is None:
        return _by_scipy(program, parameters, times, sizes, inputs, states, slopes, tolerance)
    values, times = (np.ascontiguousarray(array, dtype=np.float64) for array in (parameters, times))
    absolute = np.ascontiguousarray(tolerance * ABSOLUTE_TOLERANCE * sizes)
    counts = (program.variables, len(program.constants), len(program.code), len(program.outputs))
    arrays = tuple(map(np.ascontiguousarray, (program.constants, program.code, program.outputs)))
    structure = ProgramStructure(*counts, *map(address, arrays))
    reached = library.commonlaw_shoot(
        ctypes.byref(structure),
        len(initial),
        len(inputs.column),
        len(values),
        address(values),
        len(times),
        address(times),
        *inputs.inputs.coefficients.shape,
        *map(address, inputs.arrays),
        tolerance,
        address(absolute),
        max_steps,
        address(states),
        0 if slopes is None else address(slopes),
    )
    states[abs(reached) :] = np.nan
    if slopes is not None:
        slopes[abs(reached) :] = np.nan
    return Solution(states, slopes, reached < 0)


def _by_scipy(
    program: Program,
    parameters: Floats,
    times: Floats,
    sizes: Floats,
    inputs: DelayedInputs,
    states: Floats,
    slopes: Floats | None,
    tolerance: float,
) -> Solution:
    """Return the solution by SciPy, piece by piece between the knots of inputs."""
    from scipy.integrate import solve_ivp

    count, width = len(sizes), len(sizes) + len(parameters)
    switches = np.zeros(program.variables - len(inputs.column) - 1 - width)
    resets = np.arange(count + len(switches), len(program.outputs)).reshape(-1, count)
    regular = len(switches) - len(resets)
    knots = [inputs.inputs.knots + delay for delay in {*inputs.delays(parameters).tolist()}]
    inner, same = np.unique(np.concatenate([times[:0], *knots])), _CROSSING * max(abs(times[0]), times[-1] - times[0])
    edges = np.concatenate([times[:1], inner[(inner > times[0]) & (inner < times[-1])], times[-1:]])

    def point(t: float, x: Floats) -> Floats:
        return np.concatenate([x, inputs.at(np.array([t]), parameters)[0], [t], parameters, switches])[np.newaxis]

    def switching(t: float, y: Floats) -> Floats:
        return np.asarray(program.evaluate(point(t, y[:count]))[0, count : count + len(switches)])

    evaluations = count_from(1)

    def rates(t: float, y: Floats, first: float, last: float) -> Floats:
        if next(evaluations) > _MAX_EVALUATIONS:
            return np.full(len(y), np.nan)
        t = min(max(t, np.nextafter(first, last)), np.nextafter(last, first))
        derivatives = program.evaluate(point(t, y[:count]))[0, :count]
        return np.asarray(derivatives) if slopes is None else np.concatenate([derivatives, total(t, y)[:count].ravel()])

    def total(t: float, y: Floats) -> Floats:
        """Return the total derivatives of all outputs by parameters and initial values."""
        jacobian = program.jacobian(point(t, y[:count]))[0]
        first = count + len(inputs.column) + 1
        by = jacobian[:, first : first + len(parameters)].copy()
        for u, p in enumerate(inputs.delay):
            if p >= 0:
                by[:, p] -= jacobian[:, count + u] * inputs.rate(u, t, parameters)
        whole = jacobian[:, :count] @ y[count:].reshape(count, width)
        whole[:, : len(parameters)] += by
        return np.asarray(whole)

    def along(t: float, y: Floats) -> Floats:
        """Return the derivatives of all outputs by time."""
        at = point(t, y[:count])
        moving = np.zeros(at.shape[1])
        moving[:count] = program.evaluate(at)[0, :count]
        moving[count : count + len(inputs.column)] = [inputs.rate(u, t, parameters) for u in range(len(inputs.column))]
        moving[count + len(inputs.column)] = 1.0
        return np.asarray(program.jacobian(at)[0] @ moving)

    def set_switches(t: float, y: Floats) -> None:
        for _ in switches:  # Switching functions may depend on other switches
            value, speed = switching(t, y), along(t, y)[count : count + len(switches)]
            on = (value > 0) | ((value == 0) & (speed > 0))
            switches[:regular], switches[regular:] = on[:regular], switches[regular:] * (value[regular:] > 0)

    def switch(k: int, t: float, y: Floats) -> int:
        """Change a switch, and what an event or its saltation changes; return how many changes there were."""
        if k >= regular and switches[k]:
            switches[k] = 0.0
            return 0
        changes, shift, speed = 0, np.zeros(width), along(t, y)[count + k]
        before, after = (switching(t + side * same, y)[k] for side in (-1, 1))
        if slopes is not None and speed != 0 and abs(after - before) < 1e3 * same * abs(speed):  # Else an input jumps
            shift = -total(t, y)[count + k] / speed
        while k >= 0 and changes < _MAX_CROSSINGS:
            occurs, before = k >= regular, switching(t, y)[k]
            outputs = resets[k - regular] if occurs else range(count)
            if slopes is not None:
                moved = (total(t, y)[outputs] if occurs else y[count:].reshape(count, width)) + np.outer(
                    along(t, y)[outputs] if occurs else program.evaluate(point(t, y[:count]))[0, :count], shift
                )
            switches[k] = 1 - switches[k]
            if occurs:
                y[:count] = program.evaluate(point(t, y[:count]))[0, outputs]
                set_switches(t, y)
                # At the root itself the sign is one of rounding
                switches[k] = switches[k] or (switching(t, y)[k] == before and along(t, y)[count + k] > 0)
            if slopes is not None:
                after = program.evaluate(point(t, y[:count]))[0, :count]
                y[count:].reshape(count, width)[:] = moved - np.outer(after, shift)
            due = regular + np.flatnonzero((switching(t, y) > 0)[regular:] & (switches[regular:] == 0))
            k, changes = int(due[-1]) if occurs and len(due) else -1, changes + 1
        return changes

    def delayed_knot(t: float, y: Floats, gap: float) -> None:
        """Add the jump of sensitivities to a delay at a delayed knot of the inputs."""
        for u, p in enumerate(inputs.delay):
            if p >= 0 and np.min(np.abs(inputs.inputs.knots + parameters[p] - t)) < gap:
                before, after = (point(t + side * gap, y[:count]) for side in (-1, 1))
                changed = before.copy()
                changed[0, count + u] = after[0, count + u]
                jump = (program.evaluate(before) - program.evaluate(changed))[0, :count]
                y[count:].reshape(count, width)[:, p] += jump

    def diverged(_: float, y: Floats, *__: float) -> float:
        return float(1 - np.max(np.abs(y[:count]) / sizes) / 1e12)  # Divergence

    vars(diverged)["terminal"] = True
    y = states[0] if slopes is None else np.concatenate([states[0], np.eye(count, width, len(parameters)).ravel()])
    if slopes is not None:
        slopes[0] = np.eye(count, width, len(parameters))
    absolute = tolerance * ABSOLUTE_TOLERANCE * (sizes if slopes is None else np.append(sizes, np.repeat(sizes, width)))
    switches[regular:] = 1.0
    set_switches(times[0], y)
    pieces, crossings, occurred, endless = [*pairwise(edges.tolist())][::-1], 0, (-1, 0.0), False
    while pieces:
        first, last = pieces.pop()
        wanted = np.flatnonzero((times > first) & (times <= last))
        at = np.append(times[wanted], [] if len(wanted) and times[wanted[-1]] == last else [last])
        events = [diverged, *(_crossing(switching, k, on) for k, on in enumerate(switches.tolist()))]
        with np.errstate(all="ignore"):
            options: dict[str, Any] = {"rtol": tolerance, "atol": absolute, "args": (first, last), "events": events}
            solution = solve_ivp(rates, (first, last), y, "LSODA", at, **options)
        reached = np.reshape(solution.y, (len(y), -1))  # A list where none of the times was
        inside = wanted[: reached.shape[1]]
        states[inside] = reached[:count, : len(inside)].T
        if slopes is not None:
            slopes[inside] = reached[count:, : len(inside)].T.reshape(-1, count, width)
        occurrences = [*zip(solution.t_events or (), solution.y_events or (), strict=True)][1:]
        changed = next((k for k, (when, _) in enumerate(occurrences) if solution.status == 1 and len(when)), None)
        if solution.status < 0 or not np.isfinite(reached).all():
            break
        if changed is not None:
            (when, *_), (y, *_) = occurrences[changed]
            for row in np.flatnonzero((times >= when) & (times - when <= same)):
                when, states[row] = times[row], y[:count]
                if slopes is not None:
                    slopes[row] = y[count:].reshape(count, width)
            if changed >= regular and not switches[changed]:
                endless = occurred[0] == changed and when - occurred[1] < _MIN_INTERVAL * (times[-1] - times[0])
                occurred = changed, float(when)
            crossings += switch(changed, float(when), y)
            endless |= crossings > _MAX_CROSSINGS  # Or a sliding mode
            if endless:
                break
            pieces += [(float(when), last)] if when < last else []
            continue
        if solution.status == 1:
            break
        y = reached[:, -1].copy()
        if slopes is not None and last < times[-1]:
            delayed_knot(float(last), y, 1e-9 * float(last - first))
    return Solution(states, slopes, endless)


def _crossing(switching: Callable[[float, Floats], Floats], k: int, on: float) -> Callable[..., float]:
    """Return the event in which a switch changes; at first it has the sign of the switch, whatever rounding does."""
    at_first = np.finfo(float).tiny * (1 if on else -1)

    def event(t: float, y: Floats, first: float, _: float) -> float:
        return float(switching(t, y)[k]) if t > first else at_first

    vars(event).update(terminal=True, direction=-1 if on else 1)
    return event
