"""Noise by a property of the objects, held against the likelihood by SciPy."""

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize
from scipy.stats import norm

import commonlaw as cl
from commonlaw.estimation import likelihood_profile
from tests.unit.decays import T, estimates, trials_of


def test_objects_of_one_property_share_their_noise(tmp_path):
    t, random = np.linspace(0, 6, 25), np.random.default_rng(11)
    labs = {"A": ("fine", 0.01), "B": ("coarse", 0.1), "C": ("coarse", 0.1)}
    samples = {name: (t, 2 * np.exp(-0.6 * t) + s * random.standard_normal(len(t))) for name, (_, s) in labs.items()}
    trials = trials_of(samples).with_properties({name: {"lab": lab} for name, (lab, _) in labs.items()})
    law = cl.fit("y' = -k y; y(0) = a", trials, shared=["k", "a"], noise={"y": "lab"})

    def negative(p):
        k, a, *logs = p
        total = 0.0
        for name, (lab, _) in labs.items():
            z = (samples[name][1] - a * np.exp(-k * t)) / np.exp(logs[lab == "coarse"])
            total += 0.5 * z @ z + len(t) * logs[lab == "coarse"]
        return total

    best = minimize(negative, [0.5, 1.8, -4, -2], method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-12})
    best = minimize(negative, best.x, method="BFGS", options={"gtol": 1e-7})
    assert estimates(law, "A")["k"][0] == pytest.approx(best.x[0], rel=1e-5)
    noise = law.observation.noise_of["y"]
    assert noise["B"] == noise["C"]
    assert [noise["A"], noise["B"]] == pytest.approx(np.exp(best.x[2:]), rel=0.03)  # Unbiased
    law.save(tmp_path / "law.json")
    again = cl.Law.load(tmp_path / "law.json")
    assert again.observation.noise_of == law.observation.noise_of
    forecast = again.predict(trials, return_std=True)
    assert [np.median(trial.noise) for trial in forecast.trials] == pytest.approx([noise[name] for name in labs])


def decays_of_labs(seed):
    """Return log-normal decays of two laboratories with noise of 5 % and 20 %."""
    random, made, labs = np.random.default_rng(seed), [], {"A": ("fine", 0.05), "B": ("coarse", 0.2)}
    for name, (_, share) in labs.items():
        for i in range(2):
            y = 8 * np.exp(-0.6 * T + share * random.standard_normal(len(T)))
            made.append(cl.Trial(name, str(i), T, y))
    return cl.Trials(tuple(made), cl.Schema(("y",)), {name: {"lab": lab} for name, (lab, _) in labs.items()})


def test_bands_of_log_scaled_quantities_have_the_relative_noise_of_their_laboratory():
    """At known parameters they are ``y exp(±1.96 s)``; of the fits they hold 95 % of new measurements of each."""
    inside = {"A": [], "B": []}
    for seed in range(10):
        trials, new = decays_of_labs(seed), decays_of_labs(seed + 100)
        law = cl.fit("y' = -k y; y(0) = a", trials, shared=["k", "a"], noise={"y": "lab"}, log_states=["y"])
        forecast = law.predict(new, return_std=True)
        for trial, (low, high) in zip(forecast.trials, forecast.bands(measured=True), strict=True):
            inside[trial.object] += ((low < trial.states) & (trial.states < high)).ravel().tolist()
    assert [np.mean(own) for own in inside.values()] == pytest.approx([0.95, 0.95], abs=0.04)
    curves = forecast.smooth(50)
    for trial, curve, (low, high), std in zip(
        curves.trials, curves.trajectories, curves.bands(measured=True), curves.std, strict=True
    ):
        share = np.hypot(law.observation.noise_of["y"][trial.object], std / curve.states)
        assert np.log(high / low) == pytest.approx(2 * norm.ppf(0.975) * share, rel=1e-6)
    standardized = np.concatenate(law.residuals(new).standardized)
    assert np.std(standardized) == pytest.approx(1.0, abs=0.15)


def test_updates_weigh_each_laboratory_by_its_relative_noise():
    """The logarithm of y is a straight line, so that the posterior is that of linear regression."""
    law = cl.fit("y' = -k y; y(0) = a", decays_of_labs(1), noise={"y": "lab"}, log_states=["y"])
    new = decays_of_labs(2)
    updated = law.update(new)
    for name in "AB":
        own, noise = estimates(law, name), law.observation.noise_of["y"][name]
        prior = law.cov_params(name).loc[["k", "a"], ["k", "a"]].to_numpy()
        rows, target = [np.linalg.inv(np.linalg.cholesky(prior))], []
        target.append(rows[0] @ [own["k"][0], own["a"][0]])

        def residuals(p, name=name, rows=rows, target=target, noise=noise):
            measured = np.concatenate([trial.states[:, 0] for trial in new.of_object(name)])
            return np.append((np.log(p[1]) - np.tile(p[0] * T, 2) - np.log(measured)) / noise, rows[0] @ p - target[0])

        best = least_squares(residuals, [0.6, 8.0], x_scale="jac", xtol=1e-14, ftol=1e-14)
        found = estimates(updated, name)
        assert [found["k"][0], found["a"][0]] == pytest.approx(best.x, rel=1e-6)
    low, high = likelihood_profile(law, decays_of_labs(1), "k", "B").interval
    assert high - low == pytest.approx(2 * 1.96 * estimates(law, "B")["k"][1], rel=0.05)
