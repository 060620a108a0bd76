"""What there is beyond a law, by kind: sizes are those of what was simulated, in units of the state."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import commonlaw as cl
from commonlaw.law import from_json, to_json
from commonlaw.law.misfit import misfit_lines, misfit_size
from commonlaw.likelihood import ERRORS, ByGroup
from commonlaw.likelihood.errors import Heteroscedastic

TIMES = np.linspace(0, 6, 80)
RATES = {"a": 0.3, "b": 0.5, "c": 0.8}
EQUATION = "T' = a - k T"


def cups(error):
    """Return cups that cool from 80 to 20 degrees, each measured with errors."""
    curves = [20 + 60 * np.exp(-rate * TIMES) for rate in RATES.values()]
    measured = [curve + error(i, curve) for i, curve in enumerate(curves)]
    trials = cl.Trials.from_arrays([TIMES] * 3, measured, object=list(RATES), names=["T"], units={"T": "K", "t": "s"})
    return trials, float(np.sqrt(np.mean([np.var(curve) for curve in measured])))


@pytest.fixture(scope="module")
def draws():
    return np.random.default_rng(3).standard_normal((3, 80))


@pytest.fixture(scope="module")
def correlated(draws):
    """Cups with errors of standard deviation 1.5 that forget in 0.4 s, and an independent noise of 0.2."""
    kept = np.exp(-np.diff(TIMES)[0] / 0.4)
    errors = np.zeros((3, 80))
    errors[:, 0] = 1.5 * draws[:, 0]
    for k in range(1, 80):
        errors[:, k] = kept * errors[:, k - 1] + 1.5 * np.sqrt(1 - kept**2) * draws[:, k]
    noise = 0.2 * np.random.default_rng(4).standard_normal((3, 80))
    return *cups(lambda i, _: errors[i] + noise[i]), float(np.std(errors))


def numbers(line):
    """Return the numbers of a line."""
    words = line.replace("(", " ").replace(",", " ").split()
    return [float(word) for word in words if word.replace(".", "", 1).isdigit()]


def test_correlated_errors_have_the_size_that_was_simulated(correlated):
    trials, signal, std = correlated
    law = cl.fit(EQUATION, trials)
    assert law.uncertainty.error_model.kind == "autocorrelated"
    (size,) = misfit_size(law, "autocorrelated")
    assert size == pytest.approx(std, rel=0.25)
    assert law.uncertainty.misfit.signal == pytest.approx([signal])
    (line,) = misfit_lines(law)
    rounded = [law.uncertainty.error_model.memory, size, 100 * size / signal]
    assert numbers(line)[:3] == pytest.approx(rounded, rel=0.05)
    assert line in str(law).splitlines()
    (step,) = (step for step in law.history if step.stage == "misfit")
    assert step.choice == ERRORS["autocorrelated"].label


def test_both_schemes_agree_on_what_is_beyond_a_law(correlated):
    trials, *_ = correlated
    for errors in ("autocorrelated", "sensor-walk", "drift"):
        one, other = (cl.fit(EQUATION, trials, errors=errors, scheme=scheme) for scheme in ("collocation", "shooting"))
        assert misfit_size(one, errors) == pytest.approx(misfit_size(other, errors), rel=0.01)
        first, second = (law.uncertainty.misfit for law in (one, other))
        assert (first.signal, first.duration) == (pytest.approx(second.signal), second.duration)
        assert (first.outliers, first.measurements, first.deviation) == (0, 240, None)
        assert (second.outliers, second.measurements, second.deviation) == (0, 240, None)


def test_a_drift_has_the_size_that_it_reaches_in_a_trial(draws):
    slopes, offsets = (0.8, -0.5, 0.6), (0.0, 0.4, -0.4)
    trials, _ = cups(lambda i, _: offsets[i] + slopes[i] * TIMES + 0.3 * draws[i])
    known = cl.Law.from_text("T' = a - k T", {"a": 20, "k": 0.5}, units={"T": "K", "t": "s"})
    assert misfit_lines(known) == []
    law = cl.fit("T' = 20 k - k T", trials, errors="drift")
    ends = np.add(offsets, np.multiply(6, slopes))
    assert misfit_size(law, "drift") == pytest.approx([np.sqrt(np.mean(ends**2))], rel=0.5)


def test_a_walk_of_the_sensor_has_the_size_that_it_reaches_in_a_trial(draws):
    walks = 0.8 * np.sqrt(TIMES[1]) * np.cumsum(draws, axis=1)
    trials, _ = cups(lambda i, _: walks[i] + 0.1 * draws[::-1][i])
    law = cl.fit(EQUATION, trials, errors="sensor-walk")
    assert misfit_size(law, "sensor-walk") == pytest.approx([0.8 * np.sqrt(6)], rel=0.2)


def matern(times, std, time, seed):
    """Return a draw of a Matern process of smoothness 3/2."""
    apart = np.sqrt(3) / time * np.abs(times[:, np.newaxis] - times)
    covariance = (1 + apart) * np.exp(-apart) + 1e-10 * np.eye(len(times))
    return std * np.linalg.cholesky(covariance) @ np.random.default_rng(seed).standard_normal(len(times))


@pytest.mark.parametrize("seed", [0, 3])
def test_a_force_has_the_size_of_the_deviation_from_the_nearest_solution(seed):
    fine, times = np.linspace(0, 12, 301), np.linspace(0, 12, 121)

    def spring(start, force=None):
        def rates(t, z):
            return [z[1], -4 * z[0] - 0.3 * z[1] + (0.0 if force is None else np.interp(t, fine, force))]

        return solve_ivp(rates, (0, 12), start, t_eval=times, rtol=1e-8, atol=1e-9, max_step=0.04).y[0]

    basis = np.column_stack([spring((1, 0)), spring((0, 1))])
    forces = [matern(fine, 0.3, 1.5, [seed, k]) for k in range(2)]
    paths = [spring((start, 0), force) for start, force in zip((1.0, 1.5), forces, strict=True)]
    apart = [path - basis @ np.linalg.lstsq(basis, path)[0] for path in paths]
    noise = 0.01 * np.random.default_rng(seed).standard_normal((2, 121))
    trials = cl.Trials.from_arrays([times] * 2, list(paths + noise), object="o", trial=["1", "2"], names=["x"])
    law = cl.fit("x'' = -k x - c v", trials, errors="gp-forcing")
    deviation = law.uncertainty.misfit.deviation
    assert deviation == pytest.approx([np.sqrt(np.mean(np.square(apart)))], rel=0.2)
    assert misfit_size(law, "gp-forcing") is deviation
    share = deviation[0] / np.sqrt(np.mean(np.var(paths, axis=1)))
    assert numbers(misfit_lines(law)[0])[1:3] == pytest.approx([deviation[0], 100 * share], rel=0.06)


def test_a_random_walk_has_the_size_of_the_deviation_from_the_nearest_solution():
    random, rate, step, fine = np.random.default_rng(5), 0.5, 0.05, 20
    paths = np.empty((2, 121))
    for path, start in zip(paths, (30.0, 50.0), strict=True):
        level = start
        for k in range(121):
            path[k] = level
            for _ in range(fine):  # Euler and Maruyama
                level += -rate * level * step / fine + 1.0 * np.sqrt(step / fine) * random.standard_normal()
    times = step * np.arange(121)
    decay = np.exp(-rate * times)
    apart = paths - np.outer(paths @ decay / (decay @ decay), decay)
    measured = paths + 0.1 * random.standard_normal(paths.shape)
    trials = cl.Trials.from_arrays([times] * 2, list(measured), object="o", trial=["1", "2"], names=["x"])
    law = cl.fit("x' = -k x", trials)
    assert law.uncertainty.error_model.kind == "random-walk"
    (deviation,) = misfit_size(law, "random-walk")
    assert deviation == pytest.approx(np.sqrt(np.mean(apart**2)), rel=0.25)


def test_outliers_are_counted_in_both_schemes(draws):
    bad = {(0, 9), (0, 40), (1, 3), (2, 70)}
    spikes = np.zeros((3, 80))
    for place in bad:
        spikes[place] = 8.0
    trials, _ = cups(lambda i, _: 0.3 * draws[i] + spikes[i])
    for scheme in ("collocation", "shooting"):
        law = cl.fit(EQUATION, trials, scheme=scheme)
        assert (law.uncertainty.misfit.outliers, law.uncertainty.misfit.measurements) == (4, 240)
        assert numbers(misfit_lines(law)[0]) == [4, 240]


def test_noise_of_objects_and_of_values_is_given_by_its_range_or_its_share(draws):
    law = cl.fit(EQUATION, cups(lambda i, _: (0.2, 1.0, 4.0)[i] * draws[i])[0])
    (line,) = misfit_lines(law)
    assert numbers(line) == pytest.approx([0.2, 4.0], rel=0.25)
    assert "(a)" in line
    assert "(c)" in line
    assert misfit_lines(cl.law.select_objects(law, ["a"])) == []
    law = cl.fit(EQUATION, cups(lambda i, curve: 0.05 * curve * draws[i])[0])
    assert numbers(misfit_lines(law)[0]) == pytest.approx([5], rel=0.15)


def test_sizes_stay_with_a_law(correlated):
    trials, *_ = correlated
    law = cl.fit(EQUATION, trials)
    lines = misfit_lines(law)
    assert misfit_lines(from_json(to_json(law))) == lines
    assert misfit_lines(cl.law.select_objects(law, ["a"])) == lines
    assert misfit_lines(cl.refine(law, trials)) == lines
    assert misfit_lines(law.update(trials)) == lines
    # Of an earlier version
    before = replace(law, uncertainty=replace(law.uncertainty, misfit=None))
    (line,) = misfit_lines(before)
    assert numbers(line)[:2] == numbers(lines[0])[:2]
    assert "signal" not in line


def test_parts_of_a_stream_have_one_size(correlated, tmp_path):
    trials, signal, _ = correlated
    for name in trials.objects:
        trials.select(object=name).to_parquet(tmp_path / f"{name}.parquet")
    stream = cl.TrialStream.from_parquet(tmp_path, object="object", trial="trial", time="t", states=["T"])
    law = cl.fit(EQUATION, stream, errors="autocorrelated", n_jobs=1)
    misfit = law.uncertainty.misfit
    assert misfit.signal == pytest.approx([signal])
    assert (misfit.outliers, misfit.measurements) == (0, 240)
    alone = [
        misfit_size(cl.fit(EQUATION, trials.select(object=name), errors="autocorrelated"), "autocorrelated")[0]
        for name in trials.objects
    ]
    assert misfit_size(law, "autocorrelated") == pytest.approx([np.sqrt(np.mean(np.square(alone)))])


def test_every_kind_has_a_description():
    for kind, model in ERRORS.items():
        assert bool(model.description) == (kind != "white")
        if isinstance(model, Heteroscedastic) or not model.description:
            continue
        assert "{amount}" in model.description
        assert bool(model.distinguished_by) == (not isinstance(model, ByGroup))
