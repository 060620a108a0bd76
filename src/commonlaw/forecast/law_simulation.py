"""Trajectories of a law from initial states that are given."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.errors import CommonlawError
from commonlaw.integration import Event, InitialValueProblem, Trajectory, simulate
from commonlaw.law import Law
from commonlaw.library import Terms


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
) -> dict[str, Trajectory]:
    """Integrate a law for every object, see `Law.simulate`."""
    if law.schema.inputs:
        raise CommonlawError("this law has inputs: forecast trials that hold them with predict")
    natural = Terms(replace(law.terms.variables, logarithmic=()), law.terms.terms)
    starts = initial if isinstance(initial, Mapping) else dict.fromkeys(law.objects, initial)
    width, grid = len(law.states) * max(1, law.order), np.asarray(times, dtype=np.float64)
    problems = {}
    for name, start in starts.items():
        state = np.atleast_1d(np.asarray(start, dtype=np.float64))
        if state.shape != (width,):
            wanted = ", ".join(law.terms.variables.states)
            raise CommonlawError(f"{name}: the initial state has {state.size} numbers, expected {width}: {wanted}")
        problems[name] = InitialValueProblem(replace(law.vector_field(name), terms=natural), state, grid, name)
    found = simulate(
        problems.values(),
        method=method,
        tolerance=tolerance,
        events=events,
        dense=dense,
        sensitivities=sensitivities,
    )
    return dict(zip(problems, found, strict=True))
