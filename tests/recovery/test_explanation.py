"""A law that explains whole trials is preferred to process noise that makes up for what a law lacks."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.diagnostics import OutcomeKind
from commonlaw.law.parameters import named_parameters

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
    law = cl.discover(delayed, order=1, library="poly:1")
    assert {"T", "u"} <= set(np.array(law.terms.names)[law.support[0]])
    assert not law.uncertainty.error_model.of_law
    assert law.predict(delayed, start="all").score() > 0.98
    (lack,) = (diagnostic for diagnostic in law.diagnostics if diagnostic.kind is OutcomeKind.APPROXIMATION)
    assert lack.code == "lack-of-fit"
    verdict = law.assess(delayed)
    assert (verdict.exact, verdict.none_exact) == (False, True)


def test_a_fit_without_process_noise_is_the_answer_where_it_explains_whole_trials_better(delayed):
    options = {"input_interpolation": "held", "huber_threshold": np.inf}
    law = cl.fit("T' = (K u - T)/tau", delayed, **options)
    white = cl.fit("T' = (K u - T)/tau", delayed, errors="white", **options)
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


@pytest.mark.slow
def test_no_latent_state_is_taken_for_autocorrelated_errors():
    generator, times, cups = np.random.default_rng(4), np.linspace(0, 6, 40), list[np.ndarray]()
    for rate, start in ((0.3, 80.0), (0.5, 60.0), (0.8, 75.0)):
        errors = np.zeros(40)
        errors[0] = generator.normal()
        for j in range(1, 40):
            errors[j] = 0.8 * errors[j - 1] + 0.6 * generator.normal()
        cups.append(20 + (start - 20) * np.exp(-rate * times) + errors)
    law = cl.discover(cl.Trials.from_arrays([times] * 3, cups, object=["a", "b", "c"], names=["T"]), order=1)
    assert law.structure == ("T' = a + b T",)
