"""Laws that are not sums of fixed functions, by symbolic regression (Operon) and by commonlaw.

The problems are those of `any_law/systems.py`, with `SYSTEMS`, `make` and `score`, in a folder that is named by
`--problems` or COMMONLAW_BENCHMARKS. Operon gets the smoothed states and derivatives of each object and fits it alone;
commonlaw gets all trials. A law is right if its rates are the true ones, also where trials have not been, and if no
equation has more numbers than the true one.
"""

import argparse
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np

import commonlaw as cl
from benchmarks.machine import machine
from commonlaw.array_types import Floats
from commonlaw.differentiation import RobustSpline
from commonlaw.law.law import object_index

ROOT = Path(__file__).resolve().parents[1]

_SYMBOLS = "add,sub,mul,div,pow,exp,log,sin,cos,sqrt,abs,constant,variable"
_MOST_NODES = 30
_TRIM = 3
"""Samples at both ends of a trial that symbolic regression does not get: derivatives are poor there."""

_STEP, _RANK = 1e-5, 1e-6
"""Relative change of numbers for derivatives, and what of these is zero: numbers of which only a product matters."""

_MATTERS = 1e-3
"""Share of what a formula gives that a number has to be worth to count."""

Model = tuple[Callable[[Floats], Floats], list[int]]
"""Of an object: rates at points [time, states ...], and how many numbers each equation has."""


@dataclass(frozen=True, eq=False)
class Formula:
    """An expression of X1, X2, ... with numbers in it."""

    text: str
    numbers: Floats

    @classmethod
    def of(cls, text: str) -> "Formula":
        """Return what Operon writes."""
        found = re.findall(r"(?<![\w.])\d+\.\d+(?:e[+-]?\d+)?", text)
        for i, number in enumerate(found):
            text = text.replace(number, f"c[{i}]", 1)
        return cls(text.replace("^", "**"), np.array([float(each) for each in found]))

    def values(self, variables: Floats, numbers: Floats | None = None) -> Floats:
        """Return what it is at points, shape (n, variables); other numbers may stand in it."""
        names: dict[str, Any] = {f"X{i + 1}": column for i, column in enumerate(variables.T)}
        names |= {each: getattr(np, each) for each in ("exp", "log", "sin", "cos", "sqrt", "abs")}
        with np.errstate(all="ignore"):
            found = eval(self.text, {"c": self.numbers if numbers is None else numbers} | names)
        return np.broadcast_to(np.asarray(found, dtype=float), len(variables))

    def count(self, variables: Floats) -> int:
        """Return how many of its numbers matter and are told apart: the rank of derivatives by their logarithms."""
        slopes = [np.zeros(len(variables))]
        for i, number in enumerate(self.numbers):
            ends = [self.values(variables, _replaced(self.numbers, i, number * (1 + s * _STEP))) for s in (1, -1)]
            slopes.append((ends[0] - ends[1]) / (2 * _STEP))
        matrix = np.column_stack([*slopes, self.values(variables)])
        *sizes, whole = np.sqrt(np.mean(matrix[np.isfinite(matrix).all(axis=1)] ** 2, axis=0))
        kept = matrix[np.isfinite(matrix).all(axis=1)][:, np.append(np.array(sizes) > _MATTERS * whole, False)]
        return int(np.linalg.matrix_rank(kept, tol=_RANK * abs(kept).max())) if kept.size else 0


