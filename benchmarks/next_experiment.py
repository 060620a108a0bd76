"""Whether designed experiments find the right law sooner than random ones, and as surely as they say beforehand."""

import argparse
import itertools
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

import commonlaw as cl
from benchmarks.families import FAMILIES, Experiment
from benchmarks.machine import machine
from benchmarks.variational import Floats, solve
from commonlaw.experiments.experiment import Settings


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


KINDS = ("designed", "random")
"""Of further experiments."""

SURE = 0.95
"""How probable a law is when no further experiment is made."""


@dataclass(frozen=True)
class Outcome:
    """What one draw gives at first, and after each further experiment until the law was sure or no more were allowed.

    Parameters
    ----------
    family, seed, designed
        Of the draw, and whether its further experiments were designed or random.
    right
        Whether the law had exactly the right terms, each time.
    laws
        What was plausible, each time: formulas and their probabilities, the best first.
    promised
        The chance of the right law that each design promised beforehand.
    settings
        Of each further experiment.
    seconds
        Of processor time.
    """

    family: str
    seed: int
    designed: bool
    right: list[bool]
    laws: list[list[tuple[str, float]]]
    promised: list[float]
    settings: list[Mapping[str, object]]
    seconds: float

    def right_after(self, count: int) -> bool:
        """Return whether it was right after so many experiments, or those that it took to be sure."""
        return self.right[min(count, len(self.right) - 1)]

    @property
    def probability(self) -> list[float]:
        """Of the best law, each time."""
        return [plausible[0][1] for plausible in self.laws]

    @property
    def made(self) -> int:
        """How many further experiments."""
        return len(self.right) - 1


