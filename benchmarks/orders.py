"""Whether the order of a law, or of each of its equations, is found, without and with noise."""

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

import commonlaw as cl
from benchmarks.families import FAMILIES, experiment
from benchmarks.machine import machine
from benchmarks.mixed_orders import MIXED
from commonlaw.library import Order, one_order

OBJECTS, TRIALS = 3, 2


def main(arguments: Sequence[str] | None = None) -> None:
    """Print how often the true order is found, by how much evidence, and what it costs."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.orders", description=__doc__)
    parser.add_argument("--only", nargs="+", default=tuple(SYSTEMS), choices=tuple(SYSTEMS), metavar="NAME")
    parser.add_argument(
        "--noise", nargs="+", type=float, default=(0.0, 0.01, 0.05), metavar="LEVEL", help="1 %% is 0.01"
    )
    parser.add_argument("--seeds", type=int, default=2, help="of the noise (default: %(default)s)")
    chosen = parser.parse_args(arguments)
    print(f"{machine()}\n\n| system | order | noise | right | why, of the first | CPU s |\n|---|---|---|---|---|---|")
    for name in chosen.only:
        order = SYSTEMS[name]
        for level in chosen.noise:
            begun = time.process_time()
            laws = [found(name, level, seed) for seed in range(chosen.seeds if level else 1)]
            right = f"{sum(law.order == order for law in laws)} of {len(laws)}"
            took = (time.process_time() - begun) / len(laws)
            why = laws[0].provenance.history[0].reason
            print(f"| {name} | {order} | {100 * level:g} % | {right} | {why} | {took:.1f} |", flush=True)


def found(name: str, level: float, seed: int) -> cl.Law:
    """Return the law that is found with no order given."""
    trials, library = _MADE[name](level, seed), "poly:3"
    if name != "relaxation":
        library = MIXED[name].library if name in MIXED else FAMILIES[name.partition(",")[0]].library
    return cl.discover(trials, order="auto", library=library, cache=False)


def relaxations(level: float, seed: int) -> cl.Trials:
    """Return trials of objects that go to values of their own, each at its rate."""
    generator, times = np.random.default_rng(seed), np.linspace(0, 5, 60)
    states, owners = [], []
    for i in range(OBJECTS):
        rate, rest = generator.uniform([0.6, 1.0], [1.4, 3.0])
        for start in generator.uniform(-1, 6, TRIALS):
            states.append(rest + (start - rest) * np.exp(-rate * times))
            owners.append(f"object {i + 1}")
    noise = level * np.mean([state.std() for state in states])
    measured = [state + noise * generator.standard_normal(state.shape) for state in states]
    return cl.Trials.from_arrays([times] * len(states), measured, object=owners, names=["x"])


def _of_family(name: str, level: float, seed: int) -> cl.Trials:
    return experiment(name, OBJECTS, TRIALS).measured(level, seed)


def _angles(level: float, seed: int) -> cl.Trials:
    """Return swings of which the angle alone is measured."""
    both = _of_family("pendulum", level, seed)
    times, states = [each.times for each in both], [each.states[:, 0] for each in both]
    return cl.Trials.from_arrays(times, states, object=[each.object for each in both], names=["x"])


_MADE: Mapping[str, Callable[[float, int], cl.Trials]] = {
    "relaxation": relaxations,
    "pendulum, angles alone": _angles,
    **{name: partial(_of_family, name) for name in FAMILIES},
    **{name: system.measured for name, system in MIXED.items()},
}

SYSTEMS: Mapping[str, Order] = {
    "relaxation": 1,
    "pendulum, angles alone": 2,
    "pendulum": 1,
    "heights of balls": 2,
    "Lotka-Volterra": 1,
    "Van der Pol": 1,
    "Brusselator": 1,
    "Lorenz": 1,
    **{name: one_order([*system.orders.values()]) for name, system in MIXED.items()},
}
"""The true orders; of the pendulum and Van der Pol's oscillator rates are measured too, and are states of their own."""

if __name__ == "__main__":
    main()
