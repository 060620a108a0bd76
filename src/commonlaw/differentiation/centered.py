"""Centred differences on the measured times."""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation.base import AbstractDifferentiator, Rates, repeated
from commonlaw.differentiation.checks import need_samples

_END = np.array([-11 / 6, 3, -3 / 2, 1 / 3])


@dataclass(frozen=True)
class CenteredDifference(AbstractDifferentiator):
    """Centred differences, repeated for higher derivatives (de Silva et al. 2020, "Numerical differentiation").

    Inside ``(x[i+1] - x[i-1]) / (t[i+1] - t[i-1])``; at both ends the one-sided formula of third order over four
    samples, ``(-11/6, 3, -3/2, 1/3) / dt``, with that end's own step ``dt``.

    Assumes nearly uniform sampling: where two neighbouring steps differ, the error is of first order in their
    difference. Assumes little noise: of standard deviation s it becomes ``s / (sqrt(2) dt)`` in the first derivative,
    and more than five times that at the ends. States are returned as measured.

    Raises
    ------
    CommonlawError
        If a trial has fewer than 4 samples.

    Examples
    --------
    >>> t = np.arange(5.0)
    >>> CenteredDifference().differentiate(t, 3 * t[:, None], 1).derivatives[0].ravel().round(9).tolist()
    [3.0, 3.0, 3.0, 3.0, 3.0]
    """

    def reach(self, order: int) -> int | None:
        return order

    def differentiate(self, times: Floats, states: Floats, order: int) -> Rates:
        need_samples(len(times), 4, "centred differences")
        return repeated(_rate, times, states, order)


def _rate(times: Floats, states: Floats) -> Floats:
    rate = np.empty_like(states)
    rate[1:-1] = (states[2:] - states[:-2]) / (times[2:] - times[:-2])[:, np.newaxis]
    rate[0] = _END @ states[:4] / (times[1] - times[0])
    rate[-1] = -_END @ states[:-5:-1] / (times[-1] - times[-2])
    return rate
