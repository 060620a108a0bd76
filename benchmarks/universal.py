"""What decides coefficients: how often every class and exponent is right, and whether bands of unseen objects hold.

The collection is a folder with `universal/families.py`, which makes tables and says what is true of each coefficient;
`--problems` or COMMONLAW_BENCHMARKS names it.
"""

import argparse
import os
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import module_from_spec, spec_from_file_location
from itertools import product
from pathlib import Path
from string import ascii_lowercase
from types import ModuleType
from typing import Any

import numpy as np
from joblib import Parallel, delayed

import commonlaw as cl
from benchmarks.machine import machine
from commonlaw.law import relations_frame
from commonlaw.law.parameters import left_hand_sides

Truth = Mapping[str, Mapping[str, tuple[Any, ...]]]

ROOT = Path(__file__).resolve().parents[1]
LEVELS = (0.001, 0.01, 0.05)
MOST = 10
"""Objects of each problem that may be learned from; one more is for forecasts from its properties."""

_KINDS = {"universal": "universal", "power": "power law", "own": "own"}
_ALONG = 0.9
"""Correlation of the logarithms of the first two decoys with those of a property of the collection's."""


@dataclass(frozen=True)
class Setting:
    """How many objects are learned from, and how many properties that say nothing are added."""

    objects: int = MOST
    decoys: int = 0

    @property
    def title(self) -> str:
        """As the table shows it."""
        return f"{self.objects} objects" + (f", {self.decoys} more decoys" if self.decoys else "")


