"""Laws in discrete time: the next states follow from these."""

from dataclasses import dataclass

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.integration.base import FAR, AbstractIntegrator
from commonlaw.integration.initial_value_problem import InitialValueProblem, OutputOptions
from commonlaw.integration.trajectory import Trajectory, diverged


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
