"""Errors beside white noise: found with the law, kept with it, and carried by forecasts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import odeint
from scipy.linalg import expm, solve_triangular, toeplitz
from scipy.optimize import least_squares, minimize
from scipy.signal import lfilter
from scipy.stats import t

import commonlaw as cl
from commonlaw.inference.data.noise import noise_floor
from commonlaw.law import Uncertainty
from commonlaw.law.parameters import standard_errors
from commonlaw.likelihood import ErrorModel
from tests.recovery import problems
from tests.recovery.golden import recovered
from tests.refusals import refused
from tests.simulations import solved

TIMES = np.linspace(0, 12, 241)
STEP = TIMES[1]


def oscillator(errors, count=3):
    """Trials of x'' = -2 x - 0.1 v, each with errors of its own."""
    matrix = np.array([[0.0, 1.0], [-2.0, -0.1]])
    paths = np.array([expm(matrix * t) @ [[2.0, -1.0, 1.5], [0.0, 2.0, 1.0]] for t in TIMES])
    states = [(paths[:, 0, i] + errors(paths[:, 0, i], np.random.default_rng(i)))[:, np.newaxis] for i in range(count)]
    return cl.Trials.from_arrays([TIMES] * count, states, object=["spring"] * count, names=["x"])


def white(path, generator):
    return 0.02 * generator.standard_normal(len(path))


def proportional(path, generator):
    return 0.05 * path * generator.standard_normal(len(path)) + 0.002 * generator.standard_normal(len(path))


def correlated(path, generator):
    keeps = np.exp(-STEP / 0.8)
    pushes = 0.05 * generator.standard_normal(len(path))
    pushes[1:] *= np.sqrt(1 - keeps**2)
    return lfilter([1.0], [1.0, -keeps], pushes) + 0.005 * generator.standard_normal(len(path))


@pytest.fixture(scope="module")
def law():
    return cl.fit("x'' = a x + b v", oscillator(white))


def most_likely(errors):
    """Return the white noise, the level and the memory under which errors that are known are most probable."""

    def value(logs):
        noise, level, memory = np.exp(logs)
        factor = np.linalg.cholesky(toeplitz(level**2 * np.exp(-TIMES / memory)) + noise**2 * np.eye(len(TIMES)))
        rests = solve_triangular(factor, np.transpose(errors), lower=True)
        return 2 * len(errors) * np.log(np.diag(factor)).sum() + np.sum(rests**2)

    return np.exp(minimize(value, np.log([0.005, 0.05, 0.8]), method="Nelder-Mead").x)


@pytest.fixture(scope="module")
def autocorrelated():
    return cl.fit("x'' = a x + b v", oscillator(correlated))


def test_white_noise_is_found_with_the_law():
    law, _ = recovered("spring, defaults")
    heights = np.concatenate([trial.states for trial in problems.spring(problems.white(0.0))])
    assert law.structure == ("x'' = a x + b v",)
    assert not law.uncertainty.error_model
    assert law.uncertainty.noise == pytest.approx([0.01 * heights.std()], rel=0.1)


def test_noise_in_proportion_is_found_with_the_law():
    law, _ = recovered("growth, proportional")
    found = law.uncertainty.error_model
    assert found.heteroscedastic["proportional"] == pytest.approx([0.05], rel=0.15)
    assert found.correlated is None
    missed = law.coefficients[:, law.support][:, 0] - [0.3, 0.5, 0.4]
    assert np.all(np.abs(missed) < 3.5 * standard_errors(law)[:, law.support][:, 0])


def test_autocorrelated_errors_are_found_with_the_law(autocorrelated):
    noise, level, memory = most_likely([correlated(TIMES, np.random.default_rng(i)) for i in range(3)])
    found = autocorrelated.uncertainty.error_model
    assert found.correlated == pytest.approx([level], rel=0.15)
    assert found.memory == pytest.approx(memory, rel=0.2)
    assert autocorrelated.uncertainty.noise == pytest.approx([noise], rel=0.3)
    errors = standard_errors(autocorrelated)[0, 0]
    assert np.all(np.abs(autocorrelated.coefficients[0, 0] - [-2, -0.1]) < 3.5 * errors)
    as_white = cl.fit("x'' = a x + b v", oscillator(correlated), errors="white")
    assert as_white.uncertainty.error_model.correlated is None
    assert np.all(errors > 1.5 * standard_errors(as_white)[0, 0])


def test_noise_in_proportion_is_so_to_the_fitted_states_where_these_cross_zero():
    """Standard errors agree with least squares, weighted by the noise at the solution, iterated until it stays."""
    trials = oscillator(lambda path, generator: 0.05 * path * generator.standard_normal(len(path)), count=1)
    law = cl.fit("x'' = a x + b v", trials, errors="proportional")
    errors, measured = law.uncertainty.error_model, trials[0].states[:, 0]

    def solution(p):
        return odeint(lambda y, _: [y[1], p[0] * y[0] + p[1] * y[1]], p[2:], TIMES, rtol=1e-10, atol=1e-12)[:, 0]

    found = np.array([-2.0, -0.1, 2.0, 0.0])
    for _ in range(4):
        std = errors.white_std(solution(found)[:, np.newaxis], law.uncertainty.noise)[:, 0]
        fitted = least_squares(lambda p, std=std: (solution(p) - measured) / std, found, x_scale="jac", diff_step=1e-5)
        found = fitted.x
    expected = np.sqrt(np.diag(np.linalg.inv(fitted.jac.T @ fitted.jac)))[:2]
    np.testing.assert_allclose(standard_errors(law)[law.support[np.newaxis]], expected, rtol=0.1)
    np.testing.assert_allclose(law.coefficients[law.support[np.newaxis]], found[:2], atol=0.3 * expected.max())


def test_a_law_with_other_errors_survives_its_file(autocorrelated, tmp_path):
    autocorrelated.save(tmp_path / "law.json")
    again, trials = cl.Law.load(tmp_path / "law.json"), oscillator(correlated)
    for name in ("correlated", "memory"):
        before, after = (getattr(each.uncertainty.error_model, name) for each in (autocorrelated, again))
        np.testing.assert_array_equal(after, before)
    first, second = (each.predict(trials, return_std=True, start=20) for each in (autocorrelated, again))
    np.testing.assert_array_equal(first.std[0], second.std[0])
    # A measurement has its own error beside that of the state
    measured, state = (first.margins(measured=each)[0] for each in (True, False))
    known = autocorrelated.uncertainty
    own = t.ppf(0.975, known.degrees_of_freedom[0]) * np.hypot(known.noise, known.error_model.correlated)
    np.testing.assert_allclose(measured[:, 0], np.hypot(state[:, 0], own), rtol=1e-4)


@pytest.mark.parametrize("kind", ["walk", "force"])
def test_the_error_of_a_law_carries_forecasts_as_far_as_simulations_say(law, kind):
    """The scatter of many simulated oscillators that are pushed, from one start."""
    coefficients = np.where(law.support, law.coefficients, 0.0)
    matrix = np.array([[0.0, 1.0], coefficients[0, 0][[law.terms.names.index(each) for each in ("x", "v")]]])
    walk, force, time = np.array([0.05, 0.08]), np.array([0.3]), 0.7
    errors = ErrorModel(walk=walk) if kind == "walk" else ErrorModel(force=force, force_time=time)
    certain = Uncertainty(np.zeros_like(law.uncertainty.covariance), noise=np.array([1e-6]), error_model=errors)
    trials = oscillator(white, 1).with_trials([oscillator(white, 1)[0].cut(121)])
    forecast = replace(law, uncertainty=certain).predict(trials, return_std=True, start=1, averaged=False)
    # Exact covariance of the linear law with its latent processes, by the matrix exponential of small steps
    rate = np.sqrt(3) / time
    wide = np.zeros((4, 4))
    wide[:2, :2] = matrix
    wide[1, 2], wide[2, 3], wide[3, 2:] = 1.0, 1.0, [-(rate**2), -2 * rate]
    pushes = np.diag([*walk**2, 0, 0] if kind == "walk" else [0, 0, 0, 4 * rate**3 * force[0] ** 2])
    start = np.diag([0, 0, 0, 0] if kind == "walk" else [0, 0, force[0] ** 2, (rate * force[0]) ** 2])
    block = np.zeros((8, 8))
    block[:4, :4], block[:4, 4:], block[4:, 4:] = -wide, pushes, wide.T
    van_loan = expm(block * STEP)
    turn = van_loan[4:, 4:].T
    added = turn @ van_loan[:4, 4:]
    expected = [start]
    for _ in range(120):
        expected.append(turn @ expected[-1] @ turn.T + added)
    std = np.sqrt([each[0, 0] for each in expected])
    np.testing.assert_allclose(forecast.std[0][1:, 0], std[1:], rtol=0.02)


def test_a_start_under_a_law_that_errs_is_the_last_state_that_samples_tell(law):
    trials = oscillator(white, 1)
    errs = replace(law, uncertainty=replace(law.uncertainty, error_model=ErrorModel(walk=np.array([0.2, 0.2]))))
    exact, loose = (each.predict(trials, start=120, return_std=True) for each in (law, errs))
    measured = trials[0].states[:, 0]
    near = slice(110, 125)
    # Free of the law it follows the samples; what they tell of the state is less
    assert np.abs(loose.trajectories[0].states[near, 0] - measured[near]).mean() < 0.05
    assert np.all(loose.std[0][120:, 0] > exact.std[0][120:, 0])
    assert loose.std[0][119, 0] < law.uncertainty.noise[0]
    assert loose.std[0][-1, 0] > 5 * loose.std[0][119, 0]


def test_noise_is_no_less_than_that_of_rounded_values():
    slow = np.round(np.exp(-0.01 * TIMES), 2)[:, np.newaxis]
    law = cl.fit("x' = -a x", cl.Trials.from_arrays([TIMES], [slow], names=["x"]))
    assert law.uncertainty.noise == pytest.approx([0.01 / np.sqrt(12)])
    assert noise_floor(cl.Trials.from_arrays([TIMES], [slow + 1e-3 * slow**2], names=["x"]))[0] < 1e-4


def test_a_kind_of_errors_that_there_is_not_is_refused(law):
    with refused("unknown-name", kind="errors", name="pink"):
        cl.TrajectoryLikelihood(errors="pink")
    with refused("law-array-range"):
        replace(law, uncertainty=replace(law.uncertainty, error_model=ErrorModel({"proportional": np.array([-1.0])})))


@pytest.mark.slow
def test_laws_are_compared_under_the_errors_that_the_measurements_ask_for():
    trials = oscillator(correlated, count=1)
    laws = {text: cl.fit(text, trials) for text in ("x'' = a x + b v", "x'' = a x", "x'' = a x + b v^3")}
    found = cl.compare(laws, trials).set_index("law")
    assert found["errors"].iloc[0] == "autocorrelated measurement errors"
    assert found.index[0] == "x'' = a x + b v"
    assert not found["lack of fit"].iloc[0]
    assert found.loc["x'' = a x", "2 log B"] > 10
    white = cl.compare(laws, trials, errors="white").set_index("law")
    assert white["errors"].unique() == ["white noise"]


@pytest.mark.slow
def test_a_law_that_is_not_in_the_library_has_a_model_error_and_wide_intervals():
    times, generator = np.linspace(0, 4, 200), np.random.default_rng(0)

    def field(t, z):
        return [z[1], -9.8 - 0.05 * z[1] * abs(z[1]) - 3 * np.sin(5 * t)]

    paths = [solved(field, start, times)[:, 0] for start in ([60, 0], [50, 8])]
    states = [path + 0.01 * generator.standard_normal(path.shape) for path in paths]
    trials = cl.Trials.from_arrays([times] * 2, states, object=["ball"] * 2, names=["x"])
    within = cl.discover(trials, order=2, library="terms:1,x,v,v*abs(v),sin(5*t)")
    without = cl.discover(trials, order=2, library="poly:1")
    assert [name for name, used in zip(within.terms.names, within.support[0], strict=True) if used] == [
        "1", "v*abs(v)", "sin(5 t)",
    ]  # fmt: skip
    steps = {law: next(step for step in law.history if step.stage == "model error") for law in (within, without)}
    assert steps[within].choice == "none"
    assert within.diagnostics == ()
    assert {diagnostic.kind for diagnostic in without.diagnostics} <= {"not identifiable"}
    assert without.uncertainty.error_model.kind == "gp-forcing"
    (size,) = without.uncertainty.misfit.deviation
    # The sine waves are a motion of amplitude 3/25; coefficients, which err by them, add to it
    assert 0.02 < size < 0.5
    table = without.comparison
    assert table["chosen"].tolist().index(True) == table["score"].argmin()
    assert "a smooth force on x" in steps[without].choice
    # Sine waves of amplitude 3, of which some is in the coefficients
    error_model = without.uncertainty.error_model
    assert 0.2 < error_model.force[0] < 3
    assert 0.1 < error_model.force_time < 2 * np.pi / 5
    errors = standard_errors(without)
    assert errors[0, 0, 0] > 5 * standard_errors(within)[0, 0, 0]
    assert np.isfinite(errors[without.coefficients != 0]).all()
    assert np.all(
        (without.uncertainty.inclusion_probabilities >= 0) & (without.uncertainty.inclusion_probabilities <= 1)
    )


@pytest.mark.slow
def test_noise_in_proportion_is_found_where_few_samples_of_a_fast_decay_hide_it():
    times, random, states = np.array([0.25, 0.5, 0.75, 1.0, 1.25, 2.0, 3.0, 4.0]), np.random.default_rng(1), []
    for _ in range(6):
        a, b, k, m = random.normal([2.5, 0.6, 1.9, 0.25], [0.3, 0.1, 0.2, 0.03])
        exact = a * np.exp(-k * times) + b * np.exp(-m * times)
        states.append(exact * (1 + 0.1 * random.standard_normal(len(times))))
    trials = cl.Trials.from_arrays([times] * 6, states, object=list("abcdef"), names=["c"])
    law = cl.discover(trials, order=2, library="poly:2")
    assert law.structure == ("c'' = a c + b v",)
    assert law.uncertainty.error_model.heteroscedastic["proportional"] == pytest.approx([0.1], rel=0.3)
