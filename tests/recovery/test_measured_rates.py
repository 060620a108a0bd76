"""In a law of second order, a measured column that is the rate of another is no state of its own."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import savgol_filter

import commonlaw as cl
from commonlaw.discovery.measured_rates import is_computed, measured_rates
from commonlaw.law import from_json, to_json
from commonlaw.law.alignment import matched
from commonlaw.law.parameters import named_parameters, standard_errors
from tests.refusals import refused
from tests.simulations import solved

TRUTH = {"a": (9.0, 0.2), "b": (6.0, 0.1)}
TIMES, NOISE = np.linspace(0, 6, 120), 0.005
NAMES = ["theta", "omega"]


def pendulum(measured=(True, True), noise=NOISE, units=None, of=lambda theta, omega: (theta, omega)):
    """Two damped pendulums with large swings: angles, and of some the rate."""
    generator, states = np.random.default_rng(1), []
    for numbers, both in zip(TRUTH.values(), measured, strict=True):
        swing = solved(lambda _, y, k, c: [y[1], -k * np.sin(y[0]) - c * y[1]], [1.2, 0.0], TIMES, *numbers)
        own = np.column_stack(of(*swing.T)) + noise * generator.standard_normal((len(TIMES), 2)) * [1, 3]
        own[:, 1] += 0.0 if both else np.nan
        states.append(own)
    return cl.Trials.from_arrays([TIMES] * 2, states, object=[*TRUTH], names=NAMES, units=units)


@pytest.fixture(scope="module", params=[(True, True), (True, False)], ids=["everywhere", "in one of two"])
def found(request):
    trials = pendulum(request.param)
    return trials, cl.discover(trials, order=2, library="terms:sin(theta),omega,theta")


def test_the_law_is_of_the_angle_alone_and_calls_its_rate_by_the_column(found):
    _, law = found
    assert law.structure == ("theta'' = a sin(theta) + b omega",)
    errors, truth = standard_errors(law)[:, law.support], np.array([(-k, -c) for k, c in TRUTH.values()])
    columns = [law.terms.names.index(name) for name in ("sin(theta)", "omega")]
    assert (abs(law.coefficients[:, 0, columns] - truth) < 4 * errors).all()
    assert (errors < 0.1).all()


def test_trials_that_still_have_the_column_are_forecast_scored_and_judged(found):
    trials, law = found
    law = from_json(to_json(law))
    alone = cl.Trials.from_arrays(
        [TIMES] * 2, [trial.states[:, 0] for trial in trials], object=[*TRUTH], names=["theta"]
    )
    forecast = law.predict(trials, start=30)
    np.testing.assert_array_equal(forecast.trajectories[1].states, law.predict(alone, start=30).trajectories[1].states)
    assert law.predict(trials).score() == law.predict(alone).score() > 0.99
    assert law.assess(trials).usable
    assert matched(law, trials).notes[-1] == "left out: omega is the rate of theta"


def test_samples_that_have_the_rate_alone_are_left_out(found):
    law = found[1]
    states = pendulum()[0].states.copy()
    states[::2, 0] = np.nan
    states[0] = 0.0
    states[-1] = np.nan
    trials = pendulum()
    given = trials.with_trials([replace(trials[0], states=states)])
    assert len(matched(law, given)[0]) == 61  # Every second one, of which the last is to be forecast, and the first
    lacking = replace(trials[0], states=trials[0].states * [np.nan, 1.0])
    with refused("state-not-in-trial", where="a, trial 1"):
        matched(law, trials.with_trials([lacking]))


@pytest.mark.parametrize(
    ("of", "units"),
    [
        (lambda theta, omega: (theta, 1.05 * omega), None),
        (lambda theta, omega: (theta, omega + 0.05), None),
        (lambda theta, omega: (theta, -omega), None),
        (lambda theta, omega: (theta, omega * abs(omega)), None),
        (lambda theta, omega: (theta, np.gradient(omega, TIMES)), None),
        (lambda theta, omega: (0 * theta, 0 * omega), None),
        (lambda theta, omega: (theta, omega), {"theta": "m", "omega": "m", "t": "s"}),
        (lambda theta, omega: (theta, omega), {"theta": "degree", "omega": "rad/s", "t": "s"}),
    ],
    ids=["slope", "offset", "sign", "not linear", "second derivative", "no motion", "unit", "number in another unit"],
)
def test_a_column_is_no_rate_that_departs_from_it_by_more_than_noise(of, units):
    assert measured_rates(pendulum(of=of, units=units)) == {}


@pytest.mark.parametrize(
    "of",
    [
        lambda theta: np.gradient(theta, TIMES),
        lambda theta: np.gradient(theta, TIMES).round(2),
        lambda theta: savgol_filter(theta, 11, 3, deriv=1, delta=TIMES[1]),
    ],
    ids=["central differences", "rounded", "Savitzky-Golay filter"],
)
def test_a_computed_rate_is_told_from_a_measured_one(of):
    measured = pendulum()
    states = [np.column_stack([each.states[:, 0], of(each.states[:, 0])]) for each in measured]
    computed = cl.Trials.from_arrays([TIMES] * 2, states, object=[*TRUTH], names=NAMES)
    assert is_computed(computed, *NAMES)
    assert not is_computed(measured, *NAMES)
    assert not is_computed(pendulum(noise=0.0), *NAMES)


@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-3, 0.02])
def test_rates_are_told_whatever_the_noise(noise):
    assert measured_rates(pendulum(noise=noise)) == {"theta": "omega"}


def test_units_of_a_rate_are_converted():
    in_degrees = pendulum(
        of=lambda theta, omega: (np.degrees(theta), 60 * omega), units={"theta": "deg", "omega": "rad/min", "t": "s"}
    )
    assert measured_rates(in_degrees) == {"theta": "omega"}


def test_a_state_that_some_trial_lacks_keeps_its_rate_as_a_state():
    trials = pendulum()
    other = replace(trials[1], states=trials[1].states * [np.nan, 1.0])
    assert measured_rates(trials.with_trials([trials[0], other])) == {}


def test_of_states_that_are_rates_of_each_other_one_stays():
    same = np.exp(TIMES / 3) * np.ones((2, 1))
    assert measured_rates(cl.Trials.from_arrays(TIMES / 3, same.T, names=["x", "y"])) == {"x": "y"}


def test_equations_of_the_angle_are_fitted_to_trials_that_have_its_rate_too():
    law = cl.fit("theta'' = -k sin(theta) - c omega", pendulum((True, False)), errors="white")
    parameters = named_parameters(law)
    values, errors = parameters.values, parameters.errors
    assert (abs(np.array(values) - list(TRUTH.values())) < 4 * np.array(errors)).all()
    assert [diagnostic.kind for diagnostic in law.diagnostics] == ["rates"]


def test_a_rate_that_has_an_equation_of_its_own_stays():
    law = cl.fit("theta'' = -k theta; omega'' = -l omega", pendulum(noise=0.02), errors="white")
    assert law.schema.states == ("theta", "omega")


def test_first_order_keeps_the_rate_as_a_state():
    law = cl.discover(
        pendulum(noise=0.0), library="poly:1", method=cl.DerivativeRegression(solver="stlsq:0.05"), order=1
    )
    assert law.schema.states == ("theta", "omega")
