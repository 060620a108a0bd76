"""A state that was measured on some objects only is fitted with the law on the others."""

import numpy as np
import pytest
from scipy.linalg import expm

import commonlaw as cl
from commonlaw.law.parameters import standard_errors
from tests.refusals import refused

TIMES, NOISE = np.linspace(0, 8, 50), 0.01
TRUTH = ((4.0, 0.1), (5.0, 0.2), (3.0, 0.15))


def swings(measured=(True, True, False)):
    """Angle and rate of pendulums with small swings; of some the angle alone."""
    generator, states = np.random.default_rng(0), []
    for (stiffness, drag), both in zip(TRUTH, measured, strict=True):
        matrix = np.array([[0.0, 1.0], [-stiffness, -drag]])
        own = np.array([expm(matrix * t) @ [1.0, 0.0] for t in TIMES])
        own += NOISE * generator.standard_normal(own.shape)
        own[:, 1] += 0.0 if both else np.nan
        states.append(own)
    return cl.Trials.from_arrays([TIMES] * 3, states, object=["a", "b", "c"], names=["theta", "omega"])


@pytest.fixture(scope="module")
def law():
    return cl.discover(swings(), library="poly:1", order=1)


def test_the_law_of_all_objects_is_found_with_true_errors(law):
    assert law.structure == ("theta' = a omega", "omega' = b theta + c omega")
    found, errors = law.coefficients[:, law.support], standard_errors(law)[:, law.support]
    truth = np.array([(1.0, -stiffness, -drag) for stiffness, drag in TRUTH])
    assert (abs(found - truth) < 4 * errors).all()
    assert (errors < 0.02 * abs(truth) + 0.005).all()


def test_forecasts_begin_with_the_unmeasured_state_that_the_law_says(law):
    trials = swings()
    forecast = law.predict(trials, start=15)
    errors = forecast.errors().set_index(["object", "state"])["rms error"]
    assert errors["c", "theta"] < 2 * NOISE
    assert np.isnan(errors["c", "omega"])
    truth = swings((True, True, True))[2].states[:, 1]
    assert np.sqrt(np.mean((forecast.trajectories[2].states[:, 1] - truth) ** 2)) < 3 * NOISE
    assert law.assess(trials).usable


def test_a_state_that_no_trial_has_is_refused():
    with refused("state-with-gaps", state="omega", measured=0, samples=50, where="a, trial 1"):
        swings((False, False, False))
