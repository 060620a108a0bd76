"""The banded system that the methods share which penalise changes of slope.

``D z`` lists the changes of slope, at the inner samples, of the polygon through z. A state x is smoothed by solving
``z + D' y = x``, ``D z - C y = 0`` for z and the multipliers y; methods differ in C alone. In the order z0, y0, z1,
y1, ... the matrix has three bands on either side; the first and the last y are idle. Work and memory are linear in the
number of samples, and digits last for 50 000 samples, where the equation for z alone has lost them all.
"""

import numpy as np

from commonlaw.array_types import Floats

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


def solve(bands: Floats, state: Floats) -> tuple[Floats, Floats]:
    """Return z and y, each of shape (n,), for a state of shape (n,)."""
    from scipy.linalg import solve_banded

    known = np.zeros(2 * len(state))
    known[::2] = state
    solution = solve_banded((3, 3), bands, known)
    return solution[::2], solution[1::2]


def log_determinant(bands: Floats) -> float:
    """Return the logarithm of the absolute determinant of the system."""
    from scipy.linalg.lapack import dgbtrf

    factors, _, _ = dgbtrf(np.pad(bands, ((3, 0), (0, 0))), 3, 3)
    return float(np.log(np.abs(factors[6])).sum())
