"""Drag on a smooth sphere in a fluid, in SI units; by default in air at 65 degrees Fahrenheit at sea level."""

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError

AIR_DENSITY = 1.211
"""kg/m^3 (White, Fluid Mechanics, 2003; as in de Silva et al. 2020)."""

AIR_DYNAMIC_VISCOSITY = 1.82e-5
"""Pa s (White, Fluid Mechanics, 2003; as in de Silva et al. 2020)."""

AIR_VISCOSITY = AIR_DYNAMIC_VISCOSITY / AIR_DENSITY
"""Kinematic viscosity, m^2/s."""

MAX_REYNOLDS = 2e5
"""Where the correlation of `drag_coefficient` ends: shortly before the drag crisis, in which the coefficient drops."""

# Brown and Lawler (2003): C_D Re = STOKES (1 + INERTIA Re^EXPONENT) + PRESSURE Re^2 / (Re + TRANSITION)
STOKES = 24.0
INERTIA = 0.150
EXPONENT = 0.681
PRESSURE = 0.407
TRANSITION = 8710.0


def reynolds_number(speed: ArrayLike, diameter: ArrayLike, viscosity: ArrayLike = AIR_VISCOSITY) -> Floats:
    """Return the Reynolds number ``speed * diameter / viscosity`` of a sphere.

    Raises `CommonlawError` if a value is not finite, or has the wrong sign.

    Parameters
    ----------
    speed
        Against the fluid, m/s, not negative.
    diameter
        m, positive.
    viscosity
        Kinematic viscosity of the fluid, m^2/s, positive.

    Returns
    -------
    NDArray
        Dimensionless, of the shape that the arguments have together.

    Examples
    --------
    >>> print(f"{reynolds_number(20, 0.044):.3g}")
    5.86e+04
    """
    return _checked("speed", speed, positive=False) * _checked("diameter", diameter) / _checked("viscosity", viscosity)


def drag_coefficient(reynolds: ArrayLike) -> Floats:
    """Return the drag coefficient of a smooth sphere, ``24/Re (1 + 0.150 Re^0.681) + 0.407/(1 + 8710/Re)``.

    The correlation was fitted to experiments at Re < 2e5 (`MAX_REYNOLDS`). Beyond, it is evaluated all the same, as
    simulations of large balls do, and is then too large: it does not know the drag crisis; `in_valid_range` tells.

    Raises `CommonlawError` if a value is not finite, or negative.

    Parameters
    ----------
    reynolds
        Reynolds number, not negative. At 0 the coefficient is infinite, while `drag_force` goes to 0.

    References
    ----------
    Brown and Lawler, Sphere drag and settling velocity revisited, J. Environ. Eng. 129 (2003) 222.

    Examples
    --------
    >>> print(f"{drag_coefficient(1e5):.4f}")
    0.4661
    """
    number = _checked("Reynolds number", reynolds, positive=False)
    with np.errstate(divide="ignore"):
        return _coefficient_times(number) / number


def in_valid_range(reynolds: ArrayLike) -> Bools:
    """Return where `drag_coefficient` rests on experiments: at Reynolds numbers below `MAX_REYNOLDS`."""
    return np.asarray(_checked("Reynolds number", reynolds, positive=False) < MAX_REYNOLDS)


def drag_force(
    speed: ArrayLike, diameter: ArrayLike, density: ArrayLike = AIR_DENSITY, viscosity: ArrayLike = AIR_VISCOSITY
) -> Floats:
    """Return the size of the drag force ``density C_D pi diameter^2 speed^2 / 8`` on a smooth sphere, in N.

    It is finite for every speed, and Stokes' ``3 pi density viscosity diameter speed`` for small ones.

    Raises `CommonlawError` if a value is not finite, or has the wrong sign.

    Parameters
    ----------
    speed
        Against the fluid, m/s, not negative.
    diameter
        m, positive.
    density, viscosity
        Of the fluid, kg/m^3 and m^2/s (the kinematic viscosity), positive.

    Examples
    --------
    >>> print(drag_force(0, 0.044), f"{drag_force(20, 0.044):.3f}")
    0.0 0.171
    """
    reynolds = reynolds_number(speed, diameter, viscosity)
    scale = _checked("density", density) * np.square(np.asarray(viscosity, dtype=np.float64))
    return np.pi / 8 * scale * reynolds * _coefficient_times(reynolds)


def _coefficient_times(reynolds: Floats) -> Floats:
    """Return the drag coefficient times the Reynolds number, which unlike the coefficient is finite at 0."""
    return STOKES * (1 + INERTIA * reynolds**EXPONENT) + PRESSURE * reynolds**2 / (reynolds + TRANSITION)


def _checked(name: str, values: ArrayLike, *, positive: bool = True) -> Floats:
    """Return numbers that are finite, and positive or at least not negative."""
    array = np.asarray(values, dtype=np.float64)
    good = np.isfinite(array) & ((array > 0) if positive else (array >= 0))
    if not np.all(good):
        rule = "be positive" if positive else "not be negative"
        raise CommonlawError("not-in-range", name=name, value=array[~good].flat[0], rule=rule)
    return array
