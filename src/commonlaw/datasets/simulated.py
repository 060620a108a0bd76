"""Simulated data sets, whose law is known: exact trajectories, measured with noise.

Drops of balls with linear drag and with that of real spheres; of textbooks an oscillator, prey and predators, and
chaos.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.datasets import sphere_drag
from commonlaw.datasets.dataset import DE_SILVA_2020, Dataset
from commonlaw.datasets.sphere_drag import AIR_DENSITY, AIR_VISCOSITY
from commonlaw.errors import CommonlawError
from commonlaw.runtime.arguments import check_whole_number
from commonlaw.runtime.progress import check_memory
from commonlaw.text import counted
from commonlaw.trials import Schema, Trial, Trials

if TYPE_CHECKING:
    from commonlaw.law import Law


class NormalSource(Protocol):
    """What standard normals are drawn from: `numpy.random.Generator`, or the older `numpy.random.RandomState`."""

    def standard_normal(self, size: tuple[int, ...]) -> Floats:
        """Return independent standard normals of this shape."""


PerObject = float | Sequence[float]
"""A number of each object, or one that serves all."""


Seed = int | NormalSource
Path = Floats | Callable[[NormalSource], Floats]
"""Noise-free states, shape (n, states); or what simulates them for one trial from a random initial state."""


def measure(
    paths: Mapping[str, Path],
    schema: Schema,
    times: Floats,
    trials: int,
    noise: float,
    seed: Seed,
    properties: Mapping[str, Mapping[str, float]] | None = None,
) -> Trials:
    """Return trials called ``1``, ``2``, ... of objects by name, measured at `times`, shape (n,).

    White noise of standard deviation `noise` is added to every state. A source given as the seed is drawn from object
    by object, trial by trial, at every noise level alike.
    """
    check_whole_number("trials", trials, 1)
    if numbers("noise", noise)[0] < 0:
        raise CommonlawError("noise-negative", noise=noise)
    if not hasattr(seed, "standard_normal"):
        check_whole_number("seed", seed, 0)
    # Bytes: 2000 a trial, 32 a value
    size = trials * len(paths) * (2000 + 32 * len(times) * len(schema.states))
    what = f"{counted(trials, 'trial')} of {counted(len(paths), 'object')}, {counted(len(times), 'sample')} each,"
    check_memory(what, size, "take fewer")
    source = np.random.default_rng(seed) if isinstance(seed, int | np.integer) else seed
    measured = [
        Trial(name, str(number), times, states + noise * source.standard_normal(states.shape))
        for name, path in paths.items()
        for number in range(1, trials + 1)
        for states in [path(source) if callable(path) else path]
    ]
    how = f"with white noise of standard deviation {noise:g}" if noise else "without noise"
    return Trials(tuple(measured), schema, properties or {}, (f"simulated, {how}",))


def sample_times(samples: int, rate: float) -> Floats:
    """Return the times of samples taken at a rate (samples for each unit of time) from 0 on, shape (samples,)."""
    check_whole_number("samples", samples, 2, 10_000_000)
    return np.arange(samples) / numbers("rate", rate, positive=True)[0]


def numbers(name: str, values: PerObject, *, positive: bool = False) -> tuple[float, ...]:
    """Return one or several numbers as a tuple, if they are finite, and positive where they must be."""
    try:
        result = tuple(float(number) for number in np.atleast_1d(values))
    except (TypeError, ValueError):
        raise CommonlawError("experiment-not-a-number", name=name, values=values) from None
    if not result:
        raise CommonlawError("experiment-empty", name=name)
    for number in result:
        if not np.isfinite(number) or (positive and number <= 0):
            condition = " and positive" if positive else ""
            raise CommonlawError("experiment-not-positive", name=name, value=number, condition=condition)
    return result


def objects(kind: str, *, positive: bool = False, **coefficients: PerObject) -> dict[str, tuple[float, ...]]:
    """Return the coefficients of objects called ``<kind> 1``, ``<kind> 2``, ...; a single number serves all objects."""
    columns = {name: numbers(name, values, positive=positive) for name, values in coefficients.items()}
    longest = max(map(len, columns.values()))
    for name, column in columns.items():
        if len(column) not in (1, longest):
            sizes = ", ".join(f"{len(column)} {key}" for key, column in columns.items())
            raise CommonlawError("experiment-sizes", name=name, sizes=sizes)
    rows = zip(*(column * (longest // len(column)) for column in columns.values()), strict=True)
    return {f"{kind} {i}": row for i, row in enumerate(rows, 1)}


def exact_trajectory(field: Callable[[Floats], Floats], initial: ArrayLike, times: Floats, name: str) -> Floats:
    """Return the states at `times`, shape (n, d), of the object `name` that moves by ``y' = field(y)``."""
    from commonlaw.integration import integrate

    start = np.asarray(initial, dtype=np.float64)
    result = integrate(lambda _, y: field(y), start, times, relative_tolerance=1e-11, where=name)
    if result.outcome is not None:
        raise CommonlawError("simulation-failed", name=name, reason=result.outcome.text)
    return result.states


