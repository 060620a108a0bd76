"""The likelihood of trajectories beside shooting."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from benchmarks.variational import cramer_rao, solve
from commonlaw.likelihood import Estimate, ObservationModel, TrajectoryModel, fit, meshes
from tests.unit.trajectories import NOISE, SUPPORT, TIMES, TRUE, information, of_prey, prey, terms_of, trial

DOWN = (1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001, 0.0003)
"""Model errors, further down than need be, so that what is left of them does not blur comparisons."""


def shot(field, times, measured, noise, sizes, start):
    """Coefficients of least squares over initial states and coefficients: single shooting, one start for each trial."""
    count = sum(sizes)

    def residuals(p):
        found = []
        for i, (t, y) in enumerate(zip(times, measured, strict=True)):
            begin = p[count * i : count * (i + 1)]
            span = (t[0], t[-1])
            path = solve_ivp(
                lambda _, z: field(z, p[count * len(times) :]), span, begin, "DOP853", t, rtol=1e-11, atol=1e-11
            ).y.T
            residuals = (path[:, : y.shape[1]] - y) / noise
            found.append(residuals[np.isfinite(residuals)])
        return np.concatenate(found)

    best = least_squares(residuals, start, xtol=1e-13, ftol=1e-13, gtol=1e-13, x_scale=np.maximum(np.abs(start), 0.1))
    return best.x[count * len(times) :], 2 * best.cost


def prey_of(measured):
    """Coefficients of prey and predators by single shooting, and what is left."""
    start = np.concatenate([*(run.states[0] for run in prey()[0]), TRUE])
    return shot(
        lambda z, c: [c[0] * z[0] + c[1] * z[0] * z[1], c[2] * z[1] + c[3] * z[0] * z[1]],
        [TIMES] * 2, measured, NOISE, (1, 1), start,
    )  # fmt: skip


@pytest.fixture(scope="module")
def shot_prey():
    measured = prey()[1]
    return measured, *prey_of(measured)


@pytest.mark.parametrize("points", [1, 2])
def test_prey_and_predators_fit_as_by_shooting(shot_prey, points):
    measured, expected, cost = shot_prey
    model, start = of_prey(measured, points=points)
    found = fit(model, start, SUPPORT, DOWN)
    bounds = cramer_rao(prey()[0], NOISE)
    np.testing.assert_allclose((found.coefficients[SUPPORT] - expected) / bounds, 0, atol=1e-3)
    assert found.deviance == pytest.approx(cost, abs=3e-3)
    assert found.objective == pytest.approx(found.deviance, abs=1e-2)


def test_heights_of_falling_balls_fit_as_by_shooting():
    times, noise = np.linspace(0, 3.2, 49), np.array([0.05])
    generator = np.random.default_rng(2)
    runs = [solve(("x", "v"), (("1", "v"),), np.array([-9.8, -0.4]), np.array(z), times) for z in ((47, 0), (46, 0.4))]
    measured = [run.states[:, :1] + noise * generator.standard_normal((49, 1)) for run in runs]
    start = np.concatenate([*(run.states[0] for run in runs), [-9.8, -0.4]])
    expected, cost = shot(lambda z, c: [z[1], c[0] + c[1] * z[1]], [times] * 2, measured, noise, (1, 1), start)
    model = TrajectoryModel(
        terms_of("terms:1,x,v", ("x", "v")),
        meshes([trial(times, each, name=str(i)) for i, each in enumerate(measured)]),
        ObservationModel(noise),
        np.array([0.05, 0.1]),
    )
    begin = Estimate((np.concatenate([run.states for run in runs]) + 0.1,), np.array([[-8.0, 0.0, -0.2]]))
    free = np.array([[True, False, True]])
    found = fit(model, begin, free, DOWN)
    np.testing.assert_allclose((found.coefficients[free] - expected) / cramer_rao(runs, noise), 0, atol=1e-3)
    assert found.coefficients[0, 1] == 0
    assert found.deviance == pytest.approx(cost, abs=1e-3)


def test_missing_values_and_a_gap_cost_information_only(shot_prey):
    full, *_ = shot_prey
    missing = [each.copy() for each in full]
    missing[0][20:30] = np.nan
    missing[1][np.random.default_rng(3).random((60, 2)) < 0.2] = np.nan
    expected, cost = prey_of(missing)
    model, begin = of_prey(missing)
    found = fit(model, begin, SUPPORT, DOWN)
    lost = information(model, found, SUPPORT, DOWN[-1])
    whole, first = of_prey(full)
    kept = information(whole, fit(whole, first, SUPPORT, DOWN), SUPPORT, DOWN[-1])
    errors = np.sqrt(np.diag(np.linalg.inv(lost)))
    np.testing.assert_allclose((found.coefficients[SUPPORT] - expected) / errors, 0, atol=2e-3)
    assert found.deviance == pytest.approx(cost, abs=2e-3)
    assert np.all(errors > np.sqrt(np.diag(np.linalg.inv(kept))))


def test_an_outlier_pulls_no_harder_than_the_huber_threshold(shot_prey):
    measured, *_ = shot_prey
    spoilt = [each.copy() for each in measured]
    spoilt[0][33, 0] += 50 * NOISE[0]
    fits = {}
    for huber_threshold in (np.inf, 4.0):
        clean, begin = of_prey(measured, huber_threshold=huber_threshold)
        dirty, start = of_prey(spoilt, huber_threshold=huber_threshold)
        reference = fit(clean, begin, SUPPORT, DOWN[:6])
        errors = np.sqrt(np.diag(np.linalg.inv(information(clean, reference, SUPPORT, DOWN[5]))))
        moved = fit(dirty, start, SUPPORT, DOWN[:6], 30).coefficients - reference.coefficients
        fits[huber_threshold] = np.abs(moved[SUPPORT] / errors).max()
    assert fits[4.0] < 1 < fits[np.inf]
