"""Trajectories of a law from initial states that are given."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.integration import Event, InitialValueProblem, Inputs, Trajectory, simulate
from commonlaw.law import Law
from commonlaw.library import Terms
from commonlaw.trials.doses import MOMENT


def simulate_law(
    law: Law,
    times: ArrayLike,
    initial: "ArrayLike | Mapping[str, ArrayLike]",
    *,
    method: str = "auto",
    tolerance: float = 1e-8,
    events: Sequence[Event] = (),
    dense: bool = False,
    sensitivities: bool = False,
    doses: Mapping[str, Mapping[float, float]] | None = None,
) -> dict[str, Trajectory]:
    """Integrate a law for every object, see `Law.simulate`."""
    if law.schema.inputs != law.schema.doses:
        raise CommonlawError("simulate-with-inputs")
    for name in doses or {}:
        check_choice("dose", name, law.schema.doses)
    natural = Terms(replace(law.terms.variables, logarithmic=()), law.terms.terms)
    starts = initial if isinstance(initial, Mapping) else dict.fromkeys(law.objects, initial)
    width, grid = len(law.terms.variables.states), np.asarray(times, dtype=np.float64)
    inputs = inputs_of_doses(grid, [(doses or {}).get(name, {}) for name in law.schema.doses])
    problems = {}
    for name, start in starts.items():
        state = np.atleast_1d(np.asarray(start, dtype=np.float64))
        if state.shape != (width,):
            wanted = ", ".join(law.terms.variables.states)
            raise CommonlawError("initial-state-size", where=name, given=state.size, expected=width, names=wanted)
        field = replace(law.vector_field(name), terms=natural, inputs=inputs)
        problems[name] = InitialValueProblem(field, state, grid, name)
    found = simulate(
        problems.values(),
        method=method,
        tolerance=tolerance,
        events=events,
        dense=dense,
        sensitivities=sensitivities,
    )
    return dict(zip(problems, found, strict=True))


def inputs_of_doses(grid: Floats, doses: Sequence[Mapping[float, float]]) -> Inputs | None:
    """Return inputs that add amounts in the moment after their times, none without any; see `with_doses`."""
    if not doses:
        return None
    moment = MOMENT * float(np.diff(grid).min(initial=np.inf))
    given = np.array(sorted({time for each in doses for time in each}), dtype=np.float64)
    values = np.array([[each.get(float(time), 0.0) for each in doses] for time in given]).reshape(-1, len(doses))
    times = np.column_stack([given, given + moment, given + 2 * moment]).ravel()
    pulses = np.stack([np.zeros_like(values), values / moment, np.zeros_like(values)], axis=1)
    pulses = pulses.reshape(-1, len(doses))
    first = np.array([min([grid[0], *given]) - 1.0])
    return Inputs.of(np.append(first, times), np.vstack([np.zeros((1, len(doses))), pulses]))
