"""Experiments for laws with observation equations, against Fisher information by differences of closed forms."""

from typing import Any

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.experiments.design import suggestions
from commonlaw.law import from_json, to_json
from tests.refusals import refused

pytestmark = pytest.mark.usefixtures("few_starts")

NOISE = 0.05
TIMES = np.linspace(0.0, 8.0, 25)


def slopes(curve, p):
    """Return central differences of a curve by parameters, shape (n, parameters)."""
    steps = 1e-5 * np.maximum(np.abs(p), 0.1) * np.eye(len(p))
    return np.array([(curve(p + h) - curve(p - h)) / (2 * h.sum()) for h in steps]).T


def trials_of(curves, **schema):
    made = [cl.Trial(owner, name, times, np.asarray(y)) for owner, name, times, y in curves]
    return cl.Trials(tuple(made), cl.Schema(("signal",), **schema))


def growth(p, times):
    """Return the signal of logistic growth for ``r, s, b, x(0)``."""
    r, s, b, first = p
    return 2 * s / (1 + (2 / first - 1) * np.exp(-r * times)) + b


TRUE = {"A": np.array([0.8, 3.0, 0.5]), "B": np.array([1.1, 3.0, 0.5])}
GROWTH = "x' = r x (1 - x/2); signal = s x + b"
SHARED = {"shared": ["s", "b"], "priors": {"b": (0.5, 0.2)}, "noise": {"signal": NOISE}}
FIRST = [("A", "1", TIMES, growth([*TRUE["A"], 0.3], TIMES)), ("B", "1", TIMES, growth([*TRUE["B"], 0.5], TIMES))]


@pytest.fixture(scope="module")
def grown():
    """Return a law whose estimates are the true parameters, as it was fitted to what has no noise."""
    return cl.fit(GROWTH, trials_of(FIRST), **SHARED)


@pytest.fixture(scope="module")
def found(grown):
    return cl.design(grown, {"x": "0.1..4", "duration": "2..8", "samples": 20, "object": "A"}, about="coefficients")


def gains(found):
    return {gain.name: (gain.now, gain.then) for gain in found.gains}


def test_standard_errors_are_those_of_the_fisher_information(found):
    """Parameters: r of A, r of B, s, b, and the initial value of each of three trials, of which b has a prior."""
    (planned,) = found.experiments
    times, start = planned.experiment.times, planned.experiment.start[0]
    p = np.array([0.8, 1.1, 3.0, 0.5, 0.3, 0.5, start])

    def curves(p):
        owners = ((0, 4, TIMES), (1, 5, TIMES), (0, 6, times))
        return [growth([p[r], p[2], p[3], p[first]], t) for r, first, t in owners]

    def information(trials):
        rows = slopes(lambda p: np.concatenate(curves(p)[:trials]), p) / NOISE
        result = rows.T @ rows
        result[3, 3] += 1 / 0.2**2
        return result[: 4 + trials, : 4 + trials]

    now, then = (np.sqrt(np.diag(np.linalg.inv(information(trials)))) for trials in (2, 3))
    for place, name in ((0, "r"), (2, "s"), (3, "b")):
        assert gains(found)[name] == pytest.approx((now[place], then[place]), rel=2e-3)
    own = np.ix_([0, 2, 3], [0, 2, 3])
    logs = [np.linalg.slogdet(np.linalg.inv(information(trials))[own])[1] for trials in (2, 3)]
    assert planned.bits == pytest.approx((logs[0] - logs[1]) / 2 / np.log(2), rel=2e-3)


def test_a_fit_has_the_standard_errors_that_were_expected(found):
    times, start = found.experiments[0].experiment.times, found.experiments[0].experiment.start[0]
    noise = NOISE * np.random.default_rng(0).standard_normal(len(times))
    new = ("A", "2", times, growth([*TRUE["A"], start], times) + noise)
    fitted = cl.law.select_objects(cl.fit(GROWTH, trials_of([*FIRST, new]), **SHARED), ["A"]).params
    errors = dict(zip(fitted["parameter"], fitted["standard error"], strict=True))
    assert errors == pytest.approx({name: then for name, (_, then) in gains(found).items()}, rel=0.05)


