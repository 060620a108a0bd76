"""Ordinary tables, as users bring them, and the laws behind them."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.law.parameters import standard_errors


@dataclass(frozen=True)
class Ordinary:
    """A table as text, what is counted in it, the structure of its law, and the true coefficients of each object."""

    table: Callable[[], str]
    counted: str
    structure: str
    coefficients: dict[str, tuple[float, ...]]

    def check(self, law: cl.Law) -> None:
        """Check terms and coefficients, to 5 % and to 4 standard errors."""
        assert law.structure == (self.structure,)
        assert set(law.objects) == set(self.coefficients)
        standard = standard_errors(law)
        for name, truth in self.coefficients.items():
            o = law.objects.index(name)
            estimates, errors = law.coefficients[o, law.support], standard[o, law.support]
            assert estimates == pytest.approx(truth, rel=0.05)
            assert (abs(estimates - truth) < 4 * errors).all()


GRAVITY, HOURS = 9.81, np.linspace(0, 20, 26)
BALLS = {"golf": (0.046, 0.05), "tennis": (0.058, 0.2), "whiffle": (0.024, 0.4)}
STRAINS = {"WT": (0.8, 1.5), "mut": (0.5, 1.0)}
RIGS, DAMPING = {"A": 4.0, "B": 6.0}, 0.2


def drops() -> str:
    """Return balls with masses that fall under linear drag."""
    random, times, rows = np.random.default_rng(0), np.linspace(0, 2.4, 17), list[str]()
    for ball, (mass, drag) in BALLS.items():
        for drop, speed in ((1, 0.0), (2, 6.0)):
            end = GRAVITY / drag
            heights = 35 - end * times + (speed + end) / drag * -np.expm1(-drag * times) + random.normal(0, 0.01, 17)
            rows += [f"{ball},{drop},{mass},{t:.2f},{x:.3f}" for t, x in zip(times, heights, strict=True)]
    return "\n".join(["Ball,Drop,Mass,t,Height", *rows])


def growth() -> dict[str, np.ndarray]:
    """Return optical densities of two replicates of each strain, by strain and replicate."""
    random = np.random.default_rng(0)
    return {
        f"{strain}_{replicate}": K / (1 + (K / 0.05 - 1) * np.exp(-r * HOURS)) + random.normal(0, 0.003, 26)
        for strain, (r, K) in STRAINS.items()
        for replicate in (1, 2)
    }


def growth_in_columns() -> str:
    """Return a column for each curve."""
    rows = np.column_stack([HOURS, *growth().values()])
    return "\n".join(["Time [h],WT_1,WT_2,mut_1,mut_2", *(",".join(f"{cell:.4f}" for cell in row) for row in rows)])


def growth_in_rows() -> str:
    """Return a row for each sample."""
    rows = [
        f"{name.partition('_')[0]},{name.partition('_')[2]},{hour:.1f},{density:.4f}"
        for name, curve in growth().items()
        for hour, density in zip(HOURS, curve, strict=True)
    ]
    return "\n".join(["strain,replicate,time_h,OD600", *rows])


def driven() -> str:
    """Return damped rigs at rest that are pushed by a force, which is switched on and off."""
    random, t, rows = np.random.default_rng(0), np.linspace(0, 10, 41), list[str]()

    def step(since: np.ndarray, stiffness: float) -> np.ndarray:
        w = np.sqrt(stiffness - DAMPING**2)
        swing = np.cos(w * since) + DAMPING / w * np.sin(w * since)
        return np.where(since > 0, (1 - np.exp(-DAMPING * np.maximum(since, 0)) * swing) / stiffness, 0.0)

    for rig, stiffness in RIGS.items():
        for run, (on, off) in ((1, (1.0, 4.0)), (2, (2.0, 7.0))):
            x = step(t - on, stiffness) - step(t - off, stiffness) + random.normal(0, 0.002, 41)
            F = np.where((t >= on) & (t < off), 1.0, 0.0)
            rows += [f"{rig},{run},{i:.2f},{j:.4f},{force:g}" for i, j, force in zip(t, x, F, strict=True)]
    return "\n".join(["rig,run,t,x,F", *rows])


LOGISTIC = {strain: (r, -r / K) for strain, (r, K) in STRAINS.items()}
ORDINARY = {
    "drops": Ordinary(
        drops,
        "6 trials of 3 objects",
        "Height'' = a + b v",
        {name: (-GRAVITY, -drag) for name, (_, drag) in BALLS.items()},
    ),
    "growth in columns": Ordinary(
        growth_in_columns,
        "4 trials of 4 objects",
        "value' = a value + b value^2",
        {name: LOGISTIC[name.partition("_")[0]] for name in growth()},
    ),
    "growth in rows": Ordinary(growth_in_rows, "4 trials of 2 objects", "OD600' = a OD600 + b OD600^2", LOGISTIC),
    "driven": Ordinary(
        driven,
        "4 trials of 2 objects",
        "x'' = a x + b v + c F",
        {name: (-stiffness, -2 * DAMPING, 1.0) for name, stiffness in RIGS.items()},
    ),
}
