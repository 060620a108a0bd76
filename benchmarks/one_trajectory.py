"""Laws of one trajectory alone, of textbook systems of one to four states: do they go through it, and elsewhere?

A trajectory of 512 samples, whose errors are in proportion to what is measured; half of the samples may be dropped.
The law is simulated from the true start of it, and from another start, and held against the true solutions.
"""

import argparse
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import commonlaw as cl
from benchmarks.machine import machine

Floats = NDArray[np.float64]

SAMPLES = 512
ENOUGH = 0.9
"""The R^2 of a law that goes through a trajectory."""


@dataclass(frozen=True)
class System:
    """Equations with their numbers, two starts, and how long trajectories are.

    Parameters
    ----------
    equations
        By state.
    starts
        Of what is learned from, and of what is not.
    end
        The time of the last sample.
    """

    equations: Mapping[str, str]
    starts: tuple[tuple[float, ...], tuple[float, ...]]
    end: float

    def solve(self, start: Sequence[float]) -> Floats:
        """Return the true states at all samples, shape (n, D)."""
        codes = [compile(text, name, "eval") for name, text in self.equations.items()]
        functions = {each: getattr(np, each) for each in ("sin", "cos", "exp", "log", "sqrt", "tanh", "sign", "abs")}

        def rates(_: float, states: Floats) -> list[float]:
            names = functions | dict(zip(self.equations, states, strict=True))
            return [float(eval(code, names)) for code in codes]

        found = solve_ivp(rates, (0, self.end), start, t_eval=self.times, rtol=1e-9, atol=1e-10, method="LSODA")
        return np.asarray(found.y.T)

    @property
    def times(self) -> Floats:
        """Of all samples."""
        return np.linspace(0, self.end, SAMPLES)


def _one(rate: str, starts: tuple[float, float], end: float) -> System:
    return System({"x": rate}, ((starts[0],), (starts[1],)), end)


