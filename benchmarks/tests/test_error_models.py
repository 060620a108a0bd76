"""The errors that laws are measured under are what their names say."""

import json

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from benchmarks import error_models
from benchmarks.error_models import LEVELS
from benchmarks.families import experiment

KNOWN = experiment("Lotka-Volterra")


def errors_of(name):
    """Return errors in units of the states' standard deviations, shape (draws * trials, samples, states)."""
    draws = [np.array(error_models.measured(KNOWN, name, LEVELS[name], seed)) for seed in range(20)]
    return np.concatenate([states - np.array(KNOWN.clean()) for states in draws]) / KNOWN.noise(1.0)


def test_white_noise_has_its_size_and_no_memory():
    errors = errors_of("white")
    assert errors.std() == pytest.approx(LEVELS["white"], rel=0.02)
    assert abs(np.mean(errors[:, 1:] * errors[:, :-1])) < 0.02 * errors.var()


def test_proportional_noise_grows_with_the_state():
    ratios = errors_of("proportional") * KNOWN.noise(1.0) / np.tile(KNOWN.clean(), (20, 1, 1))
    assert ratios.std() == pytest.approx(LEVELS["proportional"], rel=0.02)


def test_correlated_noise_has_its_size_from_the_first_sample_on_and_forgets_as_stated():
    errors = errors_of("correlated")
    for part in (errors, errors[:, 0]):
        assert part.std() == pytest.approx(LEVELS["correlated"], rel=0.1)
    lag = int(error_models.MEMORY)
    assert np.mean(errors[:, lag:] * errors[:, :-lag]) / errors.var() == pytest.approx(np.exp(-1), abs=0.05)


def test_rounded_measurements_lie_on_a_scale():
    states = error_models.measured(KNOWN, "rounded", LEVELS["rounded"], 0)[0]
    steps = (states - states[0]) / KNOWN.noise(LEVELS["rounded"])
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert np.abs(errors_of("rounded")).max() <= LEVELS["rounded"] / 2 + 1e-9


@pytest.mark.slow
def test_a_smooth_force_has_its_size_and_length(monkeypatch):
    monkeypatch.setattr(error_models, "BESIDE", 0.0)
    coefficients = np.repeat(KNOWN.coefficients, 2, axis=0)
    times, forces, size = KNOWN.family.times, [], []
    for seed in range(3):
        for states, clean, (a, b, c, d) in zip(
            error_models.measured(KNOWN, "smooth", LEVELS["smooth"], seed), KNOWN.clean(), coefficients, strict=True
        ):
            x, y = states.T
            rates = CubicSpline(times, states)(times, 1)
            forces.append(rates - np.stack([a * x + b * x * y, c * y + d * x * y], axis=1))
            size.append(CubicSpline(times, clean)(times, 1).std(axis=0))
    force = np.array(forces) / np.mean(size, axis=0)
    assert force.std() == pytest.approx(LEVELS["smooth"], rel=0.15)
    lag = 30  # A fifth of 150 samples
    expected = (1 + np.sqrt(3)) * np.exp(-np.sqrt(3))
    assert np.mean(force[:, lag:] * force[:, :-lag]) / np.mean(force**2) == pytest.approx(expected, abs=0.15)


@pytest.mark.slow
def test_a_row_is_printed_for_each_system_and_error_and_written(tmp_path, capsys):
    out = tmp_path / "rows.json"
    error_models.main(["--system", "drops", "--error", "white", "--draws", "1", "--out", str(out)])
    assert "| drops | white | 2 | 1 of 1 | 0 | 10 | " in capsys.readouterr().out
    (row,) = json.loads(out.read_text())
    assert (row["right"], row["failed"], row["intervals"]) == (1, 0, 10)
