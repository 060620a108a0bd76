"""A drift of the sensor: innovations, levels and estimates by dense covariances, and coverage of intervals."""

import numpy as np
import pytest
from scipy import optimize

import commonlaw as cl
from commonlaw.law.parameters import named_parameters
from commonlaw.likelihood import ErrorModel
from commonlaw.likelihood.levels import DriftInnovations
from tests.unit.estimates import relaxation

K = 0.5
"""The known rate of a relaxation ``x' = a - k x``, whose solutions are linear in their start and in a."""


def relaxing(trials, times, noise=0.05, offset=0.2, slope=0.1, seed=0):
    """Measurements, shape (trials, n), of relaxations to 2 from as many starts, with a drift of each."""
    random, starts = np.random.default_rng(seed), np.linspace(0, 6, trials)
    clean = 2 + (starts[:, np.newaxis] - 2) * np.exp(-K * times)
    drift = offset * random.standard_normal((trials, 1)) + slope * random.standard_normal((trials, 1)) * times
    return clean + drift + noise * random.standard_normal(clean.shape)


def covariance(times, noise, offset, slope):
    return noise**2 * np.eye(len(times)) + offset**2 + slope**2 * np.outer(times, times)


def regression(measured, times, levels):
    """Minus twice the restricted log-likelihood, and the estimate of a with its standard error, by all starts.

    Levels are the logarithms of the noise, and of standard deviations of offsets and slopes, and the mean slope.
    """
    *levels, trend = *np.exp(levels[:3]), levels[3]
    measured = measured - trend * times
    return relaxation(measured, times, K, covariance(times, *levels))


def error_by_levels(measured, times, levels, step=0.02):
    """What errors of the levels add to that of the estimate (Kackar and Harville 1984), by central differences."""
    moves = step * np.eye(4)

    def at(move):
        return regression(measured, times, levels + move)

    hessian = [[at(a + b)[0] + at(-a - b)[0] - at(a - b)[0] - at(b - a)[0] for a in moves] for b in moves]
    slopes = np.array([at(move)[1] - at(-move)[1] for move in moves]) / (2 * step)
    return np.sqrt(2 * slopes @ np.linalg.solve(np.array(hessian) / (4 * step**2), slopes))


def test_innovations_are_those_of_a_cholesky_factor():
    random, times = np.random.default_rng(0), np.array([0.0, 0.3, 0.7, 2.0, 2.1])
    white, errors = random.uniform(0.05, 0.2, 5), random.standard_normal((5, 3))
    found = DriftInnovations.of(times, white, 0.3, 0.5)
    factor = np.linalg.cholesky(np.diag(white**2) + 0.3**2 + 0.5**2 * np.outer(times, times))
    unit = factor / np.diagonal(factor)
    np.testing.assert_allclose(found.std, np.diagonal(factor), rtol=1e-12)
    np.testing.assert_allclose(found.of_errors(errors), np.linalg.solve(unit, errors), atol=1e-12)
    np.testing.assert_allclose(found.transposed(errors[:, 0]), np.linalg.solve(unit.T, errors[:, 0]), atol=1e-12)


def test_innovations_keep_their_digits_where_a_drift_is_far_above_the_noise():
    times, white = np.linspace(0, 1, 400), np.full(400, 1e-4)
    line = 3 - 2 * times
    found = DriftInnovations.of(times, white, 1.0, 1.0)
    assert np.sum((found.of_errors(line) / found.std) ** 2) == pytest.approx(13, rel=1e-3)


@pytest.mark.parametrize("scheme", ["collocation", "shooting"])
def test_levels_and_estimates_are_those_of_generalized_least_squares(scheme):
    times = np.sort(np.random.default_rng(1).uniform(0, 5, 25))
    measured = relaxing(8, times := times - times[0]) + 0.3 * times
    trials = cl.Trials.from_arrays([times] * 8, [*measured], names=["x"])
    law = cl.fit(f"x' = a - {K} x", trials, errors="drift", scheme=scheme)
    begin = [*np.log([0.05, 0.2, 0.1]), 0.0]
    levels = optimize.minimize(lambda levels: regression(measured, times, levels)[0], begin).x
    model, parameters = law.uncertainty.error_model, named_parameters(law)
    assert [*law.uncertainty.noise, *model.offset, *model.slope] == pytest.approx(np.exp(levels[:3]), rel=2e-3)
    assert model.trend == pytest.approx(levels[3], rel=2e-3)
    _, estimate, error = regression(measured, times, levels)
    assert parameters.values[0, 0] == pytest.approx(estimate, abs=0.005 * error)
    by_levels = error_by_levels(measured, times, levels)
    assert by_levels > 0.1 * error
    assert parameters.errors[0, 0] == pytest.approx(np.hypot(error, by_levels), rel=2e-3)


