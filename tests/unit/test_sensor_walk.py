"""A random walk of the sensor: innovations, levels and estimates by dense covariances, and coverage of intervals."""

import numpy as np
import pytest
from scipy import optimize

import commonlaw as cl
from commonlaw.law.parameters import named_parameters
from commonlaw.likelihood import ErrorModel
from commonlaw.likelihood.levels import Innovations
from tests.unit.estimates import relaxation

K = 0.5
"""The known rate of a relaxation ``x' = a - k x``, whose solutions are linear in their start and in a."""


def relaxing(trials, times, noise=0.05, level=0.2, seed=0):
    """Measurements, shape (trials, n), of relaxations to 2 from as many starts, with a walk of each."""
    random, starts = np.random.default_rng(seed), np.linspace(0, 6, trials)
    clean = 2 + (starts[:, np.newaxis] - 2) * np.exp(-K * (times - times[0]))
    steps = np.sqrt(np.diff(times, prepend=times[0])) * random.standard_normal(clean.shape)
    return clean + level * np.cumsum(steps, axis=1) + noise * random.standard_normal(clean.shape)


def covariance(elapsed, noise, level):
    return noise**2 * np.eye(len(elapsed)) + level**2 * np.minimum.outer(elapsed, elapsed)


def regression(measured, elapsed, levels):
    """Minus twice the restricted log-likelihood, and the estimate of a with its standard error, by all starts."""
    return relaxation(measured, elapsed, K, covariance(elapsed, *levels))


def test_innovations_are_those_of_a_cholesky_factor():
    random, elapsed = np.random.default_rng(0), np.array([0.4, 0.7, 2.0, 2.1])  # The first sample has no value
    white, errors = random.uniform(0.05, 0.2, 4), random.standard_normal((4, 3))
    found = Innovations.of(elapsed, white, 0.3, np.inf)
    factor = np.linalg.cholesky(np.diag(white**2) + 0.3**2 * np.minimum.outer(elapsed, elapsed))
    unit = factor / np.diagonal(factor)
    np.testing.assert_allclose(found.std, np.diagonal(factor), rtol=1e-12)
    np.testing.assert_allclose(found.of_errors(errors), np.linalg.solve(unit, errors), atol=1e-12)
    np.testing.assert_allclose(found.transposed(errors[:, 0]), np.linalg.solve(unit.T, errors[:, 0]), atol=1e-12)


@pytest.mark.parametrize("scheme", ["collocation", "shooting"])
def test_levels_and_estimates_are_those_of_generalized_least_squares(scheme):
    times = 3 + np.sort(np.random.default_rng(1).uniform(0, 5, 25))
    measured = relaxing(6, times)
    trials = cl.Trials.from_arrays([times] * 6, [*measured], names=["x"])
    law = cl.fit(f"x' = a - {K} x", trials, errors="sensor-walk", scheme=scheme)
    elapsed = times - times[0]
    best = optimize.minimize(lambda logs: regression(measured, elapsed, np.exp(logs))[0], np.log([0.05, 0.2]))
    levels = np.exp(best.x)
    model, parameters = law.uncertainty.error_model, named_parameters(law)
    assert model.kind == "sensor-walk"
    assert [*law.uncertainty.noise, *model.sensor_walk] == pytest.approx(levels, rel=2e-3)
    _, estimate, error = regression(measured, elapsed, levels)
    assert parameters.values[0, 0] == pytest.approx(estimate, abs=0.005 * error)
    assert parameters.errors[0, 0] == pytest.approx(error, rel=2e-3)


def test_a_law_under_a_walk_of_the_sensor_is_saved_and_forecasts_its_measurements(tmp_path):
    times = np.linspace(0, 5, 25)
    trials = cl.Trials.from_arrays([times] * 6, [*relaxing(6, times)], names=["x"])
    law = cl.fit(f"x' = a - {K} x", trials, errors="sensor-walk")
    law.save(tmp_path / "law.json")
    again = cl.Law.load(tmp_path / "law.json")
    assert again == law
    forecast = again.predict(trials, return_std=True, start=10)
    model, noise = law.uncertainty.error_model, law.uncertainty.noise
    expected = np.sqrt(noise**2 + model.sensor_walk**2 * times[:, np.newaxis])
    assert forecast.measurement_std()[0] == pytest.approx(expected)
    steps = {step.stage: step.choice for step in law.history}
    assert f"{model.sensor_walk[0]:.3g}" in steps["random walk of the sensor"]
    law.report(trials).save(tmp_path / "report.html")
    assert f"of x: {model.sensor_walk[0]:.3g}" in (tmp_path / "report.html").read_text("utf-8")


def test_measurements_have_the_standard_deviation_of_their_time():
    errors = ErrorModel(sensor_walk=np.array([2.0]))
    std = errors.measurement_std(np.zeros((3, 1)), np.array([0.4]), np.array([0.0, 1.0, 4.0]))
    assert std[:, 0] == pytest.approx(np.sqrt([0.16, 4.16, 16.16]))


def test_files_are_fitted_one_by_one_under_a_walk_of_the_sensor(tmp_path):
    """The levels of all are root mean squares of those of each file."""
    times, levels = np.linspace(0, 5, 25), list[np.ndarray]()
    for name in ("a", "b"):
        measured = [*relaxing(4, times, seed=ord(name))]
        trials = cl.Trials.from_arrays([times] * 4, measured, object=[name] * 4, names=["x"])
        trials.to_frame().to_parquet(tmp_path / f"{name}.parquet")
        law = cl.fit(f"x' = a - {K} x", trials, errors="sensor-walk")
        levels.append(law.uncertainty.error_model.levels)
    stream = cl.TrialStream.from_parquet(tmp_path, object="object", trial="trial", time="t", states=["x"])
    law = cl.fit(f"x' = a - {K} x", stream, errors="sensor-walk")
    assert law.uncertainty.error_model.levels == pytest.approx(np.sqrt(np.mean(np.square(levels), axis=0)), rel=1e-3)


def test_a_walk_of_the_sensor_is_chosen_by_evidence():
    """A walk of the states would follow the law from step to step, and autocorrelated errors return to zero."""
    times = np.linspace(0, 10, 60)
    trials = cl.Trials.from_arrays([times] * 4, [*relaxing(4, times, level=0.3)], names=["x"])
    assert cl.fit("x' = a - k x", trials).uncertainty.error_model.kind == "sensor-walk"


@pytest.mark.slow
def test_white_noise_is_no_walk_of_the_sensor():
    times, kinds = np.linspace(0, 5, 25), list[str]()
    for seed in range(40):
        trials = cl.Trials.from_arrays([times] * 4, [*relaxing(4, times, level=0.0, seed=seed)], names=["x"])
        kinds.append(cl.fit("x' = a - k x", trials).uncertainty.error_model.kind)
    assert kinds.count("white") >= 38


@pytest.mark.slow
def test_intervals_hold_the_truth_under_a_walk_of_the_sensor():
    times, hits = np.linspace(0, 5, 25), list[bool]()
    for seed in range(40):
        trials = cl.Trials.from_arrays([times] * 6, [*relaxing(6, times, seed=seed)], names=["x"])
        law = cl.fit("x' = a - k x", trials, errors="sensor-walk")
        params = law.params.set_index("parameter")
        hits += [bool(params.low[name] <= true <= params.high[name]) for name, true in (("a", 2 * K), ("k", K))]
    assert 0.86 <= np.mean(hits) <= 1.0