SYSTEMS: Mapping[str, System] = {
    # One state
    "capacitor": _one("(5 - x/2)/3", (8.0, 3.0), 20.0),
    "logistic": _one("0.8*x*(1 - x/70)", (6.0, 20.0), 12.0),
    "harvested logistic": _one("0.6*x*(1 - x/90) - 5*x/(8 + x)", (25.0, 70.0), 14.0),
    "Gompertz": _one("-0.15*x*log(x/4)", (0.3, 9.0), 20.0),
    "falling with drag": _one("9.8 - 0.004*x**2", (0.5, 80.0), 14.0),
    "Allee": _one("0.4*x*(x/20 - 1)*(1 - x/80)", (21.0, 45.0), 16.0),
    "budworm": _one("0.5*x*(1 - x/12) - x**2/(1 + x**2)", (3.2, 9.0), 20.0),
    "laser": _one("2*x - 0.1*x**2", (0.7, 30.0), 5.0),
    "bead on a hoop": _one("0.1*sin(x)*(8*cos(x) - 1)", (3.0, 0.4), 14.0),
    "autocatalysis": _one("1.8*x - 0.6*x**2", (0.15, 5.0), 5.0),
    "languages": _one("0.3*(1 - x)*x**1.4 - 0.5*x*(1 - x)**1.4", (0.7, 0.3), 40.0),
    "infection": _one("0.6*x*(1 - x) - 0.2*x", (0.02, 0.9), 25.0),
    "enzyme": _one("-3*x/(2 + x)", (11.0, 5.0), 8.0),
    "tank": _one("1.1 - 0.6*sqrt(x)", (9.0, 0.5), 15.0),
    "diode": _one("1 - 0.4*x - 0.02*(exp(3*x) - 1)", (-1.0, 1.2), 6.0),
    "switch": _one("0.1 + 1.3*x**2/(0.6 + x**2) - 0.7*x", (0.1, 3.0), 16.0),
    "fold and return": _one("0.5 + x**2 - 0.1*x**3", (-1.2, 0.4), 6.0),
    "overdamped pendulum": _one("0.6 - 0.9*sin(x)", (-2.5, 1.6), 12.0),
    "leak and gain": _one("1.2 - 0.2*x - exp(-x)", (0.3, 9.0), 14.0),
    "power growth": _one("1.1*x**0.75 - 0.45*x", (0.5, 60.0), 14.0),
    # Two states
    "spring": System({"x": "y", "y": "-2.1*x"}, ((0.4, -0.03), (0.0, 0.2)), 12.0),
    "damped spring": System({"x": "y", "y": "-4.5*x - 0.43*y"}, ((0.12, 0.043), (0.0, -0.3)), 12.0),
    "predator and prey": System({"x": "0.5*x - 0.05*x*y", "y": "0.02*x*y - 0.3*y"}, ((6.0, 5.0), (40.0, 15.0)), 30.0),
    "two competitors": System({"x": "3*x - x**2 - 2*x*y", "y": "2*y - x*y - y**2"}, ((1.2, 0.9), (0.4, 1.6)), 10.0),
    "pendulum": System({"x": "y", "y": "-0.9*sin(x)"}, ((1.9, 0.0), (-0.8, 1.0)), 18.0),
    "damped pendulum": System({"x": "y", "y": "-0.64*sin(x) - 0.07*y"}, ((-2.5, 0.2), (1.2, 0.4)), 25.0),
    "dipole": System({"x": "0.7*x*y", "y": "y**2 - x**2"}, ((3.2, -1.5), (1.4, -0.4)), 4.0),
    "coin flip": System({"x": "y", "y": "-x + x**3 - 0.1*y"}, ((0.8, 0.1), (-0.6, -0.2)), 20.0),
    "Van der Pol": System({"x": "y", "y": "-x + 0.43*y*(1 - x**2)"}, ((2.2, 0.0), (0.1, 3.2)), 18.0),
    "stiff Van der Pol": System({"x": "4*(y - x**3/3 + x)", "y": "-x/4"}, ((0.7, 0.0), (-1.1, -0.7)), 18.0),
    "glycolysis": System({"x": "-x + 0.1*y + x**2*y", "y": "0.6 - 0.1*y - x**2*y"}, ((0.4, 0.4), (0.2, 1.8)), 25.0),
    "Brusselator": System({"x": "1 - 4*x + x**2*y", "y": "3*x - x**2*y"}, ((0.7, 0.7), (2.0, 1.2)), 20.0),
    "Duffing": System({"x": "y", "y": "x - x**3 - 0.25*y"}, ((0.6, 0.5), (-1.4, 0.7)), 20.0),
    "excitable": System({"x": "x - x**3/3 - y + 0.5", "y": "0.08*(x + 0.7 - 0.8*y)"}, ((-1.0, 1.0), (1.5, -0.4)), 60.0),
    "sated predator": System(
        {"x": "x*(1 - x/4) - 1.5*x*y/(1 + x)", "y": "1.1*x*y/(1 + x) - 0.5*y"}, ((1.0, 0.4), (3.0, 1.2)), 30.0
    ),
    "chlorine dioxide": System(
        {"x": "8.9 - x - 4*x*y/(1 + x**2)", "y": "1.4*x*(1 - y/(1 + x**2))"}, ((0.2, 0.35), (3.0, 7.8)), 12.0
    ),
    "epidemic": System({"s": "-0.4*s*i", "i": "0.4*s*i - 0.31*i"}, ((7.2, 0.98), (20.0, 12.4)), 10.0),
    "glider": System({"v": "-sin(a) - 0.06*v**2", "a": "v - cos(a)/v"}, ((5.0, 0.7), (9.8, 0.1)), 15.0),
    "two clocks": System({"x": "1.1 + 0.4*sin(y - x)", "y": "1.5 + 0.6*sin(x - y)"}, ((0.3, 1.9), (2.6, 0.4)), 12.0),
    "driven oscillator": System({"x": "0.3 + cos(y)", "y": "0.9 - 0.5*sin(x)"}, ((0.2, 1.1), (1.4, -0.6)), 8.0),
    "chemostat": System(
        {"s": "0.3*(5 - s) - 2*s*x/(0.8 + s)", "x": "0.9*s*x/(0.8 + s) - 0.3*x"}, ((4.5, 0.1), (1.0, 1.5)), 20.0
    ),
    "bead and frame": System({"x": "y", "y": "sin(x)*(0.93*cos(x) - 1) - 0.1*y"}, ((2.1, 0.0), (-1.2, -0.2)), 20.0),
    "cubic stars": System({"x": "x*(1 - x**2 - 2*y**2)", "y": "y*(1.2 - y**2 - x**2)"}, ((0.1, 0.2), (1.5, 0.6)), 8.0),
    # Three states
    "Lorenz, settling": System(
        {"x": "5*(y - x)", "y": "12*x - y - x*z", "z": "x*y - 8*z/3"}, ((2.3, 8.1, 12.4), (10.0, 20.0, 30.0)), 8.0
    ),
    "Lorenz, chaotic": System(
        {"x": "10*(y - x)", "y": "28*x - y - x*z", "z": "x*y - 8*z/3"}, ((2.3, 8.1, 12.4), (8.0, 15.0, 32.0)), 6.0
    ),
    "Roessler, periodic": System(
        {"x": "5*(-y - z)", "y": "5*(x - 0.2*y)", "z": "5*(0.2 + z*(x - 5.7))"},
        ((2.3, 1.1, 0.8), (-0.1, 4.1, -2.1)),
        10.0,
    ),
    "Roessler": System(
        {"x": "-y - z", "y": "x + 0.2*y", "z": "0.2 + z*(x - 5.7)"}, ((2.3, 1.1, 0.8), (-4.0, -3.0, 0.1)), 25.0
    ),
    "epidemic, latent": System(
        {"s": "-0.5*s*i", "e": "0.5*s*i - 0.4*e", "i": "0.4*e - 0.2*i"}, ((1.0, 0.05, 0.02), (0.7, 0.2, 0.1)), 30.0
    ),
    "rigid body": System({"x": "0.8*y*z", "y": "-1.1*x*z", "z": "0.4*x*y"}, ((1.0, 0.3, 0.9), (-0.4, 1.2, 0.8)), 14.0),
    "laser, three": System(
        {"e": "1.2*(p - e)", "p": "0.9*(e*d - p)", "d": "0.5*(3.1 - d - 2.1*e*p)"},
        ((1.3, 1.1, 0.9), (0.3, 0.2, 2.5)),
        14.0,
    ),
    "Aizawa": System(
        {
            "x": "(z - 0.7)*x - 3.5*y",
            "y": "3.5*x + (z - 0.7)*y",
            "z": "0.65 + 0.95*z - z**3/3 - (x**2 + y**2)*(1 + 0.25*z)",
        },
        ((0.1, 0.05, 0.05), (-0.3, 0.2, 0.1)),
        10.0,
    ),
    "food chain": System(
        {
            "x": "x*(1 - x) - 3*x*y/(1 + 3*x)",
            "y": "3*x*y/(1 + 3*x) - 0.4*y - 0.1*y*z/(1 + 2*y)",
            "z": "0.1*y*z/(1 + 2*y) - 0.01*z",
        },
        ((0.7, 0.2, 8.0), (0.9, 0.1, 9.5)),
        60.0,
    ),
    "relay": System(
        {"x": "1.3/(1 + z**4) - 0.6*x", "y": "0.9*x - 0.6*y", "z": "0.9*y - 0.6*z"},
        ((0.2, 0.5, 0.1), (2.0, 0.4, 1.2)),
        25.0,
    ),
    # Four states
    "binding": System(
        {"a": "-0.3*a*b + 0.1*c", "b": "-0.3*a*b + 0.3*c", "c": "0.3*a*b - 0.3*c", "d": "0.2*c - 0.1*d"},
        ((3.0, 2.0, 0.1, 0.1), (1.0, 3.0, 0.5, 1.0)),
        16.0,
    ),
    "epidemic, isolated": System(
        {"s": "-0.28*s*i", "i": "0.28*s*i - 0.3*i", "q": "0.3*i - 0.15*q", "r": "0.15*q"},
        ((6.0, 0.5, 0.3, 0.1), (4.0, 1.5, 0.1, 0.6)),
        16.0,
    ),
}
"""Systems of textbooks, with numbers that were made up."""


