"""Run commonlaw's defaults on a collection of problems with known laws; print scores beside baselines and goals.

The collection is a folder with a `run.py` that scores a method and writes the scores as JSON; it is named by
`--problems` or COMMONLAW_BENCHMARKS.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import commonlaw as cl
from benchmarks.machine import machine
from commonlaw.law.law import object_index
from commonlaw.library import AbstractLibrary, Terms, parse_library

Arrays = Sequence[NDArray[np.float64]]
Score = Mapping[str, Any]

ROOT = Path(__file__).resolve().parents[1]
_LIBRARY = "COMMONLAW_BENCHMARK_LIBRARY"
"""Of the environment, by which the collection's own program passes candidate terms on to `method`."""

LEVELS = (0.0, 0.001, 0.01, 0.05, 0.1)

_MEASURES = {
    "all_exact": "every support right",
    "f1": "F1 of the terms, mean",
    "coef_err": "relative error of the coefficients, median",
    "r2_ok": "R2 > 0.9 from a fresh start",
    "seconds": "seconds, mean",
}


@dataclass(frozen=True)
class Row:
    """A row of the table: whose mean of which measure, and what it is compared with at each of the `LEVELS`."""

    title: str
    bench: str
    trials: int
    measure: str
    baseline: tuple[float, ...]
    goal: tuple[float, ...]


