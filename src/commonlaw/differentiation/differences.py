"""Derivatives of states as measured: finite differences, and Fourier transforms of periodic ones."""

from abc import abstractmethod
from dataclasses import dataclass
from math import factorial
from typing import ClassVar

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation.base import AbstractDifferentiator, Rates, check_uniform, need_samples
from commonlaw.errors import CommonlawError
from commonlaw.runtime.arguments import check_number, check_whole_number


class _RepeatedDifference(AbstractDifferentiator):
    """States as measured, and each derivative as the first difference of the one before."""

    least: ClassVar[int]
    words: ClassVar[str]

    @abstractmethod
    def rate(self, times: Floats, states: Floats) -> Floats:
        """Return the first derivative at the samples, shape (n, d)."""

    def reach(self, order: int) -> int | None:
        return order

    def differentiate(self, times: Floats, states: Floats, order: int) -> Rates:
        need_samples(len(times), self.least, self.words)
        derivatives = [states]
        for _ in range(order):
            derivatives.append(self.rate(times, derivatives[-1]))
        return Rates(states, tuple(derivatives[1:]))


@dataclass(frozen=True)
class CenteredDifference(_RepeatedDifference):
    """Centred differences, repeated for higher derivatives (de Silva et al. 2020, "Numerical differentiation").

    Inside ``(x[i+1] - x[i-1]) / (t[i+1] - t[i-1])``; at both ends the one-sided formula of third order over four
    samples, ``(-11/6, 3, -3/2, 1/3) / dt``, with that end's own step ``dt``.

    Assumes nearly uniform sampling: where two neighbouring steps differ, the error is of first order in their
    difference. Assumes little noise: of standard deviation s it becomes ``s / (sqrt(2) dt)`` in the first derivative,
    and more than five times that at the ends. States are returned as measured.

    Raises `CommonlawError` if a trial has fewer than 4 samples.

    Examples
    --------
    >>> t = np.arange(5.0)
    >>> CenteredDifference().differentiate(t, 3 * t[:, None], 1).derivatives[0].ravel().round(9).tolist()
    [3.0, 3.0, 3.0, 3.0, 3.0]
    """

    least, words = 4, "centred differences"

    def rate(self, times: Floats, states: Floats) -> Floats:
        rate, end = np.empty_like(states), np.array([-11 / 6, 3, -3 / 2, 1 / 3])
        rate[1:-1] = (states[2:] - states[:-2]) / (times[2:] - times[:-2])[:, np.newaxis]
        rate[0] = end @ states[:4] / (times[1] - times[0])
        rate[-1] = -end @ states[:-5:-1] / (times[-1] - times[-2])
        return rate


@dataclass(frozen=True)
class ForwardDifference(_RepeatedDifference):
    """Forward differences, repeated for higher derivatives (LeVeque 2007, section 1.1).

    ``(x[i+1] - x[i]) / (t[i+1] - t[i])``; at the last sample the one-sided formula of second order
    ``(3/2 x[-1] - 2 x[-2] + 1/2 x[-3]) / dt`` with the last step ``dt``.

    Takes any grid but for its last two steps, which should be equal. The error is of first order in the step: half
    a step late. Assumes little noise: of standard deviation s it becomes ``sqrt(2) s / dt``. States are returned as
    measured.

    Raises `CommonlawError` if a trial has fewer than 3 samples.
    """

    least, words = 3, "forward differences"

    def rate(self, times: Floats, states: Floats) -> Floats:
        rate, steps = np.empty_like(states), np.diff(times)
        rate[:-1] = np.diff(states, axis=0) / steps[:, np.newaxis]
        rate[-1] = (1.5 * states[-1] - 2 * states[-2] + 0.5 * states[-3]) / steps[-1]
        return rate


