"""Differences of smoothed states."""

from dataclasses import dataclass, field

from commonlaw.array_types import Floats
from commonlaw.differentiation.base import AbstractDifferentiator, AbstractSmoother, Rates
from commonlaw.differentiation.centered import CenteredDifference
from commonlaw.differentiation.savitzky_golay import SavitzkyGolay


@dataclass(frozen=True)
class SmoothedDifference(AbstractDifferentiator):
    """Smoothing before every difference (de Silva et al. 2020, "Numerical differentiation").

    The falling-ball paper's rule. With smoother S and difference D: states ``S(x)``, rate ``v = D(S(x))``, second
    derivative ``a = D(S(v))``. The rate is smoothed once more before it is differentiated; the rate that is returned is
    not.

    Assumes what its smoother and its difference assume.

    Parameters
    ----------
    smoother
        S.
    difference
        D; only its first derivative is used.

    Raises
    ------
    CommonlawError
        If the smoother or the difference refuses the trial.
    """

    smoother: AbstractSmoother = field(default_factory=SavitzkyGolay)
    difference: AbstractDifferentiator = field(default_factory=CenteredDifference)

    def reach(self, order: int) -> int | None:
        half, step = self.smoother.half_window, self.difference.reach(1)
        return None if half is None or step is None else order * (half + step)

    def differentiate(self, times: Floats, states: Floats, order: int) -> Rates:
        smoothed = self.smoother.smooth(times, states)
        derivatives: list[Floats] = []
        for k in range(order):
            current = self.smoother.smooth(times, derivatives[-1]) if k else smoothed
            derivatives += self.difference.differentiate(times, current, 1).derivatives
        return Rates(smoothed, tuple(derivatives))
