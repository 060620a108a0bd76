"""Simulated drops of balls whose drag depends on the Reynolds number, as that of real spheres does."""

from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.datasets import sphere_drag
from commonlaw.datasets.dataset import (
    DE_SILVA_2020,
    Dataset,
    PerObject,
    Seed,
    exact_heights,
    exact_law,
    fixed,
    measure,
    numbers,
    objects,
    sample_times,
)
from commonlaw.datasets.sphere_drag import AIR_DENSITY, AIR_VISCOSITY
from commonlaw.trials import Schema, Trials

if TYPE_CHECKING:
    from commonlaw.law import Law

PRINTED_VISCOSITY = 2 / 3 * 1e-5
"""Kinematic viscosity, m^2/s, behind the printed results of de Silva et al. (2020).

Their air, 1.211 kg/m^3 and 1.82e-5 Pa s, has 1.503e-5 m^2/s (`AIR_VISCOSITY`). The Reynolds numbers of their ball table
and of their simulated drops were computed with 2/3e-5 m^2/s instead, and so are 2.25 times too large. Their simulated
balls had the measured radii and masses (golf ball 1.6 oz); the table of them, the default here, has rounded values.
"""

_SCHEMA = Schema(("x",), units={"x": "m", "t": "s", "radius": "m", "mass": "kg"})


def _load(
    radius: PerObject = (0.022, 0.033, 0.036, 0.035, 0.119),
    mass: PerObject = (0.0454, 0.0567, 0.0283, 0.1417, 0.5103),
    viscosity: float = AIR_VISCOSITY,
    gravity: float = -9.8,
    trials: int = 2,
    samples: int = 49,
    rate: float = 15.0,
    height: float = 47.33,
    noise: float = 0.01,
    seed: Seed = 0,
    density: float = AIR_DENSITY,
) -> Trials:
    """Return drops of smooth spheres in air from rest (de Silva et al. 2020, appendix on realistic simulations).

    They obey ``m x'' = m gravity - sign(x') rho A C_D(Re) x'^2 / 2`` with the C_D of
    `commonlaw.datasets.sphere_drag.drag_coefficient`. The default balls are like the golf ball, tennis ball, whiffle
    ball 1, baseball and blue basketball. The last one leaves the range of that correlation towards the end of its drop.

    Parameters
    ----------
    radius, mass
        Of each ball, m and kg.
    viscosity
        Kinematic viscosity of the air or another fluid, m^2/s. `PRINTED_VISCOSITY` gives what the paper printed.
    gravity
        m/s^2, negative is down.
    trials, samples, rate
        Drops of each ball, heights measured in each drop, and measurements in a second.
    height, noise
        At the start, and the standard deviation of the white noise on all heights, m.
    seed
        A whole number; or a NumPy generator of random numbers, which is drawn from ball by ball, drop by drop.
    density
        Of the air or another fluid, kg/m^3. Its buoyancy is left out, as in the paper.

    Raises
    ------
    CommonlawError
        If an option cannot be, such as a negative mass.
    """
    balls = _balls(radius, mass, viscosity, density)
    times = sample_times(samples, rate)
    start, acceleration = numbers("height", height)[0], numbers("gravity", gravity)[0]
    paths = {
        name: fixed(_drop(name, size, weight, (density, viscosity), acceleration, start, times))
        for name, (size, weight) in balls.items()
    }
    properties = {name: dict(zip(("radius", "mass"), ball, strict=True)) for name, ball in balls.items()}
    return measure(paths, _SCHEMA, times, trials, noise, seed, properties)


def _truth(radius: PerObject, mass: PerObject, viscosity: float, gravity: float, density: float) -> "Law":
    """Return the exact law of these balls.

    The correlation of Brown and Lawler makes the drag a sum of ``v``, ``|v|^1.681`` and ``v^3 / (|v| + c)``, where
    ``c = 8710 viscosity / diameter``: one such rational term for each distinct radius, with a coefficient for the balls
    of that radius only. All are odd in v, as drag is, and smooth enough at rest for exact derivatives.
    """
    balls = _balls(radius, mass, viscosity, density)
    radii = list(dict.fromkeys(each for each, _ in balls.values()))
    bends = [sphere_drag.TRANSITION * viscosity / (2 * each) for each in radii]
    inertia = f"sign(v)*abs(v)**{1 + sphere_drag.EXPONENT}"
    terms = ["1", "v", inertia, *(f"v**3/(abs(v) + {bend!r})" for bend in bends)]
    rows = {}
    for name, (size, weight) in balls.items():
        slope = 2 * size / viscosity  # of the Reynolds number over the speed
        scale = -np.pi / 4 * density * size * viscosity / weight
        viscous, pressure = scale * sphere_drag.STOKES, scale * sphere_drag.PRESSURE * slope
        inertial = viscous * sphere_drag.INERTIA * slope**sphere_drag.EXPONENT
        rows[name] = [[gravity, viscous, inertial, *(pressure if each == size else 0.0 for each in radii)]]
    return exact_law(_SCHEMA, terms, rows, rates=["v"])


def _drop(
    name: str, radius: float, mass: float, fluid: tuple[float, float], gravity: float, height: float, times: Floats
) -> Floats:
    """Return the heights of a drop without noise, m, shape (n, 1), in a fluid of some density and viscosity."""

    def acceleration(v: float) -> float:
        return gravity - float(np.sign(v) * sphere_drag.drag_force(abs(v), 2 * radius, *fluid)) / mass

    return exact_heights(acceleration, height, times, name)


def _balls(radius: PerObject, mass: PerObject, viscosity: float, density: float) -> dict[str, tuple[float, ...]]:
    """Return the checked radius and mass of each ball in a fluid that can be."""
    numbers("viscosity", viscosity, positive=True)
    numbers("density", density, positive=True)
    return objects("Ball", positive=True, radius=radius, mass=mass)


reynolds_drag = Dataset(
    "reynolds-drag",
    "simulated drops of five smooth balls whose drag depends on the Reynolds number",
    f"{DE_SILVA_2020}; drag after P. P. Brown and D. F. Lawler, Sphere Drag and Settling Velocity Revisited, "
    "Journal of Environmental Engineering 129 (2003) 222",
    _load,
    _truth,
)
