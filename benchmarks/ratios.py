"""Laws that are ratios of two sums: how often they are found, and plain ones beside them; errors and intervals."""

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import commonlaw as cl
from benchmarks.machine import machine
from commonlaw.law.parameters import named_parameters

Floats = NDArray[np.float64]

RATIO = "ratio(poly:2, poly:2)"
STEP = 1e-5
"""Relative change of a parameter by which exact solutions are differentiated."""


class Kinetics(NamedTuple):
    """Rates of a state by its parameters, the law's form, parameters of three objects, starts, times, and signs.

    A coefficient of the law is its parameter times its sign; no signs where the form says all.
    """

    rate: Callable[..., Floats]
    form: str
    objects: Mapping[str, tuple[float, ...]]
    starts: tuple[float, ...]
    times: Floats
    signs: tuple[int, ...] = ()

    def solution(self, start: float, own: Sequence[float]) -> Floats:
        """Return the state at all times."""
        ends = float(self.times[0]), float(self.times[-1])
        found = solve_ivp(lambda _, s: self.rate(s, *own), ends, [start], t_eval=self.times, rtol=1e-11, atol=1e-13)
        return np.asarray(found.y[0])

    def noise(self, level: float) -> float:
        """Return the standard deviation of the noise: a share of that of all states."""
        return level * float(
            np.std([self.solution(start, name) for name in self.objects.values() for start in self.starts])
        )

    def measured(self, level: float, seed: int) -> cl.Trials:
        """Return trials of all objects from each start."""
        generator, noise, states, owners = np.random.default_rng(seed), self.noise(level), [], []
        for name, own in self.objects.items():
            for start in self.starts:
                states.append(self.solution(start, own) + noise * generator.standard_normal(len(self.times)))
                owners.append(name)
        return cl.Trials.from_arrays([self.times] * len(states), states, object=owners, names=["s"])

    def bounds(self, level: float) -> Floats:
        """Return the Cramer-Rao bounds of the parameters with free starts, shape (objects, parameters)."""
        return np.array([self._bound(name, self.noise(level)) for name in self.objects.values()])

    def _bound(self, own: Sequence[float], noise: float) -> Floats:
        count = len(own)
        information = np.zeros((count + len(self.starts),) * 2)
        for i, start in enumerate(self.starts):
            columns = np.zeros((len(self.times), len(information)))
            for k, value in enumerate((*own, start)):
                ends = [[*own, start] for _ in range(2)]
                ends[0][k], ends[1][k] = value * (1 + STEP), value * (1 - STEP)
                above, below = (self.solution(end[-1], end[:-1]) for end in ends)
                columns[:, k if k < count else count + i] = (above - below) / (2 * STEP * value)
            information += columns.T @ columns / noise**2
        return np.sqrt(np.diag(np.linalg.inv(information)))[:count]


KINETICS = {
    "Michaelis-Menten": Kinetics(
        lambda s, rate, half: -rate * s / (half + s),
        "s' = a s/(K + s)",
        {"a": (1.0, 0.5), "b": (2.0, 1.2), "c": (1.4, 1.6)},
        (5.0, 2.5),
        np.linspace(0, 5, 50),
        (-1, 1),
    ),
    "Hill": Kinetics(
        lambda s, rate, half: -rate * s**2 / (half**2 + s**2),
        "s' = a s^2/(K^2 + s^2)",
        {"a": (1.0, 0.7), "b": (2.0, 1.2), "c": (1.4, 1.6)},
        (5.0, 2.5),
        np.linspace(0, 8, 50),
        (-1, 1),
    ),
    "logistic": Kinetics(
        lambda s, rate, most: rate * s * (1 - s / most),
        "s' = a s + b s^2",
        {"a": (1.0, 3.0), "b": (0.7, 4.0), "c": (1.2, 5.0)},
        (0.3, 0.8),
        np.linspace(0, 8, 50),
    ),
    "decay": Kinetics(
        lambda s, rate: -rate * s,
        "s' = a s",
        {"a": (1.0,), "b": (0.7,), "c": (0.5,)},
        (5.0, 2.5),
        np.linspace(0, 5, 50),
    ),
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line for each law and level of noise."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ratios", description=__doc__)
    parser.add_argument("--only", nargs="+", default=tuple(KINETICS), choices=tuple(KINETICS), metavar="LAW")
    parser.add_argument("--noise", nargs="+", type=float, default=(0.01, 0.05), metavar="LEVEL", help="1 %% is 0.01")
    parser.add_argument("--draws", type=int, default=20, help="of the noise (default: %(default)s)")
    parser.add_argument("--library", default=RATIO, help="that laws are sought in (default: %(default)s)")
    chosen = parser.parse_args(arguments)
    heads = "law", "noise", "right", "errors over the bound", "intervals that hold", "CPU s"
    print(f"{machine()}\n\n| {' | '.join(heads)} |\n{'|---' * len(heads)}|")
    for name in chosen.only:
        for level in chosen.noise:
            print(line(name, level, chosen.draws, chosen.library), flush=True)


def line(name: str, level: float, draws: int, library: str = RATIO) -> str:
    """Return the line of the table for a law and a level of noise, by laws that are found in so many draws."""
    known, begun = KINETICS[name], time.process_time()
    laws = [cl.discover(known.measured(level, 1000 + seed), library=library, cache=False) for seed in range(draws)]
    took = (time.process_time() - begun) / draws
    right = [law for law in laws if law.structure == (known.form,)]
    cells = [name, f"{100 * level:g} %", f"{len(right)} of {draws}", "", "", f"{took:.1f}"]
    if known.signs and right:
        truth = np.array([*known.objects.values()]) * known.signs
        errors = np.array([named_parameters(law).values - truth for law in right]) / known.bounds(level)
        tables = [law.conf_int() for law in right]
        held = [table["low"].le(truth.ravel()) & table["high"].ge(truth.ravel()) for table in tables]
        cells[3:5] = f"{np.sqrt(np.mean(errors**2)):.2f}", f"{np.sum(held)} of {np.size(held)}"
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
