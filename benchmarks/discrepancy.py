"""What a law leaves unexplained: whether coefficients keep their meaning, functions are right, and claims are true."""

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import commonlaw as cl
from benchmarks.coverage import interval
from benchmarks.machine import machine
from commonlaw.datasets.sphere_drag import AIR_DENSITY, AIR_VISCOSITY, drag_coefficient, reynolds_number
from commonlaw.discrepancy.function import Discrepancy
from commonlaw.law.law import object_index
from commonlaw.law.parameters import standard_errors

Floats = NDArray[np.float64]

GRAVITY, DRAG = 9.8, 0.4
ERRORS = {"x": 0.1, "v": 0.2}
"""Of heights and speeds of falls."""

SPANS = (1.0, 1.5, 2.5)
"""Seconds of a fall, ten samples each."""

REYNOLDS = f"abs(v)*2*radius/{AIR_VISCOSITY!r}"
AREA = "v*abs(v)*radius^2/mass"
HEIGHTS = {20.0: 30, 47.33: 49, 80.0: 65}
"""Where forecasts start, m, and their samples; the second is what the law was learned from."""

SPEEDS = (0.3, 1.0)
"""From which share of the largest visited speed on the drag coefficient is compared: all of it is not seen below."""


def fall(seed: int, span: float) -> cl.Trials:
    """Return ten noisy heights and speeds of a fall from rest, ``v' = 9.8 - 0.4 v |v|``."""
    times = np.linspace(0.0, span, 10)

    def field(_: float, z: Floats) -> list[float]:
        return [z[1], GRAVITY - DRAG * z[1] * abs(z[1])]

    states = solve_ivp(field, (0.0, span), [0.0, 0.0], t_eval=times, rtol=1e-10, atol=1e-12).y.T
    noise = np.random.default_rng(seed).normal(size=states.shape) * list(ERRORS.values())
    return cl.Trials.from_arrays(times, states + noise, names=list(ERRORS))


def fallen(seed: int, span: float) -> list[float]:
    """Return whether intervals of g hold it, with a discrepancy and without, and how right the function is."""
    trials = fall(seed, span)
    law = cl.fit("x' = v; v' = g", trials, noise=ERRORS, errors="white")
    found = law.discrepancy(trials, of="v", noise=ERRORS)
    values = [(each.coefficients[0][each.support][-1], np.nanmax(standard_errors(each))) for each in (found.law, law)]
    held = [abs(value - GRAVITY) < 1.96 * error for value, error in values]
    speeds = np.linspace(0.0, np.sqrt(GRAVITY / DRAG) * np.tanh(np.sqrt(GRAVITY * DRAG) * span), 21)[1:]
    function, truth = found(speeds), -DRAG * speeds**2
    whole = values[0][0] + function - GRAVITY - truth
    inside = np.mean(abs(function - truth) < 1.96 * found.std(speeds))
    scale = np.sqrt(np.mean(truth**2))
    off = np.sqrt(np.mean((function - truth) ** 2)) / scale
    return [
        *held,
        values[0][1],
        off,
        np.sqrt(np.mean(whole**2)) / scale,
        inside,
        found.claimed,
        *(function - truth) / scale,
    ]


def dropped(seed: int, equation: str) -> list[list[float]]:
    """Return for each ball how far its drag coefficient is off, and the shares of bands that hold."""
    drops = cl.datasets.reynolds_drag(seed=seed)
    found = cl.fit(equation, drops).discrepancy(drops, of=REYNOLDS, times=AREA)
    shares, rows = [*_held(found, seed)], []
    for name in drops.objects:
        radius, mass = (float(drops.properties[name][each]) for each in ("radius", "mass"))
        fastest = max(abs(np.gradient(trial.states[:, 0], trial.times)).max() for trial in drops.of_object(name))
        speeds = np.linspace(SPEEDS[0], SPEEDS[1], 15) * fastest
        slope = found.law.coefficients[object_index(found.law, name)][0, found.law.terms.index("v")]
        reynolds = reynolds_number(speeds, 2 * radius)
        force = mass * (-slope * speeds) - found(reynolds) * radius**2 * speeds**2
        right = drag_coefficient(reynolds) * AIR_DENSITY * np.pi * radius**2 * speeds**2 / 2
        rows.append([np.sqrt(np.mean((force / right - 1) ** 2)), abs(force / right - 1).max(), *shares])
    return rows