def _replaced(numbers: Floats, index: int, value: float) -> Floats:
    found = numbers.copy()
    found[index] = value
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Print how many objects' laws are right, for each system and level of noise."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.symbolic", description=__doc__)
    beside = os.environ.get("COMMONLAW_BENCHMARKS") or ROOT.parent / "shared" / "benchmarks"
    parser.add_argument("--problems", type=Path, default=Path(beside), metavar="FOLDER", help="default: %(default)s")
    parser.add_argument("--only", nargs="+", default=(), metavar="NAME", help="these systems")
    parser.add_argument("--noise", nargs="+", type=float, default=(0.0, 0.01), metavar="LEVEL", help="1 %% is 0.01")
    parser.add_argument("--seeds", type=int, default=1, help="of each system (default: %(default)s)")
    parser.add_argument("--objects", type=int, help="of each system (default: as many as the collection has)")
    parser.add_argument("--seconds", type=int, default=10, help="of Operon for an equation (default: %(default)s)")
    parser.add_argument("--library", default="auto", help="candidate terms of commonlaw (default: %(default)s)")
    parser.add_argument("--without", nargs="+", default=(), choices=("operon", "commonlaw"), help="leave one out")
    chosen = parser.parse_args(arguments)
    path = chosen.problems / "any_law" / "systems.py"
    if not path.is_file():
        parser.error(
            f"no any_law/systems.py in {chosen.problems}: name its folder by --problems or COMMONLAW_BENCHMARKS"
        )
    problems, scores = run_path(str(path)), list[dict[str, Any]]()
    print(f"{machine()}\n\n| system | noise | who | laws right | error of rates | seconds |\n|---|---|---|---|---|---|")
    for name in chosen.only or problems["SYSTEMS"]:
        for level in chosen.noise:
            for seed in range(chosen.seeds):
                for score in _scores(problems, name, level, seed, chosen):
                    scores.append(score | {"noise": level})
                    print(_row(score | {"noise": level}), flush=True)
    print("\n| | noise | laws right | systems right | seconds |\n|---|---|---|---|---|")
    for who in dict.fromkeys(score["who"] for score in scores):
        for level in chosen.noise:
            print(_sum(who, level, [score for score in scores if (score["who"], score["noise"]) == (who, level)]))


def _row(score: Mapping[str, Any]) -> str:
    right, level = f"{score['right']} of {score['objects']}", f"{100 * score['noise']:g} %"
    return f"| {score['name']} | {level} | {score['who']} | {right} | {score['error']:.2g} | {score['seconds']:.1f} |"


def _sum(who: str, level: float, scores: Sequence[Mapping[str, Any]]) -> str:
    right, objects = (sum(score[name] for score in scores) for name in ("right", "objects"))
    systems, seconds = sum(score["all_right"] for score in scores), sum(score["seconds"] for score in scores)
    return f"| {who} | {100 * level:g} % | {right} of {objects} | {systems} of {len(scores)} | {seconds:.0f} |"


def _scores(
    problems: Mapping[str, Any], name: str, level: float, seed: int, chosen: argparse.Namespace
) -> Iterator[dict[str, Any]]:
    objects = {"objects": chosen.objects} if chosen.objects else {}
    problem = problems["make"](name, seed=seed, noise=level, **objects)
    driven = any(re.search(r"\bt\b", each) for each in problems["SYSTEMS"][name][1])
    begun = time.perf_counter()
    found: dict[str, list[Model]] = {}
    if "operon" not in chosen.without:
        fronts = [operon(problem, i, driven, chosen.seconds, seed) for i in range(len(problem.objects))]
        found["Operon"] = [model([_of_evidence(each) for each in front], driven) for front in fronts]
        found["Operon, best of its front"] = [
            model([_nearest(each, problem, i, j, driven) for j, each in enumerate(front)], driven)
            for i, front in enumerate(fronts)
        ]
    for who, models in found.items():
        yield problems["score"](problem, models) | {"who": who, "seconds": time.perf_counter() - begun}
    if "commonlaw" not in chosen.without:
        begun = time.perf_counter()
        models = ours(problem, chosen.library)
        yield problems["score"](problem, models) | {"who": "commonlaw", "seconds": time.perf_counter() - begun}


Front = list[tuple[Formula, int, float]]
"""Formulas for one equation, none of which is both longer and worse than another: with the count of their numbers, and
the BIC."""