@dataclass(frozen=True)
class Score:
    """How well the law of one trajectory goes through it and elsewhere.

    Parameters
    ----------
    system, noise, dropped, seed
        The errors over the states, and the share of samples that were dropped.
    learned, elsewhere
        R^2 from the true start of what was learned from, and from another.
    law
        Its equations, or what went wrong.
    seconds
        Of processor time.
    """

    system: str
    noise: float
    dropped: float
    seed: int
    learned: float
    elsewhere: float
    law: str
    seconds: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the share of systems whose law goes through what it was learned from, and elsewhere."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.one_trajectory", description=__doc__)
    parser.add_argument("--only", nargs="+", default=tuple(SYSTEMS), metavar="NAME", help="these systems")
    parser.add_argument("--noise", nargs="+", type=float, default=(0.0, 0.05), metavar="LEVEL", help="5 %% is 0.05")
    parser.add_argument("--dropped", nargs="+", type=float, default=(0.0, 0.5), metavar="SHARE", help="of the samples")
    parser.add_argument("--seeds", type=int, default=1, help="of each system (default: %(default)s)")
    parser.add_argument("--library", default="auto", help="default: %(default)s")
    parser.add_argument("--save", type=Path, help="where each score is added when it is there")
    chosen = parser.parse_args(arguments)
    scores = list[Score]()
    print(f"{machine()}\n\n| system | noise | dropped | R2 | elsewhere | CPU s | law |\n|---|---|---|---|---|---|---|")
    for score in _scores(chosen):
        scores.append(score)
        print(_row(score), flush=True)
        if chosen.save:
            with chosen.save.open("a") as file:
                print(json.dumps(asdict(score)), file=file)
    print("\n| noise | dropped | laws | what was learned | elsewhere | CPU s, mean |\n|---|---|---|---|---|---|")
    for noise in chosen.noise:
        for dropped in chosen.dropped:
            print(_sum([score for score in scores if (score.noise, score.dropped) == (noise, dropped)]))


