"""The banded system that the methods share which penalise changes of slope.

``D z`` lists the changes of slope, at the inner samples, of the polygon through z. A state x is smoothed by solving
``z + D' y = x``, ``D z - C y = 0`` for z and the multipliers y; methods differ in C alone. In the order z0, y0, z1,
y1, ... the matrix has three bands on either side; the first and the last y are idle. Work and memory are linear in the
number of samples, and digits last for 50 000 samples, where the equation for z alone has lost them all.
"""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats, Indices

_BANDS = 3
"""On either side."""

INNER = slice(3, -1, 2)
"""Where the multipliers of the inner samples stand."""


def slope_bands(steps: Floats) -> Floats:
    """Return the system's bands without C, shape (7, 2 n), as SciPy's banded solvers take them."""
    bands = np.zeros((7, 2 * len(steps) + 2))
    bands[3] = 1
    bands[3, INNER] = 0
    multipliers = np.arange(bands.shape[1])[INNER]
    left, right = 1 / steps[:-1], 1 / steps[1:]
    for shift, slope in ((-3, left), (-1, -(left + right)), (1, right)):
        bands[3 - shift, multipliers + shift] = bands[3 + shift, multipliers] = slope
    return bands


@dataclass(frozen=True, eq=False)
class Factors:
    """The factors of a system, with which it is solved and its determinant taken."""

    triangular: Floats
    pivots: Indices

    @classmethod
    def of(cls, bands: Floats) -> "Factors":
        """Factor the system of these bands, shape (7, 2 n)."""
        from scipy.linalg.lapack import dgbtrf

        room = np.zeros((_BANDS + len(bands), bands.shape[1]), order="F")
        room[_BANDS:] = bands
        triangular, pivots, _ = dgbtrf(room, _BANDS, _BANDS, overwrite_ab=True)
        return cls(triangular, pivots)

    def solve(self, state: Floats) -> tuple[Floats, Floats]:
        """Return z and y, each of shape (n,), for a state of shape (n,)."""
        from scipy.linalg.lapack import dgbtrs

        if not self.triangular[2 * _BANDS].all():
            raise np.linalg.LinAlgError("singular matrix")
        known = np.zeros(2 * len(state))
        known[::2] = state
        solution, _ = dgbtrs(self.triangular, _BANDS, _BANDS, known, self.pivots, overwrite_b=True)
        return solution[::2], solution[1::2]

    @property
    def log_determinant(self) -> float:
        """The logarithm of the absolute determinant of the system."""
        return float(np.log(np.abs(self.triangular[2 * _BANDS])).sum())


def solve(bands: Floats, state: Floats) -> tuple[Floats, Floats]:
    """Return z and y, each of shape (n,), for a state of shape (n,)."""
    return Factors.of(bands).solve(state)
