"""Inputs at any time, from what was measured at the samples."""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import unknown

BETWEEN = ("held", "linear", "cubic")
"""Between two samples an input keeps the earlier value, is on a straight line, or on a cubic spline (not-a-knot)."""


@dataclass(frozen=True, eq=False)
class Inputs:
    """Inputs as polynomials of the time since a knot, each until the next knot.

    Parameters
    ----------
    knots
        Increasing, shape (n,).
    coefficients
        From the constant to the highest power, shape (n, powers, inputs).
    """

    knots: Floats
    coefficients: Floats

    @classmethod
    def of(cls, times: Floats, values: Floats, between: str = "linear") -> "Inputs":
        """Return inputs with these values, shape (n, inputs), at times of shape (n,); before and after constant.

        Raises
        ------
        CommonlawError
            If it is not known what `between` means.
        """
        if between not in BETWEEN:
            raise unknown("interpolation of inputs between samples", between, BETWEEN)
        coefficients = np.zeros((len(times), 4, values.shape[1]))
        coefficients[:, 0] = values
        if between == "linear":
            coefficients[:-1, 1] = np.diff(values, axis=0) / np.diff(times)[:, np.newaxis]
        elif between == "cubic" and len(times) > 1:
            from scipy.interpolate import CubicSpline

            coefficients[:-1] = CubicSpline(times, values).c[::-1].swapaxes(0, 1)
        powers = {"held": 1, "linear": 2, "cubic": 4}[between]
        # An input that stays as it is needs no knot
        changes = np.any(np.diff(coefficients, axis=0), axis=(1, 2)) | np.any(coefficients[1:, 1:], axis=(1, 2))
        kept = np.concatenate([[True], changes])
        return cls(np.asarray(times[kept]), coefficients[kept, :powers])

    @property
    def held(self) -> bool:
        """Whether they keep their values from a knot to the next, where they jump."""
        return self.powers == 1

    @property
    def powers(self) -> int:
        """The number of coefficients of a polynomial."""
        return int(self.coefficients.shape[1])

    def at(self, times: Floats) -> Floats:
        """Return the inputs at times of shape (m,), shape (m, inputs)."""
        pieces = np.maximum(self.knots.searchsorted(times, side="right") - 1, 0)
        return self._values(np.maximum(times - self.knots[pieces], 0.0)[:, np.newaxis], self.coefficients[pieces])

    def __call__(self, time: float) -> Floats:
        """Return the inputs at one time, shape (inputs,)."""
        piece = self.piece(time)
        return self._values(max(time - self.knots[piece], 0.0), self.coefficients[piece])

    def piece(self, time: float) -> int:
        """Return the index of the polynomial that holds at a time; a knot belongs to what follows it."""
        return max(int(self.knots.searchsorted(time, side="right")) - 1, 0)

    def _values(self, since: Floats | float, polynomials: Floats) -> Floats:
        """Return values of polynomials, from shape (..., powers, inputs) to (..., inputs)."""
        values = polynomials[..., -1, :]
        for power in reversed(range(self.powers - 1)):
            values = values * since + polynomials[..., power, :]
        return np.asarray(values)