def _heights(acceleration: Callable[[float], float], start: float, times: Floats, name: str) -> Floats:
    """Return the heights at `times`, shape (n, 1), of what moves by ``x'' = acceleration(x')`` from rest."""
    return exact_trajectory(lambda y: np.array([y[1], acceleration(y[1])]), (start, 0.0), times, name)[:, :1]


def exact_law(
    schema: Schema,
    terms: Sequence[str],
    coefficients: Mapping[str, Sequence[Sequence[float]]],
    rates: Sequence[str] = (),
) -> "Law":
    """Return a law that is known, from its terms as expressions, and by object a row of numbers for each equation.

    Of second order it is if there are names of the states' rates.
    """
    from commonlaw.law import Law
    from commonlaw.library import Terms, Variables, parse_term

    variables = Variables((*schema.states, *rates), time=schema.time)
    parsed = Terms(variables, tuple(parse_term(term, variables) for term in terms))
    return Law(parsed, schema, 2 if rates else 1, tuple(coefficients), np.array(list(coefficients.values())))


_UNITS = {"x": "m", "t": "s"}
_LINEAR = Schema(("x",), units={**_UNITS, "drag": "1/s"})
_SPHERES = Schema(("x",), units={**_UNITS, "radius": "m", "mass": "kg"})


def _load_linear(
    drag: PerObject = (-0.1, -0.3, -0.3, -0.5, -0.7),
    gravity: float = -9.8,
    trials: int = 2,
    samples: int = 49,
    rate: float = 15.0,
    height: float = 47.33,
    noise: float = 0.01,
    seed: Seed = 0,
    quadratic: PerObject = 0.0,
) -> Trials:
    """Return drops of balls that obey ``x'' = gravity + drag x'`` from rest (de Silva et al. 2020, section 2.2).

    The heights are exact, but for the noise: ``height + gravity t^2 M(1, 3, drag t) / 2`` with Kummer's function M.
    With `quadratic` the balls obey ``x'' = gravity + drag x' + quadratic x'^2``, which is integrated.

    Raises `CommonlawError` if an option cannot be, such as a negative noise, or a negative `quadratic` with which a
    ball runs away.

    Parameters
    ----------
    drag
        Drag coefficient of each ball, 1/s; negative slows the ball down, 0 is free fall.
    gravity
        m/s^2, negative is down.
    trials, samples, rate
        Drops of each ball, heights measured in each drop, and measurements in a second.
    height, noise
        At the start, and the standard deviation of the white noise on all heights, m.
    seed
        A whole number; or a NumPy generator of random numbers, which is drawn from ball by ball, drop by drop.
    quadratic
        Coefficient of the squared velocity for each ball, 1/m; positive slows a falling ball down.
    """
    from scipy.special import hyp1f1

    balls = objects("Ball", drag=drag, quadratic=quadratic)
    times = sample_times(samples, rate)
    start, g = numbers("height", height)[0], numbers("gravity", gravity)[0]

    def acceleration(v: float, slope: float, square: float) -> float:
        return g + slope * v + square * v**2

    paths = dict[str, Path]()
    for name, (slope, square) in balls.items():
        if square:
            paths[name] = _heights(partial(acceleration, slope=slope, square=square), start, times, name)
        else:
            paths[name] = (start + g * times**2 / 2 * hyp1f1(1.0, 3.0, slope * times))[:, np.newaxis]
    properties = {name: {"drag": slope} for name, (slope, _) in balls.items()}
    return measure(paths, _LINEAR, times, trials, noise, seed, properties)