@dataclass(frozen=True)
class Score:
    """What came out of one problem.

    Parameters
    ----------
    wrong
        Coefficients whose class or exponents are not the true ones.
    factor_errors
        Relative errors of the factors of the others, but for each object's own coefficients.
    inside, measured
        Measurements of the unseen object in its 95 % bands, and all of them.
    """

    setting: Setting
    noise: float
    problem: str
    wrong: tuple[str, ...]
    factor_errors: tuple[float, ...]
    inside: int
    measured: int


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the collection and print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.universal", description=__doc__)
    beside = os.environ.get("COMMONLAW_BENCHMARKS") or ROOT.parent / "shared" / "benchmarks"
    parser.add_argument("--problems", type=Path, default=Path(beside), metavar="FOLDER", help="default: %(default)s")
    parser.add_argument("--noise", nargs="+", type=float, default=LEVELS, metavar="LEVEL", help="1 %% is 0.01")
    parser.add_argument("--seeds", type=int, default=10, help="of each family (default: %(default)s)")
    parser.add_argument("--only", nargs="+", default=(), metavar="NAME", help="these families")
    parser.add_argument("--discover", action="store_true", help="discover the terms too; without it they are given")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: %(default)s)")
    chosen = parser.parse_args(arguments)
    if not _families_file(chosen.problems).is_file():
        parser.error(f"no collection in {chosen.problems}: name its folder by --problems or COMMONLAW_BENCHMARKS")
    names = [name for name in _families(chosen.problems).FAMILIES if not chosen.only or name in chosen.only]
    if not names:
        parser.error(f"the collection has no family named {', '.join(chosen.only)}")
    settings = (Setting(), Setting(objects=MOST // 2), Setting(decoys=6))
    begun, scores = time.perf_counter(), []
    for level in chosen.noise:
        runs = product(names, range(chosen.seeds))
        found = Parallel(n_jobs=chosen.jobs)(
            delayed(scores_of)(chosen.problems, name, seed, level, settings, chosen.discover) for name, seed in runs
        )
        scores += [score for each in found for score in each]
        print(f"{100 * level:g} %: {time.perf_counter() - begun:.0f} s so far", file=sys.stderr)
    print(f"{machine()}\n")
    print("\n".join(table(scores)), end="\n\n")
    for each in scores:
        if each.wrong:
            print(f"- {each.setting.title}, {100 * each.noise:g} %, {each.problem}: {'; '.join(each.wrong)}")


def scores_of(
    folder: Path, name: str, seed: int, noise: float, settings: Sequence[Setting], discovered: bool
) -> list[Score]:
    """Return what comes out of one problem; the law is fitted once, as objects do not depend on each other."""
    families = _families(folder)
    frame, truth = families.make(name, seed=seed, noise=noise, objects=MOST)
    trials = cl.Trials.from_frame(frame)
    learned = trials.select(object=trials.objects[:MOST])
    family = families.FAMILIES[name]
    if discovered:
        law = cl.discover(learned, order=family["order"], library=family["library"])
    else:
        law = cl.fit(equations(truth), learned)
    return [_score(law, trials, truth, setting, noise, f"{name} {seed}") for setting in settings]


def equations(truth: Truth) -> list[str]:
    """Return the equations that are true, with a parameter for each coefficient."""
    names = (f"{letter}_" for letter in ascii_lowercase)
    return [
        f"{left} = " + " + ".join(next(names) + ("" if term == "1" else f" {term}") for term in terms)
        for left, terms in truth.items()
    ]


def _score(law: cl.Law, trials: cl.Trials, truth: Truth, setting: Setting, noise: float, problem: str) -> Score:
    seen = cl.law.select_objects(law, law.objects[: setting.objects])
    explained = seen.explain(_with_decoys(seen.properties, setting.decoys, int(problem.rpartition(" ")[2])))
    found = {(each["equation"], each["term"]): each for each in relations_frame(explained).to_dict(orient="records")}
    wrong, errors = [], []
    for left, term, want in ((left, term, want) for left, terms in truth.items() for term, want in terms.items()):
        got = found.pop((left, term), None)
        if got is None:
            wrong.append(f"{term} in {left} is missing")
        elif (got["kind"], _powers(explained, left, term)) != _relation(want):
            wrong.append(f"{term} in {left} is {got['kind']} {got['follows']}".rstrip())
        elif got["kind"] != "own":
            errors.append(abs(float(got["factor"]) / want[1] - 1))
    wrong += [f"{term} in {left} is not true" for left, term in found]
    inside, measured = _held(explained, trials.select(object=trials.objects[MOST]))
    return Score(setting, noise, problem, tuple(wrong), tuple(errors), inside, measured)


def _relation(want: tuple[Any, ...]) -> tuple[str, dict[str, float]]:
    return _KINDS[want[0]], dict(want[2]) if want[0] == "power" else {}


def _powers(law: cl.Law, left: str, term: str) -> dict[str, float]:
    """Return the exponents of a coefficient's relation by property."""
    assert law.uncertainty.explanation is not None
    lefts = left_hand_sides(law)
    places = [(lefts[j], law.terms.names[k]) for j, k in np.argwhere(law.support)]
    relation = law.uncertainty.explanation.relations[places.index((left, term))]
    assert relation is not None
    return dict(zip(relation.properties, map(float, relation.exponents), strict=False))


def _with_decoys(properties: Mapping[str, Mapping[str, Any]], count: int, seed: int) -> dict[str, dict[str, Any]]:
    """Return properties with more that say nothing; two of them go along with those that are there."""
    generator, names = np.random.default_rng(seed), list(next(iter(properties.values())))
    found = {each: {**values} for each, values in properties.items()}
    for i in range(count):
        logs = np.log([float(values[names[i % len(names)]]) for values in properties.values()])
        noise, size = generator.standard_normal(len(logs)), logs.std() or 1.0
        if i < 2:
            noise = _ALONG * (logs - logs.mean()) / size + np.sqrt(1 - _ALONG**2) * noise
        for values, each in zip(found.values(), np.exp(size * noise), strict=True):
            values[f"decoy {i + 1}"] = float(each)
    return found


def _held(law: cl.Law, trials: cl.Trials) -> tuple[int, int]:
    """Return how many measurements after the first of each trial are in 95 % bands of forecasts, and their number."""
    forecast = law.predict(trials, return_std=True)
    parts = zip(forecast.trials, forecast.trajectories, forecast.margins(measured=True), strict=True)
    inside = [abs(path.states[1:, : margin.shape[1]] - trial.states[1:]) <= margin[1:] for trial, path, margin in parts]
    return sum(int(each.sum()) for each in inside), sum(each.size for each in inside)


def table(scores: Sequence[Score]) -> list[str]:
    """Return the lines of the table: one for each setting and level of noise."""
    lines = [
        "| learned from | noise % | all right | factors: median error, largest | unseen object in 95 % bands |",
        "|---|---|---|---|---|",
    ]
    for key in dict.fromkeys((score.setting, score.noise) for score in scores):
        own = [score for score in scores if (score.setting, score.noise) == key]
        errors = [error for each in own for error in each.factor_errors] or [np.nan]
        share = sum(each.inside for each in own) / sum(each.measured for each in own)
        right = sum(not each.wrong for each in own)
        lines.append(
            f"| {key[0].title} | {100 * key[1]:g} | {right} of {len(own)} | {100 * np.median(errors):.2g} %, "
            f"{100 * max(errors):.2g} % | {share:.3f} |"
        )
    return lines


def _families_file(folder: Path) -> Path:
    return folder / "universal" / "families.py"


def _families(folder: Path) -> ModuleType:
    spec = spec_from_file_location("universal_families", _families_file(folder))
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


if __name__ == "__main__":
    main()
