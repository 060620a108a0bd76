"""Models of textbooks, fitted by their names to solutions that SciPy computes."""

import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import commonlaw as cl

pytestmark = pytest.mark.usefixtures("few_starts")

SIMULATED = {
    "exponential-growth": ([1.0], {"r": 0.5}, 4),
    "logistic": ([0.1], {"r": 0.8, "K": 2.0}, 12),
    "gompertz": ([0.1], {"r": 0.6, "K": 2.0}, 10),
    "richards": ([0.1], {"r": 0.8, "K": 2.0, "p": 2.0}, 12),
    "von-bertalanffy": ([1.0], {"k": 0.4, "M": 8.0}, 9),
    "chemostat": ([0.1, 2.0], {"m": 1.0, "K": 0.5, "Y": 0.5, "f": 3.0}, 20),
    "monod": ([0.1, 2.0], {"m": 1.0, "K": 0.5, "Y": 0.5}, 6),
    "exponential-decay": ([2.0], {"k": 0.5}, 6),
    "second-order-kinetics": ([2.0], {"k": 0.5}, 6),
    "zero-order-kinetics": ([2.0], {"k": 0.2}, 6),
    "reversible-reaction": ([2.0, 0.1], {"f": 0.7, "b": 0.3}, 6),
    "consecutive-reactions": ([2.0, 0.0], {"k1": 0.7, "k2": 0.3}, 8),
    "michaelis-menten": ([3.0], {"V": 1.0, "K": 0.7}, 6),
    "brusselator": ([1.0, 1.0], {"a": 1.0, "b": 2.5}, 15),
    "newton-cooling": ([80.0], {"k": 0.3, "a": 20.0}, 10),
    "rc-circuit": ([5.0], {"E": 1.0, "T": 2.0}, 8),
    "torricelli": ([1.0], {"k": 0.3}, 5),
    "tank-with-inflow": ([4.0], {"b": 0.5, "k": 0.1}, 8),
    "first-order-lag": ([0.0], {"G": 2.0, "T": 1.5}, 12),
    "first-order-lag-with-dead-time": ([0.0], {"G": 2.0, "T": 1.5, "d": 0.8}, 12),
    "second-order-system": ([0.0, 0.0], {"k": 4.0, "c": 0.8, "b": 3.0}, 12),
    "harmonic-oscillator": ([1.0, 0.0], {"k": 4.0}, 8),
    "damped-oscillator-with-offset": ([1.0, 0.0], {"k": 4.0, "a": 0.5, "c": 0.4}, 8),
    "damped-oscillator": ([1.0, 0.0], {"k": 4.0, "c": 0.4}, 8),
    "driven-oscillator": ([1.0, 0.0], {"k": 4.0, "c": 0.4, "A": 1.5, "w": 1.3, "p": 0.5}, 15),
    "pendulum": ([1.5, 0.0], {"a": 4.0, "c": 0.2}, 8),
    "free-fall": ([20.0, 0.0], {"g": 9.8}, 2),
    "free-fall-with-linear-drag": ([20.0, 0.0], {"g": 9.8, "c": 0.5}, 3),
    "free-fall-with-quadratic-drag": ([20.0, 0.0], {"g": 9.8, "c": 0.2}, 3),
    "free-fall-with-linear-and-quadratic-drag": ([0.0, 60.0], {"g": 9.8, "c": 1.0, "d": 0.1}, 8),
    "falling-speed": ([1.0], {"g": 9.8, "c": 0.2}, 2),
    "falling-speed-with-linear-drag": ([1.0], {"g": 9.8, "c": 0.5}, 4),
    "van-der-pol": ([1.0, 0.0], {"m": 1.0, "k": 1.0}, 15),
    "duffing": ([1.0, 0.0], {"a": 1.0, "b": 2.0, "c": 0.1}, 10),
    "lorenz": ([1.0, 2.0, 20.0], {"s": 10.0, "r": 28.0, "b": 2.6}, 3),
    "lotka-volterra": ([1.0, 0.5], {"a": 1.0, "b": 1.2, "c": 0.8, "d": 0.6}, 15),
    "lotka-volterra-with-crowding": ([1.0, 0.5], {"r": 1.0, "K": 3.0, "b": 1.2, "c": 0.8, "d": 0.6}, 15),
    "competition": ([0.2, 0.4], {"r": 1.0, "K": 2.0, "a": 0.6, "s": 0.7, "M": 1.5, "b": 0.4}, 15),
    "rosenzweig-macarthur": ([0.5, 0.3], {"r": 1.0, "K": 2.0, "a": 1.5, "h": 0.8, "c": 1.0, "d": 0.4}, 25),
    "sir": ([0.99, 0.01], {"b": 1.0, "g": 0.3}, 25),
    "seir": ([0.98, 0.01, 0.01], {"b": 1.0, "s": 0.8, "g": 0.3}, 30),
    "one-compartment": ([4.0], {"k": 0.3, "V": 2.0}, 8),
    "one-compartment-with-absorption": ([8.0, 0.0], {"a": 1.2, "V": 2.0, "k": 0.3}, 10),
    "two-compartments": ([4.0, 0.0], {"k": 0.5, "f": 0.4, "b": 0.3, "V": 2.0}, 15),
    "biexponential-elimination": ([4.0, -3.0], {"a": 0.3, "b": 1.5}, 10),
    "fitzhugh-nagumo": ([-1.0, 1.0], {"a": 0.08, "b": 0.056, "c": 0.064}, 60),
}
"""Initial states, parameters and the time of a trial; the dose is 8."""