@pytest.mark.slow
def test_an_offset_of_all_trials_is_confounded_with_a_constant_term():
    """The standard error of the level a/k that all trials approach is that of the mean of their offsets."""
    times, count = np.linspace(0, 20, 60), 40
    measured = relaxing(count, times, noise=0.01, slope=0.0)
    trials = cl.Trials.from_arrays([times] * count, [*measured], names=["x"])
    law = cl.fit(f"x' = a - {K} x", trials, errors="drift", scheme="shooting")
    offset = float(law.uncertainty.error_model.offset[0])
    assert offset == pytest.approx(0.2, rel=0.3)
    assert named_parameters(law).errors[0, 0] / K == pytest.approx(offset / np.sqrt(count), rel=0.05)


@pytest.mark.usefixtures("few_starts")
def test_a_drift_of_each_state_has_levels_of_its_own():
    times, random = np.linspace(0, 6, 40), np.random.default_rng(3)
    y = 3 * np.exp(-0.4 * times)
    made = [
        np.column_stack([y * np.cos(times), y * np.sin(times)])
        + 0.02 * random.standard_normal((40, 2))
        + np.column_stack([random.normal(0, 0.3) + 0 * times, random.normal(0, 0.1) * times])
        for _ in range(8)
    ]
    trials = cl.Trials.from_arrays([times] * 8, made, names=["x", "y"])
    equations = "x' = -c x - w y; y' = w x - c y"
    one = cl.fit(equations, trials, errors="drift")
    guesses = {"c": 0.4, "w": 1.0}
    other = cl.fit(equations, trials, errors="drift", scheme="shooting", guesses=guesses)
    for law in (one, other):
        model = law.uncertainty.error_model
        assert model.offset[0] == pytest.approx(0.3, rel=0.5)
        assert model.slope[1] == pytest.approx(0.1, rel=0.5)
        assert model.offset[1] < 0.02
        assert model.slope[0] < 0.01
    assert named_parameters(one).values == pytest.approx(named_parameters(other).values, rel=1e-4)


def test_a_law_with_a_drift_is_saved_and_forecasts_its_measurements(tmp_path):
    times = np.linspace(0, 5, 25)
    trials = cl.Trials.from_arrays([times] * 6, [*relaxing(6, times)], names=["x"])
    law = cl.fit(f"x' = a - {K} x", trials, errors="drift")
    law.save(tmp_path / "law.json")
    again = cl.Law.load(tmp_path / "law.json")
    assert again == law
    forecast = again.predict(trials, return_std=True, start=10)
    model, noise = law.uncertainty.error_model, law.uncertainty.noise
    slopes = model.slope**2 + model.trend**2
    expected = np.sqrt(noise**2 + model.offset**2 + slopes * times[:, np.newaxis] ** 2)
    assert forecast.measurement_std()[0] == pytest.approx(expected)
    steps = {step.stage: step.choice for step in law.history}
    assert f"{model.slope[0]:.3g}" in steps["drift of the sensor"]
    law.report(trials).save(tmp_path / "report.html")
    assert f"drift at first of x: {model.offset[0]:.3g}" in (tmp_path / "report.html").read_text("utf-8")
    standardized = law.residuals(trials).standardized
    curves = law.predict(trials, start="all").trajectories
    pairs = zip(trials, curves, standardized, strict=True)
    for trial, curve, residuals in pairs:
        assert residuals == pytest.approx((trial.states - curve.states) / expected, abs=1e-4)


def test_measurements_have_the_standard_deviation_of_their_time():
    errors = ErrorModel(offset=np.array([0.3]), slope=np.array([2.0]))
    std = errors.measurement_std(np.zeros((3, 1)), np.array([0.4]), np.array([0.0, 1.0, 2.0]))
    assert std[:, 0] == pytest.approx(np.sqrt([0.25, 4.25, 16.25]))


