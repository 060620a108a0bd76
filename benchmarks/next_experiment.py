"""Whether designed experiments find the right law sooner than random ones, and as surely as they say beforehand."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

import commonlaw as cl
from benchmarks.families import FAMILIES, Experiment
from benchmarks.machine import machine
from benchmarks.variational import Floats, solve
from commonlaw.experiments.settings import Settings


@dataclass(frozen=True)
class Beginning:
    """What was measured first, so little that laws are in doubt, and what can be set in further experiments.

    Parameters
    ----------
    objects, trials, samples, end
        Of the first experiments: how many objects, trials of each, and samples until when.
    level
        Of the noise, as a share of each state's standard deviation.
    ranges
        Of further experiments: about twice those of the first ones, with as many samples.
    """

    objects: int
    trials: int
    samples: int
    end: float
    level: float
    ranges: Mapping[str, object]


BEGINNINGS: Mapping[str, Beginning] = {
    "heights of balls": Beginning(5, 2, 49, 3.2, 0.1, {"x": "20..60", "v": "-15..15", "duration": "1.6..6.4"}),
    "Lotka-Volterra": Beginning(3, 1, 30, 12.0, 0.1, {"x": "0.3..4", "y": "0.2..4", "duration": "6..24"}),
    "pendulum": Beginning(3, 1, 30, 6.0, 0.2, {"x": "0.2..2.8", "y": "-1..1", "duration": "3..12"}),
}


SURE = 0.95
"""How probable a law is when no further experiment is made."""


@dataclass(frozen=True)
class Outcome:
    """Whether the right law was found at first, and after each further experiment, and how probable it was each time.

    The last is that at which the law was sure, or as many experiments as there may be were made. What the first design
    promised is the chance of the right law after it.
    """

    right: tuple[bool, ...]
    probability: tuple[float, ...]
    promised: float

    def right_after(self, count: int) -> bool:
        """Return whether it was right after so many experiments, or those that it took to be sure."""
        return self.right[min(count, len(self.right) - 1)]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print how many draws have the right law, after how many experiments."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.next_experiment", description=__doc__)
    parser.add_argument("--draws", type=int, default=50, help="of each family (default: %(default)s)")
    parser.add_argument(
        "--experiments", type=int, default=1, help=f"further ones at most, until {SURE} (default: %(default)s)"
    )
    parser.add_argument("--random", action="store_true", help="random experiments only")
    parser.add_argument("--each", action="store_true", help="further trials of every object, and not of one")
    parser.add_argument("--family", default=",".join(BEGINNINGS), help="commas between several (default: all)")
    chosen = parser.parse_args(arguments)
    head = " | ".join(f"after {k}" for k in range(chosen.experiments + 1))
    print(f"{machine()}\n\n| family | experiments | {head} | promised now | after 1 | made until {SURE} | not sure |")
    print("|---" * (chosen.experiments + 7) + "|")
    for name in chosen.family.split(","):
        for designed in (False,) if chosen.random else (True, False):
            found = [drawn(name, seed, chosen.experiments, designed, chosen.each) for seed in range(chosen.draws)]
            counts = [sum(each.right_after(k) for each in found) for k in range(chosen.experiments + 1)]
            promised = sum(each.probability[0] for each in found), sum(each.promised for each in found)
            made_in_all = sum(len(each.right) - 1 for each in found)
            unsure = sum(each.probability[-1] < SURE for each in found)
            cells = [name, "designed" if designed else "random", *counts, *(f"{each:.1f}" for each in promised)]
            print(f"| {' | '.join(map(str, [*cells, made_in_all, unsure]))} |", flush=True)


def drawn(name: str, seed: int, count: int, designed: bool, each: bool) -> Outcome:
    """Return what one draw of coefficients, starts and noise gives with up to so many further experiments."""
    beginning = BEGINNINGS[name]
    first, random = first_trials(name, seed), np.random.default_rng([seed, designed])
    noise, trials = first.noise(beginning.level), first.measured(beginning.level, seed)
    law = first.discover(trials)
    right, probability = [first.estimates(law) is not None], [law.plausible[0].probability]
    promised = probability[0]
    for k in range(count):
        if probability[-1] >= SURE:
            break
        vary: Mapping[str, object] = {
            **beginning.ranges,
            "samples": beginning.samples,
            **({"object": "each"} if each else {}),
        }
        if not designed:
            space = Settings.of(law, vary, {})
            vary = space.at(random.uniform(size=len(space.varied)))
        chance, settings = expected(law, vary, seed)
        promised = chance if k == 0 else promised
        trials = cl.Trials((*trials.trials, *made(first, settings, noise, random, f"further {k + 1}")), trials.schema)
        law = first.discover(trials)
        right.append(first.estimates(law) is not None)
        probability.append(law.plausible[0].probability)
    return Outcome(tuple(right), tuple(probability), promised)


def expected(law: cl.Law, vary: Mapping[str, object], seed: int) -> tuple[float, Mapping[str, object]]:
    """Return the chance of the right law after a designed experiment, and the experiment's settings.

    Where nothing is left to choose, and forecasts of it diverge, that is the chance without it.
    """
    try:
        design = cl.design(law, vary, seed=seed)
    except cl.CommonlawError:
        return law.plausible[0].probability, vary
    return design.chance, design.experiments[0].experiment.settings


def first_trials(name: str, seed: int) -> Experiment:
    """Return objects of a family, others for every seed."""
    beginning, generator = BEGINNINGS[name], np.random.default_rng([*name.encode(), seed])
    family = replace(FAMILIES[name], samples=beginning.samples, end=beginning.end)
    coefficients = np.array([family.coefficients(generator) for _ in range(beginning.objects)])
    runs = tuple(
        tuple(
            solve(family.variables, family.equations, own, np.array(family.start(generator)), family.times)
            for _ in range(beginning.trials)
        )
        for own in coefficients
    )
    return Experiment(family, coefficients, runs)


def made(
    first: Experiment, settings: Mapping[str, object], noise: Floats, random: np.random.Generator, label: str
) -> list[cl.Trial]:
    """Return a further trial of the object with these settings, or of each, as the true law and the noise have it."""
    family = first.family
    start = np.array([float(str(settings[each])) for each in family.variables])
    times = np.linspace(0, float(str(settings["duration"])), round(float(str(settings["samples"]))))
    found = []
    for i, own in enumerate(first.coefficients):
        if settings["object"] not in (f"object {i + 1}", "each"):
            continue
        clean = solve(family.variables, family.equations, own, start, times).states[:, : len(family.equations)]
        states = clean + noise * random.standard_normal(clean.shape)
        found.append(cl.Trial(f"object {i + 1}", label, times, states))
    return found


if __name__ == "__main__":
    main()
