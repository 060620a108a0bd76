"""States that nobody measured: how often `discover` finds them, and how accurate `fit` is beside a bound."""

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import commonlaw as cl
from benchmarks.machine import machine
from commonlaw.array_types import Bools, Floats
from commonlaw.law.parameters import named_parameters

OBJECTS, SCATTER, NOISE = 10, 0.15, 0.01
"""Objects, how much their parameters scatter, and the noise relative to the spread of a state."""

_TIGHT: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-10, "method": "LSODA"}
_STEP = 1e-4


@dataclass(frozen=True)
class System:
    """A system of which one state is not measured.

    Parameters
    ----------
    rates
        Derivatives of all states by time, states and parameters.
    typical
        Parameters, in the order of their names.
    start
        Of all states.
    seen
        Names of those that are measured, by their index.
    times
        Of samples.
    equations, parameters, options
        What is fitted, and how.
    library, order, found
        What is sought, and the structures of laws that are right.
    """

    rates: Callable[..., list[float]]
    typical: Sequence[float]
    start: Sequence[float]
    seen: Mapping[int, str]
    times: Floats
    equations: str
    parameters: Sequence[str]
    library: str
    found: Sequence[str]
    order: int = 1
    options: Mapping[str, Any] = field(default_factory=dict)

    def solution(self, parameters: Floats, start: Floats) -> Floats:
        """Return measured states without noise, shape (states, samples)."""
        span = (self.times[0], self.times[-1])
        states = solve_ivp(self.rates, span, start, t_eval=self.times, args=tuple(parameters), **_TIGHT).y
        return np.asarray(states[list(self.seen)])

    def draw(self, seed: int) -> tuple[Floats, Floats, cl.Trials]:
        """Return parameters, shape (objects, parameters), noise of each state, and trials."""
        generator = np.random.default_rng(seed)
        values = self.typical * np.exp(SCATTER * generator.standard_normal((OBJECTS, len(self.typical))))
        exact = [self.solution(value, np.array(self.start)).T for value in values]
        noise = NOISE * np.std(np.concatenate(exact), axis=0)
        measured = [own + noise * generator.standard_normal(own.shape) for own in exact]
        objects = [f"object {i}" for i in range(OBJECTS)]
        names = list(self.seen.values())
        return values, noise, cl.Trials.from_arrays([self.times] * OBJECTS, measured, object=objects, names=names)

    def bound(self, parameters: Floats, noise: Floats, free: Sequence[int]) -> Floats:
        """Return the least standard errors of the parameters, if some starts are not known either."""
        at = np.concatenate([parameters, np.array(self.start)[list(free)]])

        def left(point: Floats) -> Floats:
            start = np.array(self.start, dtype=np.float64)
            start[list(free)] = point[len(parameters) :]
            return (self.solution(point[: len(parameters)], start) / noise[:, np.newaxis]).ravel()

        steps = _STEP * np.maximum(abs(at), 0.1)
        slopes = [(left(at + own) - left(at - own)) / (2 * own.sum()) for own in np.diag(steps)]
        information = np.array(slopes) @ np.array(slopes).T
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(information)))[: len(parameters)])