def heated(p, times):
    """Return the signal under a ramp that comes later by tau, from x = 0, for ``k, tau, s``."""
    k, tau, s = p
    since = np.maximum(times - tau, 0.0)
    return s * (since / k - (1 - np.exp(-k * since)) / k**2)


def swinging(p, times):
    k, d, s, x = p
    w = np.sqrt(k - d**2 / 4)
    return s * (x * np.exp(-d * times / 2) * (np.cos(w * times) + d / 2 / w * np.sin(w * times))) ** 2


CASES: dict[str, tuple[Any, ...]] = {
    "log-scaled, initial value by the law": (
        ("x' = -k x; signal = x + b; x(0) = a", {"log_states": ["signal"]}),
        (lambda p, t: np.log(p[1] * np.exp(-p[0] * t) + p[2]), {"k": 0.6, "a": 4.0, "b": 0.5}),
        ({}, {}),
        {},
    ),
    "second order, initial values set and known": (
        ("x'' = -k x - d x'; signal = s x^2; x(0) = 1; x'(0) = 0", {}),
        (lambda p, t: swinging([*p, 1.0], t), {"k": 2.0, "d": 0.1, "s": 1.5}),
        ({"x": 1.5, "v": 0}, {"start_std": {"x": 0.01, "v": 0}}),
        {"x(0)": (1.5, 0.01), "curve": swinging},
    ),
    "delayed input": (
        ("x' = u(t - tau) - k x; signal = s x; x(0) = 0", {}),
        (heated, {"k": 0.7, "tau": 1.1, "s": 0.8}),
        ({"u": 8, "u.shape": "ramp"}, {}),
        {},
    ),
    "parameter by trial": (
        ("x' = -k x; signal = x + b", {"shared": {"b": "trial"}}),
        (lambda p, t: p[2] * np.exp(-p[0] * t) + p[1], {"k": 0.6, "b": 0.5, "x(0)": 4.0}),
        ({"x": 4}, {}),
        {"b of 2": (0.5, np.inf), "x(0) of 2": (4.0, np.inf), "curve": lambda p, t: p[4] * np.exp(-p[0] * t) + p[3]},
    ),
    "parameter by trial with a prior": (
        ("x' = -k x; signal = x + b", {"shared": {"b": "trial"}, "priors": {"b": (0.5, 0.02)}}),
        (lambda p, t: p[2] * np.exp(-p[0] * t) + p[1], {"k": 0.6, "b": 0.5, "x(0)": 4.0}),
        ({"x": 4}, {}),
        {"b of 2": (0.5, 0.02), "x(0) of 2": (4.0, np.inf), "curve": lambda p, t: p[4] * np.exp(-p[0] * t) + p[3]},
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_information_of_an_experiment_is_that_of_all_it_determines(case):
    (text, settings), (curve, true), (vary, how), more = CASES[case]
    more = dict(more)
    later, first = more.pop("curve", curve), np.array([*true.values()])
    p = np.append(first, [value for value, _ in more.values()])
    priors = np.array([0.0] * len(first) + [std**-2 for _, std in more.values()])
    if "priors" in settings:
        priors[1] = 0.02**-2
    y = curve(first, TIMES)
    y = np.exp(y) if "log_states" in settings else y
    trial = cl.Trial("A", "1", TIMES, y, TIMES[:, np.newaxis] if "u" in vary else np.empty((len(TIMES), 0)))
    trials = cl.Trials((trial,), cl.Schema(("signal",), ("u",) if "u" in vary else ()))
    law = cl.fit(text, trials, noise={"signal": NOISE}, **settings)
    times = np.linspace(0.0, 8.0, 33)
    found = cl.design(law, {**vary, "times": [times]}, about="coefficients", **how)

    count, old = len(first), slopes(lambda q: curve(q, TIMES), first) / NOISE
    new = slopes(lambda q: later(q, times), p) / NOISE
    information = np.diag(priors) + new.T @ new
    information[:count, :count] += old.T @ old
    now = np.sqrt(np.diag(np.linalg.inv(np.diag(priors[:count]) + old.T @ old)))
    then = np.sqrt(np.diag(np.linalg.inv(information)))
    for place, name in enumerate(true):
        if name in gains(found):
            assert gains(found)[name] == pytest.approx((now[place], then[place]), rel=5e-3)


def test_rival_laws_are_told_apart_by_what_they_would_measure():
    """Growth to a limit and without one agree while x is small, and part at a large x."""
    laws = [
        cl.fit(f"x' = {rate}; signal = s x", trials_of(FIRST[:1]), noise={"signal": NOISE}, initial_values={"x": 0.3})
        for rate in ("r x (1 - x/2)", "r x (1 - (x/2)^2)")
    ]
    times = np.linspace(0, 6, 13)
    found = cl.design(laws, {"x": 2.8, "times": [times]}, start_std={"x": 0})
    (planned,) = found.experiments
    assert planned.forecasts.states == ("signal",)
    start = planned.experiment.start[0]
    r, s = laws[0].params["estimate"]
    assert planned.forecasts.means[0, :, 0] == pytest.approx(growth([r, s, 0, start], times), rel=1e-4)
    assert found.chance > 0.95
    plain = cl.fit("signal' = r signal", trials_of(FIRST[:1]))
    with refused("design-different-laws"):
        cl.design([laws[0], plain], {"x": 1, "times": [times]})


def test_a_forecast_of_a_measured_quantity_is_asked_for(grown):
    vary = {"x": "0.1..4", "times": [TIMES], "object": "B"}
    found = cl.design(grown, vary, about="signal at t=3 from 0.2 of B", start_std={"x": 0})
    p = np.array([1.1, 3.0, 0.5])
    assert found.aim.quantity.values[0] == pytest.approx(growth([*p, 0.2], np.array([0.0, 3.0]))[-1], rel=1e-6)
    by = slopes(lambda q: growth([*q, 0.2], np.array([0.0, 3.0]))[-1:], p)[0]
    covariance = grown.uncertainty.covariance[1]
    assert found.aim.quantity.std(np.ones(1)) == pytest.approx(np.sqrt(by @ covariance @ by), rel=1e-5)
    start = found.experiments[0].experiment.start[0]
    rows = slopes(lambda q: growth([*q, start], TIMES), p) / NOISE
    then = np.linalg.inv(np.linalg.inv(covariance) + rows.T @ rows)
    assert found.experiments[0].std == pytest.approx(np.sqrt(by @ then @ by), rel=1e-3)
    with refused("unknown-name", kind="measured quantity"):
        cl.design(grown, vary, about="x at t=3 from 0.2")


def test_settings_are_those_of_trials_and_of_the_law(grown):
    trials = trials_of(FIRST)
    found = cl.design(grown, {"object": "A"}, trials=trials, about="r of A")
    experiment = found.experiments[0].experiment
    assert experiment.times == pytest.approx(TIMES)
    assert 0.29 < experiment.start[0] < 0.51
    again = cl.design(from_json(to_json(grown)), {"object": "A"}, trials=trials, about="r of A")
    assert again.experiments[0].std == pytest.approx(found.experiments[0].std)
    with refused("setting-missing"):
        cl.design(grown, {"duration": 3, "rate": 5})
    with refused("unknown-name", kind="setting of an experiment"):
        cl.design(grown, {"signal": 1, "x": 1, "duration": 3, "rate": 5})
    assert {each.aim.of_law for each in suggestions(grown, trials).values()} == {False}
