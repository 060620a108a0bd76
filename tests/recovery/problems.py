"""Small problems that cover every way to a law: what is measured, and how its law is found."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

import commonlaw as cl

Errors = Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray]

_DECIMALS = 5
"""Of states in their standard deviations: data are the same on all machines."""


def white(share: float) -> Errors:
    """Return errors in proportion to the standard deviation of each state."""
    return lambda path, scale, random: share * scale * random.standard_normal(path.shape)


def proportional(share: float) -> Errors:
    """Return errors in proportion to the states."""
    return lambda path, _, random: share * path * random.standard_normal(path.shape)


def correlated(share: float, keeps: float = 0.9) -> Errors:
    """Return autocorrelated errors, and a tenth as much white noise."""

    def errors(path: np.ndarray, scale: np.ndarray, random: np.random.Generator) -> np.ndarray:
        pushes = np.sqrt(1 - keeps**2) * random.standard_normal(path.shape)
        memory = lfilter([1.0], [1.0, -keeps], pushes, axis=0)
        return share * scale * (memory + 0.1 * random.standard_normal(path.shape))

    return errors


def outliers(share: float) -> Errors:
    """Return white noise, every fifteenth error thirty times as large."""

    def errors(path: np.ndarray, scale: np.ndarray, random: np.random.Generator) -> np.ndarray:
        found = white(share)(path, scale, random)
        found[::15] *= 30
        return found

    return errors


def simulated(
    rates: Callable[..., Sequence[float]],
    numbers: Sequence[Sequence[float]],
    starts: Sequence[Sequence[float]],
    times: np.ndarray,
    errors: Errors,
    *,
    names: Sequence[str] = ("x",),
    measured: Sequence[int] | None = None,
    seed: int = 0,
    columns: Mapping[str, Callable[[np.ndarray], np.ndarray]] | None = None,
    change: Callable[[pd.DataFrame], pd.DataFrame] = lambda frame: frame,
    **roles: Any,
) -> cl.Trials:
    """Return trials of an object for each set of numbers, from each start, with columns that are functions of time."""
    random, paths = np.random.default_rng(seed), list[np.ndarray]()
    kept = list(range(len(names)) if measured is None else measured)
    for number in numbers:
        for start in starts:
            found = solve_ivp(
                rates,
                times[[0, -1]],
                start,
                t_eval=times,
                args=tuple(number),
                rtol=1e-10,
                atol=1e-12,
                max_step=times[1],
            )
            paths.append(found.y[kept].T)
    scale = np.concatenate(paths).std(axis=0).round(_DECIMALS)
    parts = list[pd.DataFrame]()
    for k, path in enumerate(paths):
        i, trial = divmod(k, len(starts))
        states = scale * np.round((path + errors(path, scale, random)) / scale, _DECIMALS)
        known = {name: function(times) for name, function in (columns or {}).items()}
        frame = {"object": f"o{i}", "trial": trial, "t": times, **dict(zip(names, states.T, strict=True)), **known}
        parts.append(pd.DataFrame(frame))
    table = change(pd.concat(parts, ignore_index=True))
    return cl.Trials.from_frame(table, object="object", trial="trial", time="t", states=list(names), **roles)


def _step(t: Any) -> Any:
    return np.where((np.asarray(t) >= 1) & (np.asarray(t) < 3), 1.0, 0.0)


def _sine(t: Any) -> Any:
    return np.sin(2 * np.asarray(t))


def _every_third_missing(frame: pd.DataFrame) -> pd.DataFrame:
    frame.loc[frame.index % 3 == 1, frame.columns[3]] = np.nan
    return frame


def _with_std(frame: pd.DataFrame) -> pd.DataFrame:
    frame["std"] = np.where(frame.index % 2, 0.01, 0.03)
    return frame


def _with_blank(frame: pd.DataFrame) -> pd.DataFrame:
    still = frame[frame["object"] == "o0"].assign(object="blank")
    still["x"] = 0.05 + 0.002 * np.random.default_rng(9).standard_normal(len(still)).round(3)
    return pd.concat([frame, still], ignore_index=True)


relaxation = partial(
    simulated, lambda _, x, k, a: k * (a - x), [(1.1, 2.0), (0.7, 2.9), (0.9, 2.4)], [(-1.0,), (6.0,)],
    np.linspace(0, 5, 40),
)  # fmt: skip
fine_relaxation = partial(
    simulated, lambda _, x, k, a: k * (a - x), [(1.1, 2.0), (0.7, 2.9)], [(-1.0,), (6.0,)], np.linspace(0, 5, 160)
)
logistic = partial(
    simulated, lambda _, x, r, k: r * x * (1 - x / k), [(0.8, 1.5), (0.5, 1.0), (0.6, 1.2)], [(0.05,), (0.3,)],
    np.linspace(0, 15, 40),
)  # fmt: skip
decay = partial(
    simulated, lambda _, x, k: -k * x, [(0.5,), (0.8,), (1.2,)], [(4.0,), (2.0,)], np.linspace(0, 4, 30)
)  # fmt: skip
growth = partial(simulated, lambda _, x, k: k * x, [(0.3,), (0.5,), (0.4,)], [(1.0,), (2.0,)], np.linspace(0, 6, 40))
spring = partial(
    simulated, lambda _, z, k, c: [z[1], -k * z[0] - c * z[1]], [(2.0, 0.2), (3.0, 0.3)], [(1.0, 0.0), (0.0, 2.0)],
    np.linspace(0, 8, 80), measured=[0],
)  # fmt: skip
pendulum = partial(
    simulated, lambda _, z, k, c: [z[1], -k * np.sin(z[0]) - c * z[1]], [(2.0, 0.1), (3.0, 0.2)],
    [(1.2, 0.0), (2.2, 0.3)], np.linspace(0, 8, 80), measured=[0],
)  # fmt: skip
duffing = partial(
    simulated, lambda _, z, k, b, c: [z[1], -k * z[0] - b * z[0] ** 3 - c * z[1]], [(1.0, 0.5, 0.2), (2.0, 0.3, 0.1)],
    [(1.5, 0.0), (0.0, 2.0)], np.linspace(0, 8, 80), measured=[0],
)  # fmt: skip
falling = partial(
    simulated, lambda _, z, d: [z[1], -9.81 - d * z[1]], [(0.2,), (0.4,), (0.6,)], [(40.0, 0.0), (35.0, 6.0)],
    np.linspace(0, 2.4, 37), measured=[0],
)  # fmt: skip
quadratic_drag = partial(
    simulated, lambda _, z, d: [z[1], -9.81 - d * z[1] * abs(z[1])], [(0.02,), (0.05,)], [(40.0, 0.0), (35.0, 6.0)],
    np.linspace(0, 2.4, 49), measured=[0],
)  # fmt: skip
predators = partial(
    simulated, lambda _, z, a, b: [z[0] * (a - z[1]), z[1] * (b * z[0] - 1)], [(1.0, 0.8), (1.4, 1.1)],
    [(0.8, 1.2), (2.0, 0.6)], np.linspace(0, 8, 80), names=("x", "y"),
)  # fmt: skip
lorenz = partial(
    simulated, lambda _, z, s: [s * (z[1] - z[0]), z[0] * (28 - z[2]) - z[1], z[0] * z[1] - 8 / 3 * z[2]], [(10.0,)],
    [(-8.0, 7.0, 27.0)], np.linspace(0, 4, 400), names=("x", "y", "z"),
)  # fmt: skip
van_der_pol = partial(
    simulated, lambda _, z, m: [z[1], m * (1 - z[0] ** 2) * z[1] - z[0]], [(1.0,), (2.0,)], [(0.5, 0.0)],
    np.linspace(0, 12, 120), names=("x", "y"),
)  # fmt: skip
long_van_der_pol = partial(
    simulated, lambda _, z, m: [z[1], m * (1 - z[0] ** 2) * z[1] - z[0]], [(1.0,), (2.0,)], [(0.5, 0.0)],
    np.linspace(0, 100, 2500), names=("x", "y"),
)  # fmt: skip
cart = partial(
    simulated, lambda _, z, k, r: [z[1], -k * z[0] + z[2], -r * z[2]], [(2.0, 0.4), (3.0, 0.6)],
    [(1.0, 0.0, 2.0), (0.0, 1.0, 4.0)], np.linspace(0, 6, 60), names=("x", "h"), measured=[0, 2],
)  # fmt: skip
reaction = partial(
    simulated, lambda _, z, k, m: [-k * z[0], k * z[0] - m * z[1]], [(0.8, 0.3), (1.2, 0.5)], [(2.0, 0.0), (1.0, 1.0)],
    np.linspace(0, 6, 40), names=("a", "b"),
)  # fmt: skip
absorbed = partial(
    simulated, lambda _, z, a, k: [-a * z[0], a * z[0] - k * z[1]], [(1.5, 0.3), (1.2, 0.4), (1.8, 0.25), (1.4, 0.35)],
    [(5.0, 0.0)], np.linspace(0, 12, 25), measured=[1], names=("c",),
)  # fmt: skip
heated = partial(
    simulated, lambda t, x, k, g: -k * x + g * _step(t), [(0.5, 2.0), (0.8, 3.0)], [(1.0,), (0.2,)],
    np.linspace(0, 6, 61), columns={"u": _step}, inputs=["u"],
)  # fmt: skip
swung = partial(
    simulated, lambda t, x, k, g: -k * x + g * _sine(t), [(0.5, 2.0), (0.8, 3.0)], [(1.0,), (0.2,)],
    np.linspace(0, 6, 31), columns={"u": lambda t: _sine(t).round(6)}, inputs=["u"],
)  # fmt: skip
driven = partial(
    simulated, lambda t, z, k, w: [z[1], -k * z[0] - 0.3 * z[1] + np.sin(w * t)], [(4.0, 1.3), (5.0, 1.3)],
    [(0.5, 0.0), (0.0, 1.0)], np.linspace(0, 20, 160), measured=[0],
)  # fmt: skip
enzymes = partial(
    simulated, lambda _, x, v, k: -v * x / (k + x), [(1.0, 0.7), (2.0, 1.5)], [(5.0,), (2.5,)], np.linspace(0, 6, 40)
)  # fmt: skip
cooperative = partial(
    simulated, lambda _, x, v, k: -v * x**2 / (k**2 + x**2), [(1.0, 0.7), (2.0, 1.5)], [(5.0,), (2.5,)],
    np.linspace(0, 6, 40),
)  # fmt: skip
gompertz = partial(
    simulated, lambda _, x, r, k: -r * x * np.log(x / k), [(0.8, 5.0), (0.6, 4.0)], [(0.3,), (1.0,)],
    np.linspace(0, 6, 40),
)  # fmt: skip
arrhenius = partial(
    simulated, lambda _, x, a, b: -a * np.exp(x / b), [(0.5, 1.5), (0.8, 2.0)], [(4.0,), (3.0,)], np.linspace(0, 4, 40)
)  # fmt: skip
torricelli = partial(
    simulated, lambda _, x, a, p: -a * np.abs(x) ** p, [(0.5, 0.6), (0.8, 0.6)], [(4.0,), (3.0,)], np.linspace(0, 2, 40)
)  # fmt: skip


def discrete() -> cl.Trials:
    """Return populations that follow x[n + 1] = r x[n] (1 - x[n])."""
    random, states = np.random.default_rng(0), list[np.ndarray]()
    for rate in (3.3, 3.6):
        x = [0.3]
        while len(x) < 60:
            x.append(rate * x[-1] * (1 - x[-1]))
        states.append(np.round(x + 1e-4 * random.standard_normal(60), 6)[:, np.newaxis])
    return cl.Trials.from_arrays([np.arange(60.0)] * 2, states, object=["o0", "o1"], names=["x"])


def dosed() -> cl.Trials:
    """Return concentrations that decay at rate 0.4 after doses of 2 and 3 at times 0 and 4."""
    random, parts = np.random.default_rng(2), list[pd.DataFrame]()
    times = np.linspace(0, 8, 33)
    for name in ("o0", "o1"):
        path = 2 * np.exp(-0.4 * times) + np.where(times >= 4, 3 * np.exp(-0.4 * (times - 4)), 0.0)
        doses = np.where(times == 4, 3.0, 0.0)
        path[times == 4] -= 3.0
        noisy = np.round(path + 0.02 * random.standard_normal(33), 6)
        parts.append(pd.DataFrame({"object": name, "t": times, "x": noisy, "u": doses}))
    return cl.Trials.from_frame(pd.concat(parts), object="object", time="t", states=["x"], inputs=["u"])


def noise_alone() -> cl.Trials:
    """Return noise about a constant."""
    random = np.random.default_rng(3)
    states = [np.round(1 + 0.1 * random.standard_normal((60, 1)), 6) for _ in range(3)]
    return cl.Trials.from_arrays([np.linspace(0, 6, 60)] * 3, states, object=["o0", "o1", "o2"], names=["x"])


def vials() -> cl.Trials:
    """Return trials of six samples each."""
    return simulated(
        lambda _, x, k: -k * x**2, [(0.5,)] * 8, [(3.0,)], np.linspace(0, 5, 6), white(0.03)
    )  # fmt: skip


discover = partial(cl.discover, cache=False)
regression = partial(discover, order=1, library="poly:3")
RATES = "x' = -V x/(K + x)"

PROBLEMS: dict[str, Callable[[], cl.Law]] = {
    # Orders, and the library of all defaults
    "relaxation, defaults": lambda: discover(relaxation(white(0.01))),
    "logistic growth, defaults": lambda: discover(logistic(white(0.005))),
    "spring, defaults": lambda: discover(spring(white(0.01))),
    "falling balls, defaults": lambda: discover(falling(white(0.002))),
    "predators, defaults": lambda: discover(predators(white(0.01))),
    "relaxation, any order": lambda: discover(relaxation(white(0.02)), library="poly:2"),
    "pendulum, any order": lambda: discover(pendulum(white(0.01)), library="poly:1 + terms:sin(x)"),
    "cart, mixed orders": lambda: discover(cart(white(0.01)), order={"x": 2, "h": 1}, library="poly:1"),
    # Plain terms
    "decay, exact": lambda: discover(decay(white(0)), order=1, library="poly:3"),
    "decay, 10 %": lambda: discover(decay(white(0.1)), order=1, library="poly:3"),
    "van der Pol": lambda: discover(van_der_pol(white(0.01)), order=1, library="poly:3"),
    "lorenz": lambda: discover(lorenz(white(0.01)), order=1, library="poly:2"),
    "duffing": lambda: discover(duffing(white(0.01)), order=2, library="poly:3"),
    "quadratic drag": lambda: discover(quadratic_drag(white(0.001)), order=2, library="poly:2 + terms:v*abs(v)"),
    "predators, many terms": lambda: discover(predators(white(0.01)), order=1, library="poly:4 + fourier:2"),
    "van der Pol, many samples": lambda: discover(long_van_der_pol(white(0.01), seed=1), order=1, library="poly:3"),
    "lorenz, screened terms": lambda: discover(lorenz(white(0.01)), order=1, library="poly:5 + fourier:3"),
    "noise alone": lambda: discover(noise_alone(), order=1, library="poly:3"),
    "linear terms of a Duffing oscillator": lambda: discover(duffing(white(0.005)), order=2, library="poly:1"),
    "vials": lambda: discover(vials(), order=1, library="poly:3"),
    "with a blank": lambda: discover(logistic(white(0.005), change=_with_blank), order=1, library="poly:3"),
    # Nonlinear parameters
    "enzymes": lambda: discover(enzymes(white(0.01)), order=1, library="poly:2 + saturating"),
    "enzymes, ratios": lambda: discover(enzymes(white(0.01)), order=1, library="poly:1 + ratio(poly:1, poly:1)"),
    "cooperative, ratios": lambda: discover(cooperative(white(0.01)), order=1, library="ratio(poly:2, poly:2)"),
    "gompertz, auto": lambda: discover(gompertz(white(0.005)), order=1),
    "exponential, auto": lambda: discover(arrhenius(white(0.005)), order=1),
    "power, auto": lambda: discover(torricelli(white(0.002)), order=1),
    # Inputs and forcing
    "heated, held": lambda: discover(heated(white(0.01)), order=1, library="poly:2"),
    "swung, interpolation chosen": lambda: discover(swung(white(0.005)), order=1, library="poly:1"),
    "swung, cubic": lambda: discover(
        swung(white(0.005)), order=1, library="poly:1", method=cl.TrajectoryLikelihood(input_interpolation="cubic")
    ),
    "driven, unmeasured": lambda: discover(driven(white(0.01)), order=2, library="poly:1", latent_states=1),
    # Latent states
    "absorbed": lambda: discover(absorbed(white(0.01)), order=1, library="poly:2", latent_states=1),
    "decay, without a latent state": lambda: discover(decay(white(0.02)), order=1, library="poly:1", latent_states=1),
    # Error models
    "growth, proportional": lambda: discover(growth(proportional(0.05)), order=1, library="poly:2"),
    "relaxation, correlated": lambda: discover(fine_relaxation(correlated(0.05)), order=1, library="poly:2"),
    **{
        f"spring, {kind}": partial(
            lambda kind: discover(
                spring(white(0.02)), order=2, library="poly:1", method=cl.TrajectoryLikelihood(errors=kind)
            ),
            kind,
        )
        for kind in ("white", "proportional", "autocorrelated", "sensor-walk", "drift", "random-walk", "gp-forcing")
    },
    "outliers": lambda: discover(relaxation(outliers(0.01)), order=1, library="poly:2"),
    "no outliers": lambda: discover(
        relaxation(white(0.01)), order=1, library="poly:2", method=cl.TrajectoryLikelihood(huber_threshold=np.inf)
    ),
    "noise given": lambda: discover(
        relaxation(white(0.02)), order=1, library="poly:2", method=cl.TrajectoryLikelihood(noise={"x": 0.04})
    ),
    "noise columns": lambda: discover(
        relaxation(white(0.01), change=_with_std, noise_columns={"x": "std"}), order=1, library="poly:2"
    ),
    "missing values": lambda: discover(predators(white(0.01), change=_every_third_missing), order=1, library="poly:2"),
    "logarithmic scale": lambda: discover(
        logistic(proportional(0.05)), order=1, library="poly:2", method=cl.TrajectoryLikelihood(log_states=["x"])
    ),
    # What is known, and what objects share
    "known gravity": lambda: discover(falling(white(0.002)), order=2, library="poly:1", known={"1": -9.81}),
    "universal gravity": lambda: discover(falling(white(0.002)), order=2, library="poly:1", shared=["1"]),
    "bootstrap": lambda: discover(
        decay(white(0.02)), order=1, library="poly:2", method=cl.TrajectoryLikelihood(covariance="bootstrap")
    ),
    # Other methods
    "derivatives": lambda: regression(van_der_pol(white(0.001)), method=cl.DerivativeRegression()),
    "derivatives, thresholds": lambda: regression(
        van_der_pol(white(0.001)), method=cl.DerivativeRegression(solver="stlsq:threshold=0.05")
    ),
    "weak form": lambda: regression(van_der_pol(white(0.01)), method=cl.WeakRegression()),
    "discrete time": lambda: discover(discrete(), order=0, library="poly:3"),
    # Given equations
    "fit, decay": lambda: cl.fit("x' = -k x", decay(white(0.02))),
    "fit, partially pooled": lambda: cl.fit("x' = -k x", decay(white(0.02)), partial_pooling=True),
    "fit, shared": lambda: cl.fit("x' = a - b x", relaxation(white(0.02)), shared="b"),
    "fit, Michaelis-Menten": lambda: cl.fit(RATES, enzymes(white(0.01))),
    "fit, guesses": lambda: cl.fit("x'' = -k sin(x) - c v", pendulum(white(0.01)), guesses={"k": 2.5}),
    "fit, latent": lambda: cl.fit(["c' = a g - k c", "g' = -a g"], absorbed(white(0.01)), initial_values={"g": 5.0}),
    "fit, doses": lambda: cl.fit("x' = -k x + u", dosed(), doses="u"),
    "fit, free start": lambda: cl.fit(
        ["c' = a g - k c", "g' = -a g"], absorbed(white(0.01)), initial_values={"g": None}
    ),
    "fit, reaction": lambda: cl.fit(["a' = -k a", "b' = k a - m b"], reaction(white(0.01))),
    "fit, own noise": lambda: cl.fit("x' = -k x^2", vials()),
    "fit, proportional": lambda: cl.fit("x' = k x", growth(proportional(0.05))),
    "fit, force": lambda: cl.fit("x'' = -k x - c v", duffing(white(0.01)), errors="gp-forcing"),
    "measured drops, linear drag": lambda: discover(cl.datasets.ball_drops(), order=2, library="poly:1"),
    "measured drops, derivatives": lambda: discover(
        cl.datasets.ball_drops(), order=2, library="poly:2", method=cl.DerivativeRegression()
    ),
    "refine": lambda: cl.refine(cl.fit("x' = r x", logistic(white(0.005))), logistic(white(0.005))),
}