def operon(problem: Any, index: int, driven: bool, seconds: int, seed: int) -> list[Front]:
    """Return what symbolic regression finds for each equation of an object."""
    from pyoperon.sklearn import SymbolicRegressor

    variables, rates = smoothed(problem.objects[index], problem.order, driven)
    fronts = []
    for target in rates.T:
        regressor = SymbolicRegressor(
            allowed_symbols=_SYMBOLS,
            optimizer_iterations=10,
            max_length=_MOST_NODES,
            objectives=["r2", "length"],
            generations=10**6,
            max_evaluations=10**9,
            max_time=seconds,
            model_selection_criterion="bayesian_information_criterion",
            random_state=seed,
        )
        regressor.fit(variables, target)
        texts = [(each, regressor.get_model_string(each["tree"], 17)) for each in regressor.pareto_front_]
        formulas = [(each["bayesian_information_criterion"], Formula.of(text)) for each, text in texts]
        fronts.append([(each, each.count(variables), bic) for bic, each in formulas])
    return fronts


def smoothed(trials: Sequence[tuple[Floats, Floats]], order: int, driven: bool) -> tuple[Floats, Floats]:
    """Return states, rates if the law is of second order, and time if it is driven; and the highest derivatives."""
    variables, targets = [], []
    for times, measured in trials:
        found = RobustSpline().differentiate(times, measured, order)
        columns = [found.states, *found.derivatives[: order - 1], *([times[:, np.newaxis]] if driven else [])]
        variables.append(np.column_stack(columns)[_TRIM:-_TRIM])
        targets.append(found.derivatives[order - 1][_TRIM:-_TRIM])
    return np.concatenate(variables), np.concatenate(targets)


def _of_evidence(front: Front) -> tuple[Formula, int]:
    """Return the formula of the least BIC, which is what Operon returns."""
    formula, count, _ = min(front, key=lambda each: each[2])
    return formula, count


def _nearest(front: Front, problem: Any, index: int, equation: int, driven: bool) -> tuple[Formula, int]:
    """Return the formula nearest to the truth among those with no more numbers, which only who knows the truth can."""
    points = problem.fresh[index]
    true = np.array([problem.truth[index](point[0], point[1:]) for point in points])[:, -len(problem.states) + equation]
    few = [each for each in front if each[1] <= problem.numbers[equation]] or front[:1]
    errors = [
        np.nan_to_num(np.mean((each.values(_columns(points, driven)) - true) ** 2), nan=np.inf) for each, *_ in few
    ]
    formula, count, _ = few[int(np.argmin(errors))]
    return formula, count


def _columns(points: Floats, driven: bool) -> Floats:
    """Return points [time, states ...] as variables of formulas."""
    return np.column_stack([points[:, 1:], points[:, :1]]) if driven else points[:, 1:]


def model(formulas: Sequence[tuple[Formula, int]], driven: bool) -> Model:
    """Return the model that formulas make, one for each equation."""
    return (
        lambda points: np.column_stack([each.values(_columns(points, driven)) for each, _ in formulas]),
        [count for _, count in formulas],
    )


def ours(problem: Any, library: str) -> list[Model]:
    """Return the law that commonlaw finds, as the model of each object."""
    listed = [(i, *trial) for i, trials in enumerate(problem.objects) for trial in trials]
    trials = cl.Trials.from_arrays(
        [times for _, times, _ in listed],
        [states for *_, states in listed],
        object=[str(i) for i, *_ in listed],
        names=list(problem.states),
    )
    law = cl.discover(trials, order=problem.order, library=library, cache=False)
    return [(partial(_rates, law, name), counts(law, name)) for name in law.objects]


def _rates(law: cl.Law, name: str, points: Floats) -> Floats:
    """Return the highest derivatives of an object at points [time, states ...]."""
    return law.rhs(name, _columns(points, driven=True))


def counts(law: cl.Law, name: str) -> list[int]:
    """Return how many numbers each equation of an object has: coefficients, and parameters inside of its terms."""
    first = len(law.terms.variables.measured)
    found = []
    for row in law.coefficients[object_index(law, name)]:
        used = [k for k in np.flatnonzero(row) if law.terms.is_factor[k]]
        inside = {column for k in used for column in law.terms.terms[k].columns() if column >= first}
        found.append(len(used) + len(inside))
    return found


if __name__ == "__main__":
    main()