SYSTEMS: Mapping[str, System] = {
    "one compartment, depot": System(
        lambda _, z, ka, volume, k: [-ka * z[0], ka * z[0] / volume - k * z[1]],
        (1.5, 20.0, 0.3),
        (100.0, 0.0),
        {1: "conc"},
        np.linspace(0, 12, 30),
        "depot' = -ka depot; conc' = ka depot/V - k conc",
        ("ka", "V", "k"),
        "poly:2",
        ("conc' = a conc + b u", "u' = c u"),
        options={"starts": {"depot": 100.0}},
    ),
    "two compartments, depot": System(
        lambda _, z, ka, volume, b, q, p: [-ka * z[0], ka * z[0] / volume - b * z[1] + q * z[2], p * z[1] - q * z[2]],
        (1.5, 20.0, 0.8, 0.3, 0.5),
        (100.0, 0.0, 0.0),
        {1: "conc", 2: "slow"},
        np.linspace(0, 12, 30),
        "depot' = -ka depot; conc' = ka depot/V - b conc + q slow; slow' = p conc - q slow",
        ("ka", "V", "b", "q", "p"),
        "poly:2",
        ("conc' = a conc + b slow + c u", "slow' = d conc + f slow", "u' = g u"),
        options={"starts": {"depot": 100.0}},
    ),
    "epidemic, susceptible": System(
        lambda _, z, b, g: [-b * z[0] * z[1], b * z[0] * z[1] - g * z[1]],
        (5e-4, 0.15),
        (990.0, 10.0),
        {1: "I"},
        np.linspace(0, 40, 40),
        "S' = -b S I; I' = b S I - g I",
        ("b", "g"),
        "poly:2",
        ("I' = a I + b I u", "u' = c I u"),
        options={"starts": {"S": 990.0}},
    ),
    "pendulum, slow drive": System(
        lambda t, z, g, c, d, r: [z[1], -g * np.sin(z[0]) - c * z[1] + d * np.exp(-r * t)],
        (4.0, 0.2, 1.5, 0.25),
        (1.2, 0.0),
        {0: "theta"},
        np.linspace(0, 12, 100),
        "theta'' = -g sin(theta) - c v + d exp(-r t)",
        ("g", "c", "d", "r"),
        "poly:2 + terms:sin(theta),cos(theta)",
        ("theta'' = a v + b sin(theta) + c exp(-r*t)",),
        order=2,
    ),
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print how often laws are found, and how accurate their coefficients are if the equations are given."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.unmeasured", description=__doc__)
    parser.add_argument("--only", nargs="+", default=tuple(SYSTEMS), choices=tuple(SYSTEMS), metavar="NAME")
    parser.add_argument("--seeds", type=int, default=10, help="draws that laws are sought in (default: %(default)s)")
    parser.add_argument("--fits", type=int, default=20, help="draws that are fitted (default: %(default)s)")
    chosen = parser.parse_args(arguments)
    print(f"{machine()}\n\n| system | found | CPU s | errors over the bound | intervals held | CPU s |")
    print("|---|---|---|---|---|---|")
    for name in chosen.only:
        system = SYSTEMS[name]
        right, sought = _found(system, chosen.seeds)
        over, held, fitted = _fitted(system, chosen.fits)
        print(f"| {name} | {right} of {chosen.seeds} | {sought:.0f} | {over:.2f} | {held} | {fitted:.1f} |", flush=True)


def _found(system: System, seeds: int) -> tuple[int, float]:
    """Return in how many draws the law is right, and the CPU time that one takes."""
    right, begun = 0, time.process_time()
    for seed in range(seeds):
        trials = system.draw(seed)[-1]
        law = cl.discover(trials, order=system.order, library=system.library, latent_states=1, cache=False)
        right += law.structure == tuple(system.found)
    return right, (time.process_time() - begun) / max(seeds, 1)


def _fitted(system: System, seeds: int) -> tuple[float, str, float]:
    """Return errors over the bound, root mean square, how many intervals held, and the CPU time of a fit."""
    relative, inside, took = list[Floats](), list[Bools](), 0.0
    free = range(len(system.start)) if system.order == 2 else range(1, len(system.start))
    for seed in range(1000, 1000 + seeds):
        values, noise, trials = system.draw(seed)
        begun = time.process_time()
        law = cl.fit(system.equations, trials, errors="white", partial_pooling=False, **system.options)
        took += time.process_time() - begun
        columns = [named_parameters(law).names.index(name) for name in system.parameters]
        low, high = (each[:, columns] for each in named_parameters(law).intervals())
        inside.append(np.asarray((low < values) & (values < high)))
        bounds = np.array([system.bound(value, noise, free) for value in values])
        relative.append((named_parameters(law).values[:, columns] - values) / bounds)
    held = np.concatenate(inside)
    return (
        float(np.sqrt(np.mean(np.concatenate(relative) ** 2))),
        f"{held.mean():.3f} of {held.size}",
        took / max(seeds, 1),
    )


if __name__ == "__main__":
    main()
