"""A law that explains whole trials is preferred to process noise that makes up for what a law lacks."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.diagnostics import OutcomeKind
from commonlaw.inference.result import approximation
from commonlaw.inference.result.approximation import effective_count, log_likelihood_gain
from commonlaw.law.parameters import named_parameters
from commonlaw.trials.transformations import with_starts

GAIN, TIME, DELAY = 0.6, 150.0, 20.0


def delayed_steps(delay: float) -> cl.Trials:
    """Return responses of first order to steps of an input, after a dead time."""
    times, generator = np.arange(0, 1200.1, 10.0), np.random.default_rng(0)
    inputs, states = list[np.ndarray](), list[np.ndarray]()
    for size in (30.0, 50.0):
        first, second = np.maximum(times - 50 - delay, 0), np.maximum(times - 700 - delay, 0)
        clean = GAIN * size * (1 - np.exp(-first / TIME)) - 0.6 * GAIN * size * (1 - np.exp(-second / TIME))
        states.append((clean + 0.05 * generator.standard_normal(len(times)))[:, np.newaxis])
        inputs.append(np.where(times < 50, 0.0, np.where(times < 700, size, 0.4 * size))[:, np.newaxis])
    return cl.Trials.from_arrays([times] * 2, states, inputs=inputs, object=["heater"] * 2, names=["T", "u"])


@pytest.fixture(scope="module")
def delayed() -> cl.Trials:
    return delayed_steps(DELAY)


@pytest.mark.slow
def test_a_law_with_terms_is_the_answer_where_the_empty_law_has_the_likelier_process_noise(delayed):
    forced = cl.discover(delayed, order=1, library="poly:1", method=cl.TrajectoryLikelihood(errors="gp-forcing"))
    assert not forced.support.any()  # By the prediction of the next sample alone
    law = cl.discover(delayed, order=1, library="poly:1")
    assert {"T", "u"} <= set(np.array(law.terms.names)[law.support[0]])
    assert not law.uncertainty.error_model.of_law
    assert law.predict(delayed, start="all").score() > 0.98
    (lack,) = (diagnostic for diagnostic in law.diagnostics if diagnostic.kind is OutcomeKind.APPROXIMATION)
    assert lack.code == "lack-of-fit"
    verdict = law.assess(delayed)
    assert (verdict.exact, verdict.none_exact) == (False, True)


def test_a_fit_without_process_noise_is_the_answer_where_it_explains_whole_trials_better(delayed):
    law = cl.fit("T' = (K u - T)/tau", delayed)
    white = cl.fit("T' = (K u - T)/tau", delayed, errors="white")
    np.testing.assert_allclose(law.coefficients, white.coefficients, rtol=1e-3)
    parameters = named_parameters(law)
    values = dict(zip(parameters.names, parameters.values[0], strict=True))
    assert TIME < values["tau"] < TIME + 2 * DELAY  # A lag makes up for the dead time
    assert values["K"] == pytest.approx(GAIN, rel=0.05)


def test_steps_without_a_dead_time_leave_no_lack_of_fit():
    law = cl.fit("T' = (K u - T)/tau", delayed_steps(0.0))
    assert OutcomeKind.APPROXIMATION not in {diagnostic.kind for diagnostic in law.diagnostics}


@pytest.mark.slow
def test_process_noise_stays_where_solutions_explain_as_much_with_it():
    generator, times, step = np.random.default_rng(0), np.linspace(0, 20, 61), 1 / 60
    states = list[np.ndarray]()
    for _ in range(4):
        path = [2.0]
        for shock in np.sqrt(step) * generator.standard_normal(1200):
            path.append(path[-1] + step * (path[-1] - path[-1] ** 3) + 0.1 * shock)
        states.append((np.array(path[::20]) + 0.002 * generator.standard_normal(61))[:, np.newaxis])
    law = cl.discover(cl.Trials.from_arrays([times] * 4, states, names=["x"]), order=1, library="poly:3")
    assert OutcomeKind.APPROXIMATION not in {diagnostic.kind for diagnostic in law.diagnostics}


def test_the_gain_counts_independent_residuals_as_a_likelihood_does():
    generator = np.random.default_rng(1)
    small, large = generator.standard_normal(2000), 3 * generator.standard_normal(2000)
    assert effective_count(small) == pytest.approx(2000, rel=0.05)
    expected = effective_count(small) * np.log(np.mean(large**2) / np.mean(small**2))
    assert log_likelihood_gain([[small]], [[large]]) == pytest.approx(expected)


def test_the_effective_sample_size_is_that_of_the_formula():
    residuals = np.random.default_rng(4).standard_normal(30).cumsum() + 2.0
    count, total, squares = len(residuals), sum(x * x for x in residuals), 0.0
    for lag in range(1, count):
        correlation = sum(residuals[i] * residuals[i + lag] for i in range(count - lag)) / total
        if correlation <= 0:
            break
        squares += correlation**2
    assert lag < count - 1
    assert effective_count(residuals) == pytest.approx(count / (1 + 2 * squares), rel=1e-12)
    assert effective_count(np.array([2.0, 1.0, 0.5])) == pytest.approx(3 / (1 + 2 * (2.5**2 + 1) / 5.25**2))
    assert effective_count(np.zeros(7)) == 7


def test_autocorrelated_residuals_count_as_the_variance_of_their_mean_square_says():
    kept, generator = 0.9, np.random.default_rng(2)
    series = np.zeros((400, 500))
    for k in range(1, 500):
        series[:, k] = kept * series[:, k - 1] + np.sqrt(1 - kept**2) * generator.standard_normal(400)
    series = series[:, 100:]
    worth = 2 / np.var(np.mean(series**2, axis=1))  # Of independent ones the mean square has the variance 2/n
    assert np.median([effective_count(each) for each in series]) == pytest.approx(worth, rel=0.25)


@pytest.mark.parametrize("starts", [{"w": 0.0}, {"w": None}])
def test_what_laws_leave_is_compared_in_measured_states_whatever_latent_states_they_have(delayed, starts):
    plain, latent = (approximation._constants(each) for each in (delayed, with_starts(delayed, starts)))
    assert len(latent) == len(plain) == 1
    np.testing.assert_array_equal(np.concatenate(latent[0]), np.concatenate(plain[0]))
