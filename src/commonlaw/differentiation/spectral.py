"""Derivatives of periodic states by Fourier transform."""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation.base import AbstractDifferentiator, Rates, check_uniform, need_samples
from commonlaw.runtime.arguments import check_number


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

    def reach(self, order: int) -> int | None:
        return None

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
