"""What an integration gives."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.integration.event import Occurrences
from commonlaw.outcomes import Outcome, note


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States of one object over time.

    Parameters
    ----------
    times
        Shape (n,).
    states
        Followed by the rates of those of second order, shape (n, D); NaN after a divergence or a terminal event.
    outcome
        None when the whole span was integrated, or all of it up to a terminal event.
    ended
        When the trajectory diverged or a terminal event ended it; None when it went on to the last time.
    events
        What happened, one entry for each event that was asked for.
    sensitivities
        Derivatives of the states by the parameters of the vector field, in its order, and then by the initial states,
        shape (n, states, parameters + states), if they were asked for.
    dense
        The states at any times within reach, from shape (m,) to shape (m, states), if they were asked for.
    method
        Which back end integrated it, and if it was not the first choice why: ``"heyoka"``,
        ``"scipy (abs has no Taylor series at 0)"``.
    """

    times: Floats
    states: Floats
    outcome: Outcome | None = None
    ended: float | None = None
    events: tuple[Occurrences, ...] = ()
    sensitivities: Floats | None = None
    dense: Callable[[Floats], Floats] | None = None
    method: str = "scipy"

    def at(self, times: ArrayLike) -> Floats:
        """Return the states at any times of the span, shape (m, states); NaN after a divergence or terminal event.

        Raises
        ------
        CommonlawError
            If dense output was not asked for, or a time is outside the span.
        """
        wanted = np.atleast_1d(np.asarray(times, dtype=np.float64))
        if self.dense is None:
            raise CommonlawError("trajectory-not-dense")
        if not np.all((wanted >= self.times[0]) & (wanted <= self.times[-1])):
            raise CommonlawError("trajectory-span", first=self.times[0], last=self.times[-1])
        within = wanted <= (self.times[-1] if self.ended is None else self.ended)
        states = np.full((len(wanted), self.states.shape[1]), np.nan)
        states[within] = self.dense(wanted[within])
        return states


def diverged(time: float, why: str, where: str, how: str = "ran away") -> Outcome:
    """Return the outcome of a trajectory that ran away, or that no number of steps can follow on."""
    return note("diverged", where, end=how, time=time, reason=why)
