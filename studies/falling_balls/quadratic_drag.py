"""A term in the squared velocity: whether the paper's method finds it, and what would."""

from collections.abc import Mapping
from functools import partial
from itertools import product

import numpy as np
import pandas as pd

from commonlaw.datasets import linear_drag
from commonlaw.discovery import DerivativeRegression, discover
from commonlaw.law import Law
from commonlaw.plots import Figure
from commonlaw.report import Picture, Table, Text
from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.method import group_law
from studies.falling_balls.plots import Curve, plot_curves
from studies.falling_balls.recovery import Recovery
from studies.falling_balls.report import Section, Verdict
from studies.falling_balls.settings import (
    DIFFERENTIATION,
    FINDING,
    FINDING_COEFFICIENTS,
    FINDING_DIFFERENTIATION,
    FINDING_LIBRARY,
    FINDING_NOISES,
    FINDING_SEEDS,
    FINDING_TRIALS,
    GROUP_THRESHOLD,
    NOISES,
    QUADRATIC,
    QUADRATIC_THRESHOLDS,
    RATE,
    RELIABLE,
    SIMULATED_SINGLE_THRESHOLD,
)
from studies.falling_balls.simulation import captures, equation, learned, listed, mean_coefficients, on_grid, simulated

_TRUE = {"1", "v", "v^2"}
Grid = Mapping[tuple[float, int, float], tuple[Recovery, Recovery]]
"""By noise, drops of each ball, and coefficient: how often exactly the true terms were found, and how often v^2."""


def quadratic_drag(inquiry: Inquiry) -> Section:
    """Add a term in the squared velocity to the simulated drops, and look for it in the paper's way and in another."""
    clean = linear_drag(quadratic=QUADRATIC, noise=0.0, trials=1)
    path = {threshold: group_law(clean, threshold) for threshold in QUADRATIC_THRESHOLDS}
    laws = learned(
        simulated(clean, NOISES, inquiry.seed), {"single": SIMULATED_SINGLE_THRESHOLD, "group": GROUP_THRESHOLD}
    )
    without = group_law(linear_drag(noise=0.0, trials=1), GROUP_THRESHOLD)
    grid = _search(inquiry.seed)
    blocks = (
        Text(_asked()),
        Table(
            "quadratic-drag-thresholds",
            f"What the group method learns from drops with ${QUADRATIC:g}\\,v^2$ and without noise as its threshold is "
            f"lowered from that of the paper, {GROUP_THRESHOLD:g}; coefficients are averages over the five balls.",
            _path_frame(path),
        ),
        Text(_lowered(path, without)),
        Picture(
            "quadratic-drag-findable",
            f"Share of {FINDING_SEEDS} simulated experiments in which the other method finds exactly 1, $v$ and $v^2$, "
            "against the coefficient of $v^2$, for three noises and for different numbers of drops of each ball. Bands "
            "are 95 % Wilson intervals.",
            partial(_draw, grid),
        ),
        Table(
            "quadratic-drag-grid",
            f"In how many of {FINDING_SEEDS} experiments the other method finds exactly 1, $v$ and $v^2$; after the "
            "stroke, in how many $v^2$ is among its terms. Columns are true coefficients of $v^2$ in 1/m; with 0 there "
            "is nothing to find.",
            _grid_frame(grid),
        ),
        Text(_found(grid)),
    )
    results = {
        "quadratic_findable": {
            "paper": {f"{threshold:g}": mean_coefficients(law) for threshold, law in path.items()},
            "exact": _nested({key: exact.share for key, (exact, _) in grid.items()}),
            "among": _nested({key: among.share for key, (_, among) in grid.items()}),
            "smallest": {
                f"{noise:g}": {f"{drops}": next(iter(_reliable(grid, noise, drops)), None) for drops in FINDING_TRIALS}
                for noise in FINDING_NOISES
            },
        }
    }
    return Section("quadratic-drag", "A squared velocity", blocks, (_verdict(laws, path, without),), results)


def _search(seed: int) -> Grid:
    """Return how often the other method finds the terms, over coefficients, noises and numbers of drops."""
    right: dict[tuple[float, int, float], list[set[str]]] = {}
    for coefficient in FINDING_COEFFICIENTS:
        clean = linear_drag(quadratic=coefficient, noise=0.0, trials=max(FINDING_TRIALS))
        grid = on_grid(FINDING_DIFFERENTIATION, clean[0].times)
        method = DerivativeRegression(differentiation=grid, **FINDING)
        for each in range(seed, seed + FINDING_SEEDS):
            for noise, trials in simulated(clean, FINDING_NOISES, each).items():
                for drops in FINDING_TRIALS:
                    some = trials.with_trials([trial for trial in trials if int(trial.name) <= drops])
                    law = discover(some, order=2, library=FINDING_LIBRARY, method=method)
                    right.setdefault((noise, drops, coefficient), []).append(set(mean_coefficients(law)))
    return {
        key: (
            Recovery(sum(terms == _TRUE for terms in found), len(found)),
            Recovery(sum("v^2" in terms for terms in found), len(found)),
        )
        for key, found in sorted(right.items())
    }


def _draw(grid: Grid) -> Figure:
    coefficients = [each for each in FINDING_COEFFICIENTS if each]

    def curve(noise: float, drops: int) -> Curve:
        found = [grid[noise, drops, coefficient][0] for coefficient in coefficients]
        low, high = np.transpose([each.interval() for each in found])
        return Curve(_drops(drops), coefficients, [each.share for each in found], low, high, points=True)

    panels = {f"noise {noise:g} m": [curve(noise, drops) for drops in FINDING_TRIALS] for noise in FINDING_NOISES}
    return plot_curves(
        panels, "coefficient of v² (1/m)", "share with exactly 1, v, v²", log_x=True, y_limits=(-0.03, 1.03)
    )