def _truth_of_linear(drag: PerObject, gravity: float, quadratic: PerObject) -> "Law":
    """Return the law of these balls: ``x'' = gravity + drag v``, and ``+ quadratic v^2`` where a ball has that."""
    balls = objects("Ball", drag=drag, quadratic=quadratic)
    terms = ["1", "v", "v**2"] if any(square for _, square in balls.values()) else ["1", "v"]
    rows = {name: [[gravity, *ball][: len(terms)]] for name, ball in balls.items()}
    return exact_law(_LINEAR, terms, rows, rates=["v"])


linear_drag = Dataset(
    "linear-drag",
    "simulated drops of five balls with linear drag: x'' = -9.8 + D x'",
    DE_SILVA_2020,
    _load_linear,
    _truth_of_linear,
)


PRINTED_VISCOSITY = 2 / 3 * 1e-5
"""Kinematic viscosity, m^2/s, behind the printed results of de Silva et al. (2020).

Their air, 1.211 kg/m^3 and 1.82e-5 Pa s, has 1.503e-5 m^2/s (`AIR_VISCOSITY`). The Reynolds numbers of their ball table
and of their simulated drops were computed with 2/3e-5 m^2/s instead, and so are 2.25 times too large. Their simulated
balls had the measured radii and masses (golf ball 1.6 oz); the table of them, the default here, has rounded values.
"""


