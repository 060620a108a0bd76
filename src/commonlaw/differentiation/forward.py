"""Forward differences on the measured times."""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation.base import AbstractDifferentiator, Rates, repeated
from commonlaw.differentiation.checks import need_samples


@dataclass(frozen=True)
class ForwardDifference(AbstractDifferentiator):
    """Forward differences, repeated for higher derivatives (LeVeque 2007, section 1.1).

    ``(x[i+1] - x[i]) / (t[i+1] - t[i])``; at the last sample the one-sided formula of second order
    ``(3/2 x[-1] - 2 x[-2] + 1/2 x[-3]) / dt`` with the last step ``dt``.

    Takes any grid but for its last two steps, which should be equal. The error is of first order in the step: half
    a step late. Assumes little noise: of standard deviation s it becomes ``sqrt(2) s / dt``. States are returned as
    measured.

    Raises
    ------
    CommonlawError
        If a trial has fewer than 3 samples.
    """

    def reach(self, order: int) -> int | None:
        return order

    def differentiate(self, times: Floats, states: Floats, order: int) -> Rates:
        need_samples(len(times), 3, "forward differences")
        return repeated(_rate, times, states, order)


def _rate(times: Floats, states: Floats) -> Floats:
    steps = np.diff(times)
    rate = np.empty_like(states)
    rate[:-1] = np.diff(states, axis=0) / steps[:, np.newaxis]
    rate[-1] = (1.5 * states[-1] - 2 * states[-2] + 0.5 * states[-3]) / steps[-1]
    return rate
