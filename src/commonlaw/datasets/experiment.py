"""Simulated experiments: which objects there are, when samples are taken, and how noise comes in."""

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.runtime.arguments import check_whole_number
from commonlaw.runtime.progress import check_memory
from commonlaw.text import counted
from commonlaw.trials import Schema, Trial, Trials


class NormalSource(Protocol):
    """What standard normals are drawn from: `numpy.random.Generator`, or the older `numpy.random.RandomState`."""

    def standard_normal(self, size: tuple[int, ...]) -> Floats:
        """Return independent standard normals of this shape."""


PerObject = float | Sequence[float]
"""A number of each object, or one that serves all."""

_MOST_SAMPLES = 10_000_000
"""Of a trial."""

_BYTES_A_TRIAL, _BYTES_A_VALUE = 2000, 32

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
    size = trials * len(paths) * (_BYTES_A_TRIAL + _BYTES_A_VALUE * len(times) * len(schema.states))
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
    check_whole_number("samples", samples, 2, _MOST_SAMPLES)
    return np.arange(samples) / numbers("rate", rate, positive=True)[0]


def numbers(name: str, values: PerObject, *, positive: bool = False) -> tuple[float, ...]:
    """Return one or several numbers as a tuple, if they are finite, and positive where they must be."""
    try:
        found = tuple(float(each) for each in np.atleast_1d(values))
    except (TypeError, ValueError):
        raise CommonlawError("experiment-not-a-number", name=name, values=values) from None
    if not found:
        raise CommonlawError("experiment-empty", name=name)
    for each in found:
        if not np.isfinite(each) or (positive and each <= 0):
            raise CommonlawError(
                "experiment-not-positive", name=name, value=each, condition=" and positive" if positive else ""
            )
    return found


def objects(kind: str, *, positive: bool = False, **coefficients: PerObject) -> dict[str, tuple[float, ...]]:
    """Return the coefficients of objects called ``<kind> 1``, ``<kind> 2``, ...; a single number serves all objects."""
    columns = {name: numbers(name, values, positive=positive) for name, values in coefficients.items()}
    longest = max(map(len, columns.values()))
    for name, column in columns.items():
        if len(column) not in (1, longest):
            sizes = ", ".join(f"{len(each)} {key}" for key, each in columns.items())
            raise CommonlawError("experiment-sizes", name=name, sizes=sizes)
    rows = zip(*(column * (longest // len(column)) for column in columns.values()), strict=True)
    return {f"{kind} {i}": row for i, row in enumerate(rows, 1)}