def _load_spheres(
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

    Raises `CommonlawError` if an option cannot be, such as a negative mass.

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
    """
    balls = _balls(radius, mass, viscosity, density)
    times = sample_times(samples, rate)
    start, g = numbers("height", height)[0], numbers("gravity", gravity)[0]

    def acceleration(v: float, size: float, weight: float) -> float:
        return g - float(np.sign(v) * sphere_drag.drag_force(abs(v), 2 * size, density, viscosity)) / weight

    paths = {
        name: _heights(partial(acceleration, size=size, weight=weight), start, times, name)
        for name, (size, weight) in balls.items()
    }
    properties = {name: dict(zip(("radius", "mass"), ball, strict=True)) for name, ball in balls.items()}
    return measure(paths, _SPHERES, times, trials, noise, seed, properties)


def _truth_of_spheres(radius: PerObject, mass: PerObject, viscosity: float, gravity: float, density: float) -> "Law":
    """Return the exact law of these balls.

    The correlation of Brown and Lawler makes the drag a sum of ``v``, ``|v|^1.681`` and ``v^3 / (|v| + c)``, where
    ``c = 8710 viscosity / diameter``: one such rational term for each distinct radius, with a coefficient for the balls
    of that radius only. All are odd in v, as drag is, and smooth enough at rest for exact derivatives.
    """
    balls = _balls(radius, mass, viscosity, density)
    radii = list(dict.fromkeys(ball_radius for ball_radius, _ in balls.values()))
    bends = [sphere_drag.TRANSITION * viscosity / (2 * ball_radius) for ball_radius in radii]
    inertia = f"sign(v)*abs(v)**{1 + sphere_drag.EXPONENT}"
    terms = ["1", "v", inertia, *(f"v**3/(abs(v) + {bend!r})" for bend in bends)]
    rows = {}
    for name, (size, weight) in balls.items():
        slope = 2 * size / viscosity  # of the Reynolds number over the speed
        scale = -np.pi / 4 * density * size * viscosity / weight
        viscous, pressure = scale * sphere_drag.STOKES, scale * sphere_drag.PRESSURE * slope
        inertial = viscous * sphere_drag.INERTIA * slope**sphere_drag.EXPONENT
        rows[name] = [[gravity, viscous, inertial, *(pressure if r == size else 0.0 for r in radii)]]
    return exact_law(_SPHERES, terms, rows, rates=["v"])


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
    _load_spheres,
    _truth_of_spheres,
)


_PLANE = Schema(("x", "y"))
_SPACE = Schema(("x", "y", "z"))

_NAME = "Oscillator"
_MATRIX = np.array([[-0.1, 2.0], [-2.0, -0.1]])


def _load_oscillator(samples: int = 500, step: float = 0.01, noise: float = 0.0, seed: Seed = 0) -> Trials:
    """Return a run of ``x' = -0.1 x^3 + 2 y^3``, ``y' = -2 x^3 - 0.1 y^3`` from (2, 0).

    It is the first example in the appendix of de Silva et al. (2020).

    Raises `CommonlawError` if an option cannot be, such as a negative noise.

    Parameters
    ----------
    samples
        Number of samples.
    step
        Time from one sample to the next.
    noise
        Standard deviation of the white noise on both states.
    seed
        A whole number, or a NumPy generator of random numbers.
    """
    times = sample_times(samples, 1 / numbers("step", step, positive=True)[0])
    states = exact_trajectory(lambda y: np.asarray(_MATRIX @ y**3), (2.0, 0.0), times, _NAME)
    return measure({_NAME: states}, _PLANE, times, 1, noise, seed)


def _truth_of_oscillator() -> "Law":
    return exact_law(_PLANE, ["x**3", "y**3"], {_NAME: _MATRIX.tolist()})


nonlinear_oscillator = Dataset(
    "nonlinear-oscillator",
    "simulated oscillator with cubic terms: x' = -0.1 x^3 + 2 y^3, y' = -2 x^3 - 0.1 y^3",
    DE_SILVA_2020,
    _load_oscillator,
    _truth_of_oscillator,
)


def _load_pairs(
    growth: PerObject = (1.0, 0.8, 1.2, 0.9, 1.1),
    predation: PerObject = (0.1, 0.08, 0.1, 0.12, 0.09),
    decline: PerObject = (1.5, 1.2, 1.0, 1.4, 1.3),
    reproduction: PerObject = (0.075, 0.06, 0.05, 0.07, 0.08),
    trials: int = 2,
    samples: int = 200,
    rate: float = 10.0,
    noise: float = 0.0,
    seed: Seed = 0,
) -> Trials:
    """Return runs of ``x' = growth x - predation x y``, ``y' = -decline y + reproduction x y``.

    Each run starts at the pair's equilibrium times ``exp(normal / 2)``, drawn for each species.

    Raises `CommonlawError` if an option cannot be, such as a negative rate.

    Parameters
    ----------
    growth, predation, decline, reproduction
        Positive rates of each pair of prey x and predators y; a single number serves all pairs.
    trials, samples, rate
        Runs of each pair, samples in each run, and samples in a unit of time.
    noise
        Standard deviation of the white noise on both numbers of animals.
    seed
        A whole number; or a NumPy generator of random numbers, which is drawn from pair by pair, run by run: first
        the start, then the noise.
    """
    rates = {"growth": growth, "predation": predation, "decline": decline, "reproduction": reproduction}
    times = sample_times(samples, rate)

    def path(name: str, a: float, b: float, c: float, d: float) -> Path:
        def field(y: Floats) -> Floats:
            return np.array([a * y[0] - b * y[0] * y[1], -c * y[1] + d * y[0] * y[1]])

        centre = np.array([c / d, a / b])
        return lambda source: exact_trajectory(field, centre * np.exp(source.standard_normal((2,)) / 2), times, name)

    paths = {name: path(name, *row) for name, row in objects("Pair", positive=True, **rates).items()}
    return measure(paths, _PLANE, times, trials, noise, seed)


def _truth_of_pairs(growth: PerObject, predation: PerObject, decline: PerObject, reproduction: PerObject) -> "Law":
    rates = {"growth": growth, "predation": predation, "decline": decline, "reproduction": reproduction}
    pairs = objects("Pair", positive=True, **rates)
    rows = {name: [[a, 0.0, -b], [0.0, -c, d]] for name, (a, b, c, d) in pairs.items()}
    return exact_law(_PLANE, ["x", "y", "x*y"], rows)


lotka_volterra = Dataset(
    "lotka-volterra",
    "simulated prey and predators, five pairs of species: x' = a x - b x y, y' = -c y + d x y",
    "A. J. Lotka, Elements of Physical Biology (1925); V. Volterra, Fluctuations in the Abundance of a Species "
    "considered Mathematically, Nature 118 (1926) 558",
    _load_pairs,
    _truth_of_pairs,
)


def _load_lorenz(
    sigma: PerObject = 10.0,
    rho: PerObject = 28.0,
    beta: PerObject = 8 / 3,
    trials: int = 2,
    samples: int = 1000,
    rate: float = 100.0,
    noise: float = 0.0,
    seed: Seed = 0,
) -> Trials:
    """Return runs of ``x' = sigma (y - x)``, ``y' = x (rho - z) - y``, ``z' = x y - beta z`` (Lorenz 1963).

    Each run starts at (-8, 8, 27) plus a standard normal on each state.

    Raises `CommonlawError` if an option cannot be, such as a negative noise.

    Parameters
    ----------
    sigma, rho, beta
        Coefficients of each system; a single number serves all systems, and single numbers make one system.
    trials, samples, rate
        Runs of each system, samples in each run, and samples in a unit of time.
    noise
        Standard deviation of the white noise on every state.
    seed
        A whole number; or a NumPy generator of random numbers, which is drawn from system by system, run by run: first
        the start, then the noise.
    """
    times, middle = sample_times(samples, rate), np.array([-8.0, 8.0, 27.0])

    def path(name: str, s: float, r: float, b: float) -> Path:
        def field(y: Floats) -> Floats:
            return np.array([s * (y[1] - y[0]), y[0] * (r - y[2]) - y[1], y[0] * y[1] - b * y[2]])

        return lambda source: exact_trajectory(field, middle + source.standard_normal((3,)), times, name)

    paths = {name: path(name, *row) for name, row in objects("System", sigma=sigma, rho=rho, beta=beta).items()}
    return measure(paths, _SPACE, times, trials, noise, seed)


def _truth_of_lorenz(sigma: PerObject, rho: PerObject, beta: PerObject) -> "Law":
    rows = {
        name: [[-s, s, 0.0, 0.0, 0.0], [r, -1.0, 0.0, 0.0, -1.0], [0.0, 0.0, -b, 1.0, 0.0]]
        for name, (s, r, b) in objects("System", sigma=sigma, rho=rho, beta=beta).items()
    }
    return exact_law(_SPACE, ["x", "y", "z", "x*y", "x*z"], rows)


lorenz = Dataset(
    "lorenz",
    "simulated chaos: x' = 10 (y - x), y' = x (28 - z) - y, z' = x y - 8/3 z",
    "E. N. Lorenz, Deterministic Nonperiodic Flow, Journal of the Atmospheric Sciences 20 (1963) 130",
    _load_lorenz,
    _truth_of_lorenz,
)