def stimulus(name, t):
    return 0.5 if name == "i" else 0.3 if name == "D" else float(np.sin(t) + np.sin(2.3 * t))


def simulated(model, initial, parameters, end, count=40):
    """Return trials of a model, integrated by SciPy from its equations as Python."""
    texts = [without_bound.split("=")[1] for without_bound in model.without_bounds if "'" in without_bound]
    texts = [re.sub(r"(\w)'", r"\1_rate", text).replace("^", "**") for text in texts]
    texts = [re.sub(r"(?<=[\w)]) +(?=[\w(])", "*", text) for text in texts]
    texts = [re.sub(r"u\(t - d\)", "delayed", text) for text in texts]
    is_second = "''" in model.equations

    def rates(t, y):
        known = {**parameters, **dict(zip(model.states, y, strict=False)), "t": t}
        known |= {name: stimulus(name, t) for name in model.inputs}
        known |= {"delayed": stimulus("u", t - parameters.get("d", 0.0))}
        known |= {f"{name}_rate": value for name, value in zip(model.states, y[len(model.states) :], strict=False)}
        functions = {"sin": np.sin, "cos": np.cos, "log": np.log, "sqrt": np.sqrt, "abs": abs}
        found = [eval(text, functions, known) for text in texts]
        return [*y[len(model.states) :], *found] if is_second else found

    times = np.linspace(0, end, count)
    states = solve_ivp(rates, (0, end), initial, "LSODA", times, rtol=1e-9, atol=1e-9, max_step=end / count).y.T
    states = states[:, : len(model.states)]
    noisy = states + 1e-3 * np.ptp(states, axis=0) * np.random.default_rng(0).standard_normal(states.shape)
    held = [[stimulus(name, t) for name in model.inputs] for t in times] if model.inputs else None
    names = [*model.states, *model.inputs]
    return cl.Trials.from_arrays(times, noisy, inputs=held, names=names, properties={"object": {"dose": 8.0}})


_LONG = (
    "brusselator", "chemostat", "driven-oscillator", "first-order-lag-with-dead-time", "fitzhugh-nagumo", "lorenz",
    "monod", "reversible-reaction", "richards", "rosenzweig-macarthur", "seir", "sir", "two-compartments",
    "van-der-pol",
)  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in _LONG else name for name in SIMULATED]
)
def test_a_model_is_fitted_by_its_name(name):
    initial, parameters, end = SIMULATED[name]
    trials = simulated(cl.named_models[name], initial, parameters, end)
    law = cl.fit(name, trials, errors="white")
    estimates = law.params.set_index("parameter")["estimate"]
    for symbol, value in parameters.items():
        assert estimates[symbol] == pytest.approx(value, rel=0.05), symbol