def test_files_are_fitted_one_by_one_under_a_drift(tmp_path):
    """The levels of all are root mean squares of those of each file, of slopes about zero."""
    times, levels = np.linspace(0, 5, 25), list[np.ndarray]()
    for name in ("a", "b"):
        trials = cl.Trials.from_arrays(
            [times] * 6, [*relaxing(6, times, seed=ord(name))], object=[name] * 6, names=["x"]
        )
        frame = trials.to_frame()
        frame.to_parquet(tmp_path / f"{name}.parquet")
        model = cl.fit(f"x' = a - {K} x", trials, errors="drift").uncertainty.error_model
        levels.append(np.append(model.offset, np.hypot(model.slope, model.trend)))
    stream = cl.TrialStream.from_parquet(tmp_path, object="object", trial="trial", time="t", states=["x"])
    law = cl.fit(f"x' = a - {K} x", stream, errors="drift")
    model = law.uncertainty.error_model
    assert [*model.offset, *model.slope] == pytest.approx(np.sqrt(np.mean(np.square(levels), axis=0)), rel=1e-3)


@pytest.mark.parametrize("scheme", ["collocation", "shooting"])
def test_a_slope_of_all_trials_is_their_mean_and_one_of_zero_is_none(scheme):
    times = np.linspace(0, 5, 25)
    for slope in (-0.4, 0.0):
        measured = relaxing(6, times, offset=0.0, slope=0.0) + slope * times
        trials = cl.Trials.from_arrays([times] * 6, [*measured], names=["x"])
        law = cl.fit(f"x' = a - {K} x", trials, errors="drift", scheme=scheme)
        (trend,), error = law.uncertainty.error_model.trend, named_parameters(law).errors[0, 0]
        assert trend == (pytest.approx(slope, abs=0.05) if slope else 0.0)
        assert named_parameters(law).values[0, 0] == pytest.approx(2 * K, abs=3 * error)


@pytest.mark.slow
def test_a_drift_that_all_trials_share_is_chosen_and_intervals_hold_the_truth():
    times, hits, kinds = np.linspace(0, 6, 40), list[bool](), list[str]()
    for seed in range(20):
        measured = relaxing(6, times, noise=0.05, offset=0.0, slope=0.0, seed=seed) + 0.06 * times
        names = [name for name in "abc" for _ in range(2)]
        trials = cl.Trials.from_arrays([times] * 6, [*measured], object=names, names=["x"])
        law = cl.fit("x' = a - k x", trials)
        kinds.append(law.uncertainty.error_model.kind)
        for name, true in (("a", 2 * K), ("k", K)):
            params = law.params[law.params.parameter == name]
            hits += ((params.low <= true) & (true <= params.high)).tolist()
    assert kinds.count("drift") >= 18
    assert 0.87 <= np.mean(hits) <= 1.0


@pytest.mark.slow
def test_intervals_hold_the_truth_under_drifts():
    times, hits = np.linspace(0, 5, 25), list[bool]()
    for seed in range(25):
        trials = cl.Trials.from_arrays([times] * 12, [*relaxing(12, times, seed=seed)], names=["x"])
        law = cl.fit("x' = a - k x", trials, errors="drift")
        params = law.params.set_index("parameter")
        hits += [bool(params.low[name] <= true <= params.high[name]) for name, true in (("a", 2 * K), ("k", K))]
    assert 0.84 <= np.mean(hits) <= 1.0


def test_a_state_that_was_not_measured_in_a_trial_has_no_drift_there():
    times, random = np.linspace(0, 4, 25), np.random.default_rng(1)
    decays = np.column_stack([3 * np.exp(-times), 2 * np.exp(-0.5 * times)])
    tables = [decays + 0.05 * random.standard_normal(decays.shape) for _ in range(3)]
    tables[2][:, 1] = np.nan
    trials = cl.Trials.from_arrays([times] * 3, tables, names=["x", "y"])
    law = cl.fit("x' = -a x; y' = -b y", trials, errors="drift")
    assert law.uncertainty.error_model.kind == "drift"
    assert law.params.set_index("parameter").estimate["b"] == pytest.approx(0.5, abs=0.1)