@dataclass(frozen=True)
class FiniteDifference(AbstractDifferentiator):
    """Finite differences with weights of their own at every sample (the stencils of Fornberg 1988).

    The derivative of order k at a sample is that of the polynomial through the samples of a window around it: an odd,
    centred window inside (``accuracy + 1`` samples for the first and second derivative), and the first or last
    ``k + accuracy`` samples at the ends. Each derivative is taken from the states directly.

    Takes any grid: the first and second derivative of polynomials up to degree `accuracy` are exact. On a uniform grid
    the error is of order `accuracy` in the step for every derivative. Assumes smooth states and little noise: noise
    grows as the step to the power -k. States are returned as measured.

    Raises `CommonlawError` if `accuracy` is not an even number of at least 2, or a trial has fewer than ``order +
    accuracy`` samples.

    Parameters
    ----------
    accuracy
        Order of the error in the step: even, 2 or more.

    Examples
    --------
    >>> t = np.array([0.0, 1.0, 1.5, 3.0])
    >>> FiniteDifference().differentiate(t, t[:, None] ** 2, 2).derivatives[1].ravel().round(9).tolist()
    [2.0, 2.0, 2.0, 2.0]
    """

    accuracy: int = 2

    def __post_init__(self) -> None:
        check_whole_number("accuracy", self.accuracy, 2)
        if self.accuracy % 2:
            raise CommonlawError("accuracy-odd", accuracy=self.accuracy)

    def reach(self, order: int) -> int | None:
        return ((order - 1) // 2 * 2 + self.accuracy + 1) // 2

    def differentiate(self, times: Floats, states: Floats, order: int) -> Rates:
        need_samples(len(times), order + self.accuracy, f"finite differences of accuracy {self.accuracy}")
        columns = np.ascontiguousarray(states.T)  # Long rows go through NumPy several times faster than short ones
        return Rates(columns.T, tuple(self._derivative(times, columns, k).T for k in range(1, order + 1)))

    def _derivative(self, times: Floats, states: Floats, order: int) -> Floats:
        count, inside, at_ends = len(times), (order - 1) // 2 * 2 + 1 + self.accuracy, order + self.accuracy
        half = inside // 2
        if order == 1 and inside == 3:
            return _through_three(times, states)
        if inside == at_ends:  # One window for each sample, at the ends the first or last one
            moved = [(_in_windows(times, k, inside), _in_windows(states, k, inside)) for k in range(inside)]
            return _lagrange([time - times for time, _ in moved], [state - states for _, state in moved], order)
        derivative = np.empty_like(states)
        for samples, nodes in (
            (slice(half), [slice(k, k + 1) for k in range(at_ends)]),
            (slice(half, count - half), [slice(k, count - inside + 1 + k) for k in range(inside)]),
            (slice(count - half, count), [slice(count - k - 1, count - k) for k in range(at_ends)]),
        ):
            offsets = [times[node] - times[samples] for node in nodes]
            # Differences to the sample itself: a large offset of the states then costs no digits.
            rises = [states[:, node] - states[:, samples] for node in nodes]
            derivative[:, samples] = _lagrange(offsets, rises, order)
        return derivative


def _through_three(times: Floats, states: Floats) -> Floats:
    """Return the first derivative at each sample of the parabola through three: its neighbours and itself.

    At the ends it is the parabola of the neighbour. By divided differences (Newton); states have shape (d, n).
    """
    steps = np.diff(times)
    slopes = np.diff(states) / steps
    bends, shares = np.diff(slopes), steps[:-1] / (steps[:-1] + steps[1:])
    derivative = np.empty_like(states)
    np.multiply(bends, shares, out=derivative[:, 1:-1])
    derivative[:, 1:-1] += slopes[:, :-1]
    derivative[:, 0] = slopes[:, 0] - shares[0] * bends[:, 0]
    derivative[:, -1] = slopes[:, -1] + (1 - shares[-1]) * bends[:, -1]
    return derivative


def _in_windows(values: Floats, k: int, window: int) -> Floats:
    """Return for every sample, along the last axis, node k of its window, which stays inside at the ends."""
    last, half = values.shape[-1] - window + k, window // 2
    first, final = (np.repeat(values[..., at : at + 1], half, axis=-1) for at in (k, last))
    return np.concatenate([first, values[..., k : last + 1], final], axis=-1)


def _lagrange(offsets: list[Floats], values: list[Floats], order: int) -> Floats:
    """Return the derivative at zero, shape (d, m), of the polynomials through `values` at `offsets`."""
    derivative = np.zeros_like(values[0])
    # In units of a power of two near the width of each window, which changes no digit, powers of steps are finite
    scale = np.exp2(np.frexp(np.max(np.abs(offsets), axis=0))[1])
    offsets = [offset / scale for offset in offsets]
    for k, value in enumerate(values):
        powers = np.zeros((order + 1, value.shape[1]))  # of the node's Lagrange polynomial, as far as they are wanted
        powers[0] = 1
        for offset in offsets[:k] + offsets[k + 1 :]:
            powers[1:], powers[0] = powers[:-1] - offset * powers[1:], -offset * powers[0]
            powers /= offsets[k] - offset
        derivative += factorial(order) * powers[order] * value
    derivative /= scale**order
    return derivative


@dataclass(frozen=True)
class SpectralDerivative(AbstractDifferentiator):
    """Derivatives in Fourier space: each frequency f is multiplied by ``2 pi i f`` (Trefethen 2000, chapter 3).

    Assumes a trial that covers whole periods of a periodic state, without repeating the first sample at the end, on a
    uniform grid (steps within 1 % of the median). On a state that is not periodic the jump from the last sample to the
    first rings through the whole trial. For smooth periodic states the error falls faster than any power of the step.
    Without a cutoff noise is amplified in proportion to its frequency.

    Raises `CommonlawError` if `cutoff` is not above zero, a trial has fewer than 3 samples, or its sampling is not
    uniform.

    Parameters
    ----------
    cutoff
        Highest frequency that is kept, in cycles per unit of time; None keeps all. It low-passes the states too.

    Examples
    --------
    >>> t = np.arange(8) / 8
    >>> rates = SpectralDerivative().differentiate(t, np.sin(2 * np.pi * t)[:, None], 1)
    >>> bool(np.allclose(rates.derivatives[0].ravel(), 2 * np.pi * np.cos(2 * np.pi * t)))
    True
    """

    cutoff: float | None = None

    def __post_init__(self) -> None:
        check_number("cutoff", self.cutoff, 0, above=True, optional=True)

    def differentiate(self, times: Floats, states: Floats, order: int) -> Rates:
        count = len(times)
        need_samples(count, 3, "spectral derivatives")
        check_uniform(times, 0.01, "the spectral derivative")
        frequencies = np.fft.rfftfreq(count, (times[-1] - times[0]) / (count - 1))[:, np.newaxis]
        amplitudes = np.fft.rfft(states, axis=0)
        if self.cutoff is not None:
            amplitudes[frequencies[:, 0] > self.cutoff] = 0
        # irfft drops the imaginary part at the highest frequency of an even count, as odd derivatives need.
        powers = [(2j * np.pi * frequencies) ** k for k in range(order + 1)]
        smoothed, *derivatives = (np.fft.irfft(power * amplitudes, count, axis=0) for power in powers)
        return Rates(smoothed, tuple(derivatives))