def _path_frame(path: Mapping[float, Law]) -> pd.DataFrame:
    rows = [
        {
            "threshold": threshold,
            "learned": equation(law),
            "has v²": "v^2" in mean_coefficients(law),
            "terms that are not there": ", ".join(term for term in mean_coefficients(law) if term not in _TRUE),
        }
        for threshold, law in path.items()
    ]
    return pd.DataFrame(rows)


def _grid_frame(grid: Grid) -> pd.DataFrame:
    rows = [
        {"noise (m)": noise, "drops of each ball": drops}
        | {
            f"{each:g}": " / ".join(str(count.found) for count in grid[noise, drops, each])
            for each in FINDING_COEFFICIENTS
        }
        for noise, drops in product(FINDING_NOISES, FINDING_TRIALS)
    ]
    return pd.DataFrame(rows)


def _asked() -> str:
    return (
        f"The paper then added a term of about ${QUADRATIC:g}\\,v^2$ to the simulated law, which pushes a falling ball "
        "upwards. It reports that none of the learned equations capture this term, not even without noise, that they "
        "look nearly as before, and that a lower threshold brings in other terms along with it. How large would the "
        "coefficient have to be, how little the noise, and how many the drops, to find it?"
    )


def _lowered(path: Mapping[float, Law], without: Law) -> str:
    first, balls = path[GROUP_THRESHOLD], len(without.objects)
    return (
        f"With the paper's threshold the squared velocity is left out, and the other coefficients make up for it: "
        f"{equation(first)}, against {equation(without)} without the squared term. Two things stand in the way. The "
        f"group method compares the sum of the balls' coefficients, here {balls * QUADRATIC:g}, with the threshold, "
        f"{GROUP_THRESHOLD:g}. And its smoothing window, {_window(DIFFERENTIATION)}, is longer than the time in which "
        "these balls come near their final speed, so that the rates are those of another motion.\n\n"
        f"Another method has a window of {_window(FINDING_DIFFERENTIATION)}, leaves out the rates at the ends of each "
        "drop, offers only the terms 1, $v$, $v^2$ and $v^3$ (that the force does not depend on the height is an "
        "assumption), goes through all thresholds of the group method, and lets the Bayesian information criterion "
        "choose. It was picked among some thirty combinations on simulated drops like these, so that its shares are "
        "better than those of a method picked beforehand would be."
    )


def _window(differentiation: str) -> str:
    samples = int(differentiation.split(":")[1])
    return f"{samples} samples or {samples / RATE:.1f} s"


def _found(grid: Grid) -> str:
    lines = []
    for noise, drops in product(FINDING_NOISES, FINDING_TRIALS):
        reliable = _reliable(grid, noise, drops)
        what = f"at {listed([f'{each:g}' for each in reliable])} 1/m" if reliable else "at none of these coefficients"
        lines.append(f"- noise {noise:g} m, {_drops(drops)}: {what}")
    nothing = [among for (_, _, each), (_, among) in grid.items() if not each]
    false, tried = sum(each.found for each in nothing), sum(each.tried for each in nothing)
    return (
        f"Exactly the true terms are found in at least {RELIABLE:.0%} of the experiments:\n\n"
        + "\n".join(lines)
        + f"\n\nWhere there is no $v^2$, it was found in {false} of {tried} experiments. A larger coefficient is not "
        "always easier to find: the balls then reach their final speed within a few samples, and a drop says little "
        "about how the drag grows with speed."
    )


def _reliable(grid: Grid, noise: float, drops: int) -> list[float]:
    """Return the coefficients at which exactly the true terms are found reliably, the smallest first."""
    return [each for each in FINDING_COEFFICIENTS if each and grid[noise, drops, each][0].share >= RELIABLE]


def _drops(drops: int) -> str:
    return f"{drops} drop{'s' if drops > 1 else ''} of each ball"


def _verdict(laws: Mapping[str, Mapping[float, Law]], path: Mapping[float, Law], without: Law) -> Verdict:
    found = np.concatenate([captures(law) for row in laws.values() for law in row.values()])
    alone = [threshold for threshold, law in path.items() if captures(law).any()]
    before, after = mean_coefficients(without)["v"], mean_coefficients(path[GROUP_THRESHOLD])["v"]
    moved = f"from {before:.2f} to {after:.2f} on average".replace("-", "−")
    if not found.any() and not alone:
        return Verdict(
            "reproduced",
            f"No equation captures a term ${QUADRATIC:g}\\,v^2$: none of {found.size}, single or group, at any noise, "
            "has it without terms that are not there, and no lower threshold changes that. They do not look as before, "
            f"though: the coefficient of $v$ goes {moved}.",
        )
    return Verdict(
        "differs",
        f"A term ${QUADRATIC:g}\\,v^2$ is captured by {found.sum()} of {found.size} equations, and at {len(alone)} of "
        f"{len(path)} thresholds without noise.",
    )


def _nested(values: Mapping[tuple[float, int, float], float]) -> dict[str, dict[str, dict[str, float]]]:
    """Return values by noise, drops and coefficient as text."""
    nested: dict[str, dict[str, dict[str, float]]] = {}
    for (noise, drops, coefficient), value in values.items():
        nested.setdefault(f"{noise:g}", {}).setdefault(f"{drops}", {})[f"{coefficient:g}"] = value
    return nested