def _scores(chosen: argparse.Namespace) -> Iterator[Score]:
    for name in chosen.only:
        for noise in chosen.noise:
            for dropped in chosen.dropped:
                for seed in range(chosen.seeds):
                    yield scored(name, noise, dropped, seed, chosen.library)


def scored(name: str, noise: float, dropped: float, seed: int, library: str) -> Score:
    """Return what the law of one trajectory is worth."""
    system, generator = SYSTEMS[name], np.random.default_rng([*name.encode(), seed])
    began, clean = time.process_time(), system.solve(system.starts[0])
    measured = clean * (1 + noise * generator.standard_normal(clean.shape))
    kept = np.sort(generator.permutation(SAMPLES)[: round(SAMPLES * (1 - dropped))])
    try:
        law = cl.discover(
            cl.Trials.from_arrays(system.times[kept], measured[kept], names=list(system.equations)),
            library=library,
            cache=False,
        )
    except cl.CommonlawError as failure:
        return Score(name, noise, dropped, seed, -np.inf, -np.inf, str(failure), time.process_time() - began)
    learned, elsewhere = (_r2(law, system, start) for start in system.starts)
    equations = "; ".join(str(law).splitlines()[: len(system.equations)])
    return Score(name, noise, dropped, seed, learned, elsewhere, equations, time.process_time() - began)


def _r2(law: cl.Law, system: System, start: Sequence[float]) -> float:
    """Return R^2 of a simulation, over all states together; minus infinity if it diverges."""
    true = system.solve(start)
    (object_,) = law.objects
    try:
        states = law.simulate(system.times, start)[object_].states
    except cl.CommonlawError:
        return -np.inf
    spread = np.sum((true - true.mean(axis=0)) ** 2)
    value = 1 - np.sum((states - true) ** 2) / spread if states.shape == true.shape else np.nan
    return float(value) if np.isfinite(value) else -np.inf


def _row(score: Score) -> str:
    scores = f"{score.learned:.3f} | {score.elsewhere:.3f} | {score.seconds:.1f}"
    return f"| {score.system} | {100 * score.noise:g} % | {score.dropped:g} | {scores} | {score.law} |"


def _sum(scores: Sequence[Score]) -> str:
    counts = [sum(getattr(score, name) > ENOUGH for score in scores) for name in ("learned", "elsewhere")]
    shares = " | ".join(f"{count} ({count / len(scores):.0%})" for count in counts)
    seconds = np.mean([score.seconds for score in scores])
    return f"| {100 * scores[0].noise:g} % | {scores[0].dropped:g} | {len(scores)} | {shares} | {seconds:.1f} |"


if __name__ == "__main__":
    main()
