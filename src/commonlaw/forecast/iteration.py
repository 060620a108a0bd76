"""Laws in discrete time: the next states follow from these."""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.forecast.base import FAR, AbstractIntegrator, Run, Wanted
from commonlaw.forecast.trajectory import Trajectory, diverged


@dataclass(frozen=True)
class Iteration(AbstractIntegrator):
    """``x[k+1] = f(x[k])``, one step for each time; inputs are those of the earlier time.

    Raises
    ------
    CommonlawError
        If events or dense output are wanted: between the steps there is nothing.
    """

    wanted: Wanted

    def __post_init__(self) -> None:
        if self.wanted.events or self.wanted.dense:
            raise CommonlawError(
                "a law in discrete time has no events and no dense output: between steps it says nothing"
            )

    def integrate(self, run: Run) -> Trajectory:
        """Return the trajectory of a run; "diverged" says at which time a state ran away."""
        moved, width = run.field, len(run.initial)
        states = np.full((len(run.times), width), np.nan)
        states[0] = run.initial
        slopes, limit = self._first_slopes(run), 0.0
        with np.errstate(all="ignore"):
            for k, t in enumerate(run.times[:-1]):
                following = moved(t, states[k])
                limit = limit or FAR * float(np.max(np.abs([states[k], following])))
                peak = np.max(np.abs(following))
                if not peak <= limit:
                    why = f"a state reached {peak:.3g}" if np.isfinite(peak) else "a state is not finite"
                    when = float(run.times[k + 1])
                    return Trajectory(
                        run.times, states, diverged(when, why, run.where), when, (), slopes, method="steps"
                    )
                if slopes is not None:
                    slopes[k + 1] = moved.jacobian(t, states[k]) @ slopes[k]
                    slopes[k + 1, :, : -width or None] += moved.slopes(t, states[k])
                states[k + 1] = following
        return Trajectory(run.times, states, sensitivities=slopes, method="steps")

    def _first_slopes(self, run: Run) -> Floats | None:
        if not self.wanted.sensitivities:
            return None
        width, parameters = len(run.initial), len(run.field.parameters)
        slopes = np.full((len(run.times), width, parameters + width), np.nan)
        slopes[0] = np.hstack([np.zeros((width, parameters)), np.eye(width)])
        return slopes