def _held(found: Discrepancy[cl.Law], seed: int) -> Iterator[float]:
    """Yield the shares of measurements of new drops in the bands, with the discrepancy and without, by height."""
    for height, samples in HEIGHTS.items():
        new = cl.datasets.reynolds_drag(seed=seed + 10_000, height=height, samples=samples, trials=1)
        for how in (True, False):
            frame = found.law.predict(new, start=10, return_std=True, discrepancy=how).to_frame()
            ahead = frame[frame["t"] > new[0].times[9]]
            yield float(((ahead["x measured low"] < ahead["x"]) & (ahead["x"] < ahead["x measured high"])).mean())


def claimed(seed: int) -> list[float]:
    """Return whether a discrepancy is claimed of a law that is true, and its evidence."""
    drops = cl.datasets.linear_drag(noise=0.05, seed=seed)
    found = cl.fit("x'' = -g - c v", drops).discrepancy(drops)
    return [found.claimed, found.evidence]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the three tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.discrepancy", description=__doc__)
    parser.add_argument("--draws", type=int, default=200, metavar="N", help="Falls; half as many of the true law.")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="Processes at a time.")
    chosen = parser.parse_args(arguments)
    begun = time.perf_counter()
    print(f"{machine()}\n\n{_table(TITLE, FALLS)}")
    for span in SPANS:
        print(_falls(span, _all(fallen, chosen.draws, chosen.jobs, span)), flush=True)
    heights = [head for height in HEIGHTS for head in (f"bands from {height:g} m", "without")]
    print(f"\n{_table('Drops with the drag of Brown and Lawler.', [*DROPS, *heights])}")
    for equation in ("x'' = a + b v", "x'' = -9.8 + b v"):
        print(_drops(equation, _all(dropped, max(chosen.draws // 20, 1), chosen.jobs, equation)), flush=True)
    rows = _all(claimed, max(chosen.draws // 2, 1), chosen.jobs)
    claims, largest = int(rows[:, 0].sum()), rows[:, 1].max()
    print(f"\nThe law is true: claimed in {claims} of {len(rows)} draws, largest 2 log B {largest:.1f}.")
    print(f"\n{time.perf_counter() - begun:.0f} s in all, in {chosen.jobs} process(es) at a time.", file=sys.stderr)


FALLS = (
    "seconds",
    "g held",
    "its 95 % interval",
    "without",
    "error of g",
    "f off",
    "mean f off",
    "g + f off",
    "band of f",
    "claimed",
)
TITLE = "Falls of ten samples, law v' = g."
DROPS = ("law", "drag coefficient off, rms", "largest")


def _table(title: str, heads: Sequence[str]) -> str:
    return f"{title}\n\n| {' | '.join(heads)} |\n|{'---|' * len(heads)}"


def _falls(span: float, rows: Floats) -> str:
    held, without, error, off, whole, inside, claims, *errors = rows.T
    low, high = interval(float(held.mean()), len(rows))
    shares = f"{held.mean():.3f} | {low:.3f} to {high:.3f} | {without.mean():.3f} | {np.median(error):.2f}"
    mean = np.sqrt(np.mean(np.mean(errors, axis=1) ** 2))
    function = f"{np.median(off):.1%} | {mean:.1%} | {np.median(whole):.1%} | {inside.mean():.3f} | {claims.mean():.2f}"
    return f"| {span:g} | {shares} | {function} |"


def _drops(equation: str, rows: Floats) -> str:
    balls = rows.reshape(-1, rows.shape[-1])
    shares = " | ".join(f"{each:.3f}" for each in balls[:, 2:].mean(axis=0))
    return f"| {equation} | {np.sqrt(np.mean(balls[:, 0] ** 2)):.1%} | {balls[:, 1].max():.1%} | {shares} |"


def _all(run: Callable[..., object], draws: int, jobs: int, *given: object) -> Floats:
    """Return the rows of all draws."""
    return np.array(Parallel(n_jobs=jobs)(delayed(run)(seed, *given) for seed in range(draws)), dtype=np.float64)


if __name__ == "__main__":
    main()
