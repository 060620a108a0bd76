"""What every data set is, and how those of known laws are simulated: exact trajectories, measured with noise."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from inspect import signature
from typing import TYPE_CHECKING, Any, Generic, ParamSpec, Protocol

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.runtime.arguments import check_whole_number
from commonlaw.runtime.progress import check_memory
from commonlaw.text import counted
from commonlaw.trials import Schema, Trial, Trials

if TYPE_CHECKING:
    from commonlaw.law import Law


P = ParamSpec("P")

DE_SILVA_2020 = (
    "B. M. de Silva, D. M. Higdon, S. L. Brunton and J. N. Kutz, Discovery of Physics from Data: Universal Laws and "
    "Discrepancies, Frontiers in Artificial Intelligence 3:25 (2020), doi:10.3389/frai.2020.00025"
)


@dataclass(frozen=True)
class Dataset(Generic[P]):
    """Named data set; calling it loads or simulates its trials.

    Parameters
    ----------
    name
        Name on the command line: ``"linear-drag"``.
    summary
        Description in one line.
    citation
        Source.
    load
        Function that returns the trials; its parameters are the options of the data set.
    law
        Function that returns the true law for these options; None if it is not known.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drag = cl.datasets.DATASETS["linear-drag"]
    >>> drag(noise=0.05), drag.truth(noise=0.05).structure
    (<Trials: 10 trials of 5 objects, 490 samples of x>, ("x'' = a + b v",))
    """

    name: str
    summary: str
    citation: str = field(repr=False)
    load: Callable[P, Trials] = field(repr=False)
    law: "Callable[..., Law] | None" = field(repr=False)

    def __post_init__(self) -> None:
        # So that help, completion and messages about options show those of `load`
        object.__setattr__(self, "__signature__", signature(self.load))
        object.__setattr__(self, "__doc__", self.load.__doc__)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> Trials:
        """Return the trials, see `load`."""
        return self.load(*args, **kwargs)

    def truth(self, *args: Any, **kwargs: Any) -> "Law":
        """Return the law behind the trials that the same options load.

        Raises
        ------
        CommonlawError
            If it is not known, or an option cannot be.
        """
        if self.law is None:
            raise CommonlawError("dataset-without-law", name=self.name)
        options = signature(self.load).bind(*args, **kwargs)
        options.apply_defaults()
        return self.law(**{name: options.arguments[name] for name in signature(self.law).parameters})


class NormalSource(Protocol):
    """What standard normals are drawn from: `numpy.random.Generator`, or the older `numpy.random.RandomState`."""

    def standard_normal(self, size: tuple[int, ...]) -> Floats:
        """Return independent standard normals of this shape."""


PerObject = float | Sequence[float]
"""A number of each object, or one that serves all."""


Seed = int | NormalSource
Path = Callable[[NormalSource], Floats]
"""Simulates one trial: from a source for its random initial state to noise-free states, shape (n, states)."""


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
    check_memory(
        f"{counted(trials, 'trial')} of {counted(len(paths), 'object')}, {counted(len(times), 'sample')} each,",
        size,
        "take fewer",
    )
    source = np.random.default_rng(seed) if isinstance(seed, int | np.integer) else seed
    measured = [
        Trial(name, str(number), times, states + noise * source.standard_normal(states.shape))
        for name, path in paths.items()
        for number in range(1, trials + 1)
        for states in [path(source)]
    ]
    how = f"with white noise of standard deviation {noise:g}" if noise else "without noise"
    return Trials(tuple(measured), schema, properties or {}, (f"simulated, {how}",))


def fixed(states: Floats) -> Path:
    """Return the path that is the same in every trial."""
    return lambda _: states


def sample_times(samples: int, rate: float) -> Floats:
    """Return the times of samples taken at a rate (samples for each unit of time) from 0 on, shape (samples,)."""
    check_whole_number("samples", samples, 2, 10_000_000)
    return np.arange(samples) / numbers("rate", rate, positive=True)[0]


def numbers(name: str, values: PerObject, *, positive: bool = False) -> tuple[float, ...]:
    """Return one or several numbers as a tuple, if they are finite, and positive where they must be."""
    try:
        result = tuple(float(each) for each in np.atleast_1d(values))
    except (TypeError, ValueError):
        raise CommonlawError("experiment-not-a-number", name=name, values=values) from None
    if not result:
        raise CommonlawError("experiment-empty", name=name)
    for each in result:
        if not np.isfinite(each) or (positive and each <= 0):
            raise CommonlawError(
                "experiment-not-positive", name=name, value=each, condition=" and positive" if positive else ""
            )
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


def exact_trajectory(field: Callable[[float, Floats], Floats], initial: ArrayLike, times: Floats, name: str) -> Floats:
    """Return the states at `times`, shape (n, d), of the object `name` that moves by ``y' = field(t, y)``."""
    from commonlaw.integration import integrate

    result = integrate(field, np.asarray(initial, dtype=np.float64), times, relative_tolerance=1e-11, where=name)
    if result.outcome is not None:
        raise CommonlawError("simulation-failed", name=name, reason=result.outcome.text)
    return result.states


def exact_heights(acceleration: Callable[[float], float], start: float, times: Floats, name: str) -> Floats:
    """Return the heights at `times`, shape (n, 1), of what moves by ``x'' = acceleration(x')`` from rest."""

    def field(_: float, y: Floats) -> Floats:
        return np.array([y[1], acceleration(y[1])])

    return exact_trajectory(field, (start, 0.0), times, name)[:, :1]


def exact_path(
    derivatives: Callable[[tuple[float, ...], Floats], Sequence[float]],
    start: Callable[[tuple[float, ...], NormalSource], Floats],
    coefficients: tuple[float, ...],
    times: Floats,
    name: str,
) -> Path:
    """Return what draws a start and runs from there by ``y' = derivatives(coefficients, y)``."""

    def field(_: float, y: Floats) -> Floats:
        return np.array(derivatives(coefficients, y))

    return lambda source: exact_trajectory(field, start(coefficients, source), times, name)


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
    values = np.array(list(coefficients.values()))
    return Law(parsed, schema, 2 if rates else 1, tuple(coefficients), values)
