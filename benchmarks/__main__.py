"""Run the benchmarks and print their tables as Markdown."""

import argparse
import importlib.util
import statistics
import sys
import time
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from benchmarks import accuracy
from benchmarks.cases import BOUND, CASES, DEGREES, ROWS, Case
from benchmarks.machine import machine
from benchmarks.measure import Measurement, measure

Runs = Mapping[str, Sequence[Measurement]]


def main() -> None:
    """Read the command line and run what it asks for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small sizes, each once: to see that everything runs")
    parser.add_argument("--case", choices=[*CASES, "growth", "accuracy"], help="this part only")
    parser.add_argument("--most-rows", type=float, default=1e6, help="in the table of growth with rows, up to 1e7")
    chosen = parser.parse_args()
    print(f"{machine()}\n")
    parts = [chosen.case] if chosen.case else [*CASES, "growth", "accuracy"]
    cases = [name for name in parts if name in CASES]
    if cases:
        _print_comparison(cases, chosen.quick)
    if "growth" in parts:
        rows = [name for name in ROWS if float(name.split()[0]) <= chosen.most_rows]
        _print_growth({name: ROWS[name] for name in rows}, chosen.quick)
        _print_growth(DEGREES, chosen.quick)
    if "accuracy" in parts:
        accuracy.main()


def _print_comparison(names: Sequence[str], quick: bool) -> None:
    print("| case | who | median s (runs) | fastest s | MB above start | PySINDy / this | goal | this / dsyrk | same |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name in names:
        case = CASES[name]
        runs = _alternate(name, case, quick)
        for line in _compared(case, runs):
            print(line, flush=True)
    print()


def _alternate(name: str, case: Case, quick: bool) -> Runs:
    """Run the contestants in turns; a slow one drops out of later turns."""
    runs: dict[str, list[Measurement]] = {contestant: [] for contestant in case.contestants if _is_here(contestant)}
    for turn in range(1 if quick else max(contestant.repeats for contestant in case.contestants.values())):
        for each, measured in runs.items():
            if turn < case.contestants[each].repeats:
                start = time.perf_counter()
                measured.append(measure(name, each, quick))
                print(f"{name}, {each}: {time.perf_counter() - start:.1f} s in all", file=sys.stderr)
    return runs


def _compared(case: Case, runs: Runs) -> Iterator[str]:
    """Yield a line of the table for each contestant."""
    peers = [run for run in runs if run.startswith("PySINDy")]
    for i, (each, measured) in enumerate(runs.items()):
        took, goal = _median(measured), case.contestants[each].goal
        against = peers if each.startswith("commonlaw") else []
        cells = [
            "" if i else case.title,
            each,
            f"{took:.4g} ({len(measured)})",
            f"{min(run.seconds for run in measured):.4g}",
            f"{max(run.memory for run in measured) / 1e6:.0f}",
            ", ".join(f"{_median(runs[peer]) / took:.3g}" for peer in against),
            f"{goal:g}" if goal else "",
            f"{took / _median(runs[BOUND]):.3g}" if BOUND in runs and against else "",
            ", ".join(_agreement(case, runs[peer], measured) for peer in against),
        ]
        yield f"| {' | '.join(cells)} |"


def _agreement(case: Case, theirs: Sequence[Measurement], measured: Sequence[Measurement]) -> str:
    """Say whether two contestants found the same, and how near they are, relative to the largest number."""
    one, other = case.compared(theirs[0].result), case.compared(measured[0].result)
    apart = float(np.max(np.abs(one - other)) / np.max(np.abs(one)))
    same = apart <= case.tolerance and np.array_equal(one != 0, other != 0)
    return f"{'yes' if same else 'NO'} ({apart:.0e})"


def _print_growth(cases: Mapping[str, Case], quick: bool) -> None:
    print("| rows | terms | commonlaw s | ns a row | MB above start | commonlaw / dsyrk |")
    print("|---|---|---|---|---|---|")
    costs = []
    for name, case in cases.items():
        runs, problem = _alternate(name, case, quick), case.problem(quick)
        took = _median(runs["commonlaw"])
        costs.append(took / problem.rows)
        memory = max(run.memory for run in runs["commonlaw"]) / 1e6
        print(
            f"| {problem.rows} | {problem.terms} | {took:.4g} | {1e9 * costs[-1]:.0f} | {memory:.0f} "
            f"| {took / _median(runs[BOUND]):.3g} |",
            flush=True,
        )
    print(f"\nA row of the last takes {costs[-1] / costs[0]:.2g} times as long as a row of the first.\n")


def _median(measured: Sequence[Measurement]) -> float:
    return statistics.median(run.seconds for run in measured)


def _is_here(contestant: str) -> bool:
    return not contestant.startswith("PySINDy") or importlib.util.find_spec("pysindy") is not None


if __name__ == "__main__":
    main()