def main(arguments: Sequence[str] | None = None) -> None:
    """Print how many draws have the right law, after how many experiments."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.next_experiment", description=__doc__)
    parser.add_argument("--draws", type=int, default=50, help="of each family (default: %(default)s)")
    parser.add_argument(
        "--experiments", type=int, default=1, help=f"further ones at most, until {SURE} (default: %(default)s)"
    )
    parser.add_argument("--only", choices=KINDS, help="experiments of one kind (default: both)")
    parser.add_argument("--each", action="store_true", help="further trials of every object, and not of one")
    parser.add_argument("--family", default=",".join(BEGINNINGS), help="commas between several (default: all)")
    parser.add_argument("--save", type=Path, help="where each draw is added when it is done; what is there is kept")
    chosen = parser.parse_args(arguments)
    outcomes = read(chosen.save) if chosen.save and chosen.save.exists() else []
    done, names = {(outcome.family, outcome.seed, outcome.designed) for outcome in outcomes}, chosen.family.split(",")
    kinds = [each == "designed" for each in KINDS if chosen.only in (None, each)]
    for seed, name, designed in itertools.product(range(chosen.draws), names, kinds):
        if (name, seed, designed) not in done:
            outcomes.append(drawn(name, seed, chosen.experiments, designed, chosen.each))
            if chosen.save:
                with chosen.save.open("a") as file:
                    print(json.dumps(asdict(outcomes[-1])), file=file)
    print(f"{machine()}\n\n{table(outcomes, chosen.experiments)}\n\n{calibration(outcomes)}")


def read(path: Path) -> list[Outcome]:
    """Return the draws that were saved."""
    return [Outcome(**json.loads(line)) for line in path.read_text().splitlines()]


def table(outcomes: Sequence[Outcome], experiments: int) -> str:
    """Return how many draws are right after how many experiments, and how many of these they took, family by family."""
    head = ["family", "experiments", "draws", *(f"after {k}" for k in range(experiments + 1)), "made", "not sure"]
    rows = [head, ["---"] * len(head)]
    for name, designed in itertools.product(BEGINNINGS, (True, False)):
        found = [outcome for outcome in outcomes if (outcome.family, outcome.designed) == (name, designed)]
        if found:
            right = [sum(each.right_after(k) for each in found) for k in range(experiments + 1)]
            unsure = sum(each.probability[-1] < SURE for each in found)
            made = sum(each.made for each in found)
            rows.append([name, KINDS[not designed], *map(str, (len(found), *right, made, unsure))])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def calibration(outcomes: Sequence[Outcome]) -> str:
    """Return what was promised against what was right, at first and after one experiment."""
    started = [outcome for outcome in outcomes if outcome.made]
    kinds = {
        "at first": [(outcome.probability[0], outcome.right[0]) for outcome in outcomes if outcome.designed],
        "after one random experiment": [(each.probability[1], each.right[1]) for each in started if not each.designed],
        "after one designed experiment": [(each.probability[1], each.right[1]) for each in started if each.designed],
        "after one designed experiment, beforehand": [
            (each.promised[0], each.right[1]) for each in started if each.designed
        ],
    }
    rows = ["| when | draws | promised | right |", "|---|---|---|---|"]
    for when, pairs in kinds.items():
        promised, right = (sum(column) for column in zip(*pairs, strict=True)) if pairs else (0, 0)
        rows.append(f"| {when} | {len(pairs)} | {promised:.1f} | {right} |")
    return "\n".join(rows)


def drawn(name: str, seed: int, count: int, designed: bool, each: bool) -> Outcome:
    """Return what one draw of coefficients, starts and noise gives with up to so many further experiments."""
    began, beginning = time.process_time(), BEGINNINGS[name]
    first, random = first_trials(name, seed), np.random.default_rng([seed, designed])
    noise, trials = first.noise(beginning.level), first.measured(beginning.level, seed)
    vary = {**beginning.ranges, "samples": beginning.samples, **({"object": "each"} if each else {})}
    right, laws, promised, chosen = [], [], [], list[Mapping[str, object]]()
    for k in range(count + 1):
        law = first.discover(trials)
        right.append(first.estimates(law) is not None)
        laws.append([("; ".join(model.law.structure), model.probability) for model in law.models])
        if k == count or law.models[0].probability >= SURE:
            break
        space = Settings.of(law, vary, {})
        settings: Mapping[str, object] = space.at(random.uniform(size=len(space.varied)))
        if designed:
            chance, settings = expected(law, vary, settings, seed)
            promised.append(chance)
        chosen.append(settings)
        trials = cl.Trials((*trials.trials, *made(first, settings, noise, random, f"further {k + 1}")), trials.schema)
    return Outcome(name, seed, designed, right, laws, promised, chosen, time.process_time() - began)


def expected(
    law: cl.Law, vary: Mapping[str, object], otherwise: Mapping[str, object], seed: int
) -> tuple[float, Mapping[str, object]]:
    """Return the chance of the right law after a designed experiment, and the experiment's settings.

    Where forecasts diverge in all experiments it is another one, and the chance is that without it.
    """
    try:
        design = cl.design(law, vary, seed=seed)
    except cl.CommonlawError:
        return law.models[0].probability, otherwise
    return design.chance, design.experiments[0].experiment.settings


def first_trials(name: str, seed: int) -> Experiment:
    """Return objects of a family, others for every seed."""
    beginning, generator = BEGINNINGS[name], np.random.default_rng([*name.encode(), seed])
    family = replace(FAMILIES[name], samples=beginning.samples, end=beginning.end)
    coefficients = np.array([family.coefficients(generator) for _ in range(beginning.objects)])
    runs = tuple(
        tuple(
            solve(family.variables, family.equations, coefficient, np.array(family.start(generator)), family.times)
            for _ in range(beginning.trials)
        )
        for coefficient in coefficients
    )
    return Experiment(family, coefficients, runs)


def made(
    first: Experiment, settings: Mapping[str, object], noise: Floats, random: np.random.Generator, label: str
) -> list[cl.Trial]:
    """Return a further trial of the object with these settings, or of each, as the true law and the noise have it."""
    family = first.family
    start = np.array([float(str(settings[variable])) for variable in family.variables])
    times = np.linspace(0, float(str(settings["duration"])), round(float(str(settings["samples"]))))
    found = []
    for i, coefficient in enumerate(first.coefficients):
        if settings["object"] not in (f"object {i + 1}", "each"):
            continue
        clean = solve(family.variables, family.equations, coefficient, start, times).states[:, : len(family.equations)]
        states = clean + noise * random.standard_normal(clean.shape)
        found.append(cl.Trial(f"object {i + 1}", label, times, states))
    return found


if __name__ == "__main__":
    main()