# The baselines are the collection's own: the best of several methods built on PySINDy 2.1.0, with columns scaled, the
# threshold chosen by cross-validation over trials, and rules tuned on these problems.
ROWS = (
    Row(
        "grouped, every support right",
        "grouped",
        2,
        "all_exact",
        (1.00, 1.00, 0.81, 0.52, 0.31),
        (1.00, 1.00, 0.95, 0.85, 0.75),
    ),
    Row(
        "chaotic, 5 trials, every support right",
        "chaotic",
        5,
        "all_exact",
        (0.88, 0.88, 0.82, 0.57, 0.48),
        (0.97, 0.97, 0.92, 0.80, 0.65),
    ),
    Row(
        "chaotic, 1 trial, every support right",
        "chaotic",
        1,
        "all_exact",
        (0.87, 0.87, 0.67, 0.38, 0.24),
        (0.95, 0.95, 0.85, 0.60, 0.45),
    ),
    Row(
        "grouped, R2 > 0.9 from a fresh start",
        "grouped",
        2,
        "r2_ok",
        (1.00, 1.00, 0.92, 0.76, 0.56),
        (1.00, 1.00, 0.98, 0.95, 0.90),
    ),
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a part of the collection for each kind of problem and level of noise, then print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.discovery", description=__doc__)
    beside = os.environ.get("COMMONLAW_BENCHMARKS") or ROOT.parent / "shared" / "benchmarks"
    parser.add_argument("--problems", type=Path, default=Path(beside), metavar="FOLDER", help="default: %(default)s")
    parser.add_argument("--bench", nargs="+", choices=("grouped", "chaotic"), default=("grouped", "chaotic"))
    parser.add_argument("--noise", nargs="+", type=float, default=LEVELS, metavar="LEVEL", help="1 %% is 0.01")
    parser.add_argument("--seeds", type=int, default=3, help="of each grouped family (default: %(default)s)")
    parser.add_argument("--only", nargs="+", default=(), metavar="NAME", help="these families and systems")
    parser.add_argument("--library", help="candidate terms (default: those of each problem); others of laws are wrong")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    parser.add_argument("--out", type=Path, help="write each problem's scores here, as JSON")
    chosen = parser.parse_args(arguments)
    if not (chosen.problems / "run.py").is_file():
        parser.error(f"no collection in {chosen.problems}: name its folder by --problems or COMMONLAW_BENCHMARKS")
    os.environ.pop(_LIBRARY, None)
    if chosen.library:
        os.environ[_LIBRARY] = chosen.library
    scores: list[Score] = []
    begun = time.perf_counter()
    for bench in chosen.bench:
        for level in chosen.noise:
            start = time.perf_counter()
            part = _scores(chosen.problems, bench, level, chosen.seeds, chosen.only, chosen.jobs)
            scores += part
            if chosen.out:
                chosen.out.write_text(json.dumps(scores))
            took = time.perf_counter() - start
            print(f"{bench}, {100 * level:g} %: {len(part)} problems in {took:.0f} s", file=sys.stderr)
    if not scores:
        parser.error(f"the collection has no problem named {', '.join(chosen.only)} of this kind")
    print(f"{machine()}\n")
    for lines in (compared(scores, chosen.noise), _by_problem(scores, chosen.noise), _missed(scores, chosen.noise)):
        print("\n".join(lines), end="\n\n")
    print(f"{len(scores)} problems in {time.perf_counter() - begun:.0f} s, in {chosen.jobs} process(es) at a time.")


def method(objects: Sequence[tuple[Arrays, Arrays]], info: Mapping[str, Any]) -> list[list[dict[str, float]]]:
    """Return a model of each object, in the collection's words: for each equation a coefficient by name of the term.

    Parameters
    ----------
    objects
        Times and states of the trials of each object.
    info
        `degree` and `trig`, which make the library; `names` of its terms; and, if only the first half of the states
        are measured, their places as `observed`: the law is then of second order.
    """
    order = 2 if info.get("observed") else 1
    size = objects[0][1][0].shape[1]
    trials = cl.Trials.from_arrays(
        [times for all_times, _ in objects for times in all_times],
        [states for _, all_states in objects for states in all_states],
        object=[str(i) for i, (all_times, _) in enumerate(objects) for _ in all_times],
        names=[f"x{i}" for i in range(size)],
    )
    library = os.environ.get(_LIBRARY) or library_of(info)
    alike = cl.TrajectoryLikelihood(strange_objects="keep")  # The collection has one law for all
    law = cl.discover(trials, order=order, library=library, method=alike)
    variables = replace(law.terms.variables, states=tuple(f"x{i}" for i in range(order * size)))
    names = Terms(variables, law.terms.terms).names
    known = [{f"x{size + i}": 1.0} for i in range(size)] if order == 2 else []
    return [
        [*known, *(_named(names, row) for row in law.coefficients[object_index(law, name)])] for name in trials.objects
    ]


def library_of(info: Mapping[str, Any]) -> AbstractLibrary:
    """Return the candidate terms; over states called x0, x1, ... they have the collection's names."""
    waves = " + fourier:1" if info["trig"] else ""
    return parse_library(f"poly:{info['degree']}{waves}")


def _named(names: Sequence[str], coefficients: NDArray[np.float64]) -> dict[str, float]:
    return {name: float(coefficient) for name, coefficient in zip(names, coefficients, strict=True) if coefficient}


def compared(scores: Sequence[Score], levels: Sequence[float]) -> list[str]:
    """Return the table of commonlaw's scores beside the baselines and the goals."""
    lines = _head("share of problems, with defaults", levels)
    for row in ROWS:
        mine = [score for score in scores if (score["bench"], score["trials"]) == (row.bench, row.trials)]
        if mine:
            lines.append(_cells([row.title, "commonlaw", *_means(mine, row.measure, levels)]))
            for who, values in (("best baseline", row.baseline), ("goal", row.goal)):
                known = dict(zip(LEVELS, values, strict=True))
                lines.append(_cells(["", who, *(f"{known[level]:.2f}" if level in known else "" for level in levels)]))
    return lines


def _by_problem(scores: Sequence[Score], levels: Sequence[float]) -> list[str]:
    """Return the table of all measures for each grouped family and for all chaotic systems."""
    parts: dict[str, list[Score]] = {}
    for score in scores:
        title = score["name"] if score["bench"] == "grouped" else f"chaotic, {score['trials']} trial(s)"
        parts.setdefault(title, []).append(score)
    lines = _head("problem", levels)
    for title, part in parts.items():
        for i, (measure, words) in enumerate(_MEASURES.items()):
            lines.append(_cells(["" if i else title, words, *_means(part, measure, levels)]))
    return lines


def _missed(scores: Iterable[Score], levels: Iterable[float]) -> list[str]:
    """Return a line for each level that names the problems whose support was not right, and one for each error."""
    listed = list(scores)
    lines = []
    for level in levels:
        wrong = [_label(score) for score in listed if score["noise"] == level and not score["all_exact"]]
        lines.append(f"Not right at {100 * level:g} %: {', '.join(wrong) or 'none'}.")
    failed = [
        f"Failed: {_label(score)} at {100 * score['noise']:g} %: {score['error']}"
        for score in listed
        if "error" in score
    ]
    return [*lines, *failed]


def _label(score: Score) -> str:
    number = f"seed {score['seed']}" if score["bench"] == "grouped" else f"{score['trials']} trial(s)"
    return f"{score['name']} ({number})"


def _head(title: str, levels: Sequence[float]) -> list[str]:
    return [_cells([title, "", *(f"{100 * level:g} %" for level in levels)]), "|---|---|" + "---|" * len(levels)]


def _means(scores: Sequence[Score], measure: str, levels: Sequence[float]) -> list[str]:
    """Return the mean at each level; the median of the coefficients' errors, a few of which are huge."""
    how = np.median if measure == "coef_err" else np.mean
    digits = ".2f" if measure in ("all_exact", "r2_ok", "f1") else ".2g"
    values = [[score[measure] for score in scores if score["noise"] == level] for level in levels]
    return [f"{how(value):{digits}}" if value else "" for value in values]


def _cells(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _scores(folder: Path, bench: str, level: float, seeds: int, only: Sequence[str], n_jobs: int) -> list[Score]:
    """Return what the collection's own program makes of `method`."""
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary) / "scores.json"
        settings = {"--method": "benchmarks.discovery:method", "--bench": bench, "--noise": level, "--seeds": seeds}
        settings |= {"--jobs": n_jobs, "--out": out} | ({"--only": ",".join(only)} if only else {})
        words = [str(word) for pair in settings.items() for word in pair]
        subprocess.run([sys.executable, str(folder / "run.py"), *words], cwd=ROOT, stdout=subprocess.PIPE, check=True)
        found: list[Score] = json.loads(out.read_text())
    return found


if __name__ == "__main__":
    main()
