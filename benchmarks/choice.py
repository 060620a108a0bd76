"""Whether laws of small data are right as often as they say, what their intervals hold, and which parameters decide.

Problems are drawn at random (`small_problems.py`): one to four objects, 12 to 30 samples, 1 to 15 % noise.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise, product
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from joblib import Parallel, delayed

import commonlaw as cl
from benchmarks.coverage import interval
from benchmarks.machine import machine
from benchmarks.small_problems import KINDS, SmallProblem, draw
from commonlaw.errors import CommonlawError

BINS = (0.0, 0.5, 0.7, 0.85, 0.95, 1.0)
"""Of the probability that a law states for its terms."""

LISTED = 0.01
"""The least probable support that a table of candidates should hold."""

_ROOMS = ("inference", "selection", "hierarchy", "likelihood")
"""Whose parameters decide laws."""


@dataclass(frozen=True)
class Score:
    """What came out of one problem.

    Parameters
    ----------
    stated
        The probability that the law states for its terms, None if no law was found.
    right, listed, empty
        Whether the terms are the true ones; the true ones are among the candidates; an equation that has terms in truth
        is left with none.
    intervals, hold, hold_given
        95 % intervals of the chosen terms' coefficients, averaged over what else the law could be, and those that hold
        the truth, which is zero for a term that is not in the law; and those that hold it given the chosen terms.
    terms
        Of every equation, as they were found.
    """

    kind: str
    seed: int
    stated: float | None
    right: bool
    listed: bool
    empty: bool
    intervals: int
    hold: int
    hold_given: int
    terms: tuple[tuple[str, ...], ...]
    seconds: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.choice", description=__doc__)
    names = [each.name for each in KINDS]
    parser.add_argument("--kind", nargs="+", choices=names, default=names, metavar="KIND", help="; ".join(names))
    parser.add_argument("--draws", type=int, default=75, help="of each kind (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the first draw (default: %(default)s)")
    parser.add_argument("--constants", action="store_true", help="change each constant by a fifth too: hours")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: %(default)s)")
    parser.add_argument("--out", type=Path, help="write the scores here, as JSON")
    chosen = parser.parse_args(arguments)
    print(f"{machine()}\n")
    cases = list(product(chosen.kind, range(chosen.seed, chosen.seed + chosen.draws)))
    begun = time.perf_counter()
    scores = Parallel(n_jobs=chosen.jobs)(delayed(score_of)(*case) for case in cases)
    print("\n".join([*by_kind(scores), "", *by_probability(scores)]), flush=True)
    print(f"\n{time.perf_counter() - begun:.0f} s in {chosen.jobs} process(es).")
    if chosen.out:
        chosen.out.write_text(json.dumps([asdict(score) for score in scores], indent=1))
    if chosen.constants:
        print("\n| constant | value | laws that change, a fifth less | a fifth more |\n|---|---|---|---|")
        for line in _by_constants(scores, cases, chosen.jobs):
            print(line, flush=True)


def score_of(kind: str, seed: int, changed: Mapping[str, float] | None = None) -> Score:
    """Return what comes out of a problem, with some parameters changed, by their modules and names."""
    problem = draw(next(each for each in KINDS if each.name == kind), seed)
    restore, begun = _change(changed or {}), time.perf_counter()
    try:
        law = cl.discover(problem.trials, order=problem.shape.order, library=problem.shape.library)
    except CommonlawError as reason:
        print(f"{kind}, {seed}: {reason}", file=sys.stderr)
        return Score(kind, seed, None, False, False, False, 0, 0, 0, (), time.perf_counter() - begun)
    finally:
        restore()
    return _score(problem, law, time.perf_counter() - begun)


def _score(problem: SmallProblem, law: cl.Law, seconds: float) -> Score:
    table, stated, listed = law.comparison, 1.0, True
    found = tuple(tuple(law.terms.names[k] for k in np.flatnonzero(own)) for own in law.support)
    for equation, true in zip(problem.shape.equations, problem.support, strict=True):
        own = table[table["equation"] == equation]
        stated *= float(own.loc[own["chosen"], "weight"].sum())
        listed &= {*true} in [{*each.split(", ")} for each in own["terms"]]
    inside, given = (
        [_holds(problem, row) for row in law.conf_int(averaged=averaged).to_dict(orient="records")]
        for averaged in (True, False)
    )
    right = all({*own} == {*true} for own, true in zip(found, problem.support, strict=True))
    empty = any(not own for own in found)
    kind = problem.kind.name
    counts = len(inside), sum(inside), sum(given)
    return Score(kind, problem.seed, stated, right, listed, empty, *counts, found, seconds)


def _holds(problem: SmallProblem, row: Mapping[Hashable, Any]) -> bool:
    own = problem.truth.get((str(row["equation"]), str(row["term"])))
    truth = 0.0 if own is None else float(own[problem.trials.objects.index(str(row["object"]))])
    return float(row["low"]) <= truth <= float(row["high"])


def by_kind(scores: Sequence[Score]) -> list[str]:
    """Return a table with a line for each kind of problem and one for all."""
    lines = [
        "| problems | draws | right | its 95 % interval | stated, mean | truth listed | empty | no law | "
        "averaged intervals that hold | given the terms | given the terms, where these are right | s a draw |",
        "|---" * 12 + "|",
    ]
    for name in [*dict.fromkeys(score.kind for score in scores), "all"]:
        own = [score for score in scores if name in (score.kind, "all")]
        law = [each for each in own if each.stated is not None]
        low, high = interval(_share(own, lambda each: each.right), len(own))
        counts = f"{sum(each.empty for each in own)} | {len(own) - len(law)}"
        good = [each for each in law if each.right]
        held = f"{_held(law)} | {_held(law, given=True)} | {_held(good, given=True)}"
        lines.append(
            f"| {name} | {len(own)} | {_share(own, lambda each: each.right):.2f} | {low:.2f} to {high:.2f} | "
            f"{_share(law, lambda each: each.stated or 0.0):.2f} | {_share(law, lambda each: each.listed):.2f} | "
            f"{counts} | {held} | {_share(own, lambda each: each.seconds):.1f} |"
        )
    return lines


def by_probability(scores: Sequence[Score]) -> list[str]:
    """Return a table with a line for each bin of stated probabilities."""
    lines = ["| stated | laws | mean stated | right | its 95 % interval |", "|---|---|---|---|---|"]
    for low, high in pairwise(BINS):
        last = high == BINS[-1]
        own = [score for score in scores if score.stated is not None and low <= score.stated < high + last]
        if own:
            right = _share(own, lambda each: each.right)
            least, most = interval(right, len(own))
            mean = _share(own, lambda each: each.stated or 0.0)
            lines.append(f"| {low} to {high} | {len(own)} | {mean:.2f} | {right:.2f} | {least:.2f} to {most:.2f} |")
    return lines


def _share(scores: Sequence[Score], what: Callable[[Score], float]) -> float:
    return float(np.mean([what(score) for score in scores])) if scores else float("nan")


def _held(scores: Sequence[Score], given: bool = False) -> str:
    count = sum(score.intervals for score in scores)
    held = sum(score.hold_given if given else score.hold for score in scores)
    return f"{held / count:.3f} of {count}" if count else ""


def parameters() -> dict[str, float]:
    """Return the numbers that loaded modules of the rooms that choose laws name, by module and name."""
    found: dict[tuple[str, int], tuple[str, float]] = {}
    for module, value in sorted(sys.modules.items()):
        if module.startswith(tuple(f"commonlaw.{room}." for room in _ROOMS)):
            for name, number in vars(value).items():
                if name.isupper() and _is_number(number):  # What is imported is the same object
                    found.setdefault((name, id(number)), (f"{module}:{name}", float(number)))
    return dict(found.values())


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _change(changed: Mapping[str, float]) -> Callable[[], None]:
    """Give parameters other values, wherever they were imported to; return what gives them back."""
    before: list[tuple[ModuleType, str, float]] = []
    for path, value in changed.items():
        module, _, name = path.partition(":")
        old: float = getattr(sys.modules[module], name)
        for each in list(sys.modules.values()):
            if getattr(each, "__name__", "").startswith("commonlaw") and vars(each).get(name) is old:
                before.append((each, name, old))
                setattr(each, name, int(value) if isinstance(old, int) else value)

    def restore() -> None:
        for each, name, old in before:
            setattr(each, name, old)

    return restore


def _by_constants(scores: Sequence[Score], cases: Sequence[tuple[str, int]], n_jobs: int) -> Iterator[str]:
    """Yield a line for each constant: how many laws have other terms when it is a fifth smaller or larger."""
    for path, value in parameters().items():
        shares = []
        for factor in (0.8, 1.2):
            moved = Parallel(n_jobs=n_jobs)(delayed(score_of)(*case, {path: factor * value}) for case in cases)
            shares.append(np.mean([score.terms != other.terms for score, other in zip(scores, moved, strict=True)]))
        yield f"| `{path.removeprefix('commonlaw.')}` | {value:g} | {shares[0]:.3f} | {shares[1]:.3f} |"


if __name__ == "__main__":
    main()
