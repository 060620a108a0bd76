"""Laws with a latent state, found by `discover`."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.law import from_json, to_json, to_script
from commonlaw.law.parameters import named_parameters
from tests.recovery.golden import recovered
from tests.recovery.problems import absorbed, white
from tests.refusals import refused
from tests.simulations import drawn, solved


def epidemic(_, state, b, g):
    susceptible, infected = state
    return [-b * susceptible * infected, b * susceptible * infected - g * infected]


def trials_of(rates, typical, start, end, name, *, samples=25, count=4, noise=0.01, seed=0):
    """Trials of the second state, with parameters that scatter over objects, and these parameters."""
    times, objects = np.linspace(0, end, samples), [f"object {i}" for i in range(count)]
    given = {"noise": noise, "seed": seed}
    values, _, measured = drawn(lambda numbers: solved(rates, start, times, *numbers)[:, 1], typical, count, **given)
    return values, cl.Trials.from_arrays([times] * count, measured, object=objects, names=[name])


@pytest.fixture(scope="module")
def law():
    return recovered("absorbed")[0]


def test_a_depot_is_found_with_its_coefficients(law):
    assert law.structure == ("c' = a c + b u", "u' = d u")
    truth = np.array([(-k, 5 * a, -a) for a, k in ((1.5, 0.3), (1.2, 0.4), (1.8, 0.25), (1.4, 0.35))])
    found, errors = named_parameters(law).values, named_parameters(law).errors
    assert (abs(found - truth) < 4 * errors).mean() > 0.9
    assert (errors < 0.05 * abs(truth)).all()


def test_it_says_what_the_state_does_and_what_fits_alike(law):
    (step,) = [each for each in law.history if each.stage == "latent state"]
    assert step.choice == "u' = d u"
    assert step.reason.startswith("decays from 1, as a depot or a drive does; without it")
    (outcome,) = [diagnostic for diagnostic in law.diagnostics if diagnostic.kind == "not identifiable"]
    assert "c' = a + b c + d u; u' = 1 c, in which it adds up c from 0" in outcome.text


def test_such_a_law_is_saved_and_forecasts_tables_without_the_state(law):
    again, trials = from_json(to_json(law)), absorbed(white(0.01))
    assert str(again) == str(law)
    assert again.predict(trials).score() > 0.999
    assert again.assess(trials).usable
    assert "latent_states=1" in to_script(law)


@pytest.mark.slow
def test_the_susceptible_are_found_by_the_infected():
    truth, trials = trials_of(epidemic, (5e-4, 0.15), [990.0, 10.0], 40, "I", samples=30, count=3)
    law = cl.discover(trials, library="poly:2", latent_states=1, order=1)
    assert law.structure == ("I' = a I + b I u", "u' = c I u")
    parameters = named_parameters(law)
    values, errors = parameters.values, parameters.errors
    b, g = truth.T
    assert (abs(values - np.column_stack([-g, 990 * b, -b])) < 4 * errors).mean() > 0.9


def pendulum(_, state, g, c, force, r):
    drive, angle, rate = state
    return [-r * drive, rate, -g * np.sin(angle) - c * rate + force * drive]


@pytest.mark.slow
def test_errors_in_proportion_choose_among_laws_by_their_likelihood_and_not_by_that_of_a_linearization():
    """Counts of infected people in three towns, with relative errors of 4 %."""
    generator, times, counts = np.random.default_rng(7), np.arange(0, 20.5, 0.5), []
    numbers = {"Abbey": (5200, 1.9, 0.9), "Bere": (2400, 1.6, 0.8), "Corfe": (9100, 2.2, 1.0)}
    for size, b, g in numbers.values():
        infected = solved(epidemic, (size - 5, 5), times, b / size, g)[:, 1]
        counts.append(np.round(infected * (1 + 0.04 * generator.standard_normal(len(times)))))
    trials = cl.Trials.from_arrays([times] * 3, counts, object=[*numbers], names=["infected"])
    law = cl.discover(trials, library="poly:3", latent_states=1, order=1)
    assert law.structure == ("infected' = a infected + b infected u", "u' = c infected u")
    assert law.comparison.query("chosen")["terms"].tolist() == ["infected, infected u", "infected u"]
    truth = np.array([[-g, b, -b / size] for size, b, g in numbers.values()])
    np.testing.assert_allclose(named_parameters(law).values, truth, rtol=0.08)


@pytest.mark.slow
def test_a_slow_drive_of_a_pendulum_is_found_by_its_angle():
    typical, start = (4.0, 0.2, 1.5, 0.25), [1.0, 1.2, 0.0]
    truth, trials = trials_of(pendulum, typical, start, 12, "theta", samples=80, count=4)
    law = cl.discover(trials, order=2, library="terms:1,theta,v,v*abs(v),sin(theta)", latent_states=1)
    assert law.structure == ("theta'' = a v + b sin(theta) + c exp(-r*t)",)
    parameters = named_parameters(law)
    values, errors = parameters.values, parameters.errors
    g, c, force, r = truth.T
    assert (abs(values - np.column_stack([-c, -g, force, r])) < 4 * errors).mean() > 0.9
    (step,) = [each for each in law.history if each.stage == "latent state"]
    assert step.choice == "exp(-r*t)"


def test_what_asks_for_it_in_vain_is_refused():
    trials = absorbed(white(0.01))
    with refused("use-trajectory-likelihood", count=1, method="DerivativeRegression"):
        cl.discover(trials, method=cl.DerivativeRegression(), latent_states=1, order=1, library="poly:3")
    with refused("leave-out", method="DiscreteTimeRegression"):
        cl.discover(trials, latent_states=1, order=0)
    with refused("whole-number", name="latent_states"):
        cl.TrajectoryLikelihood(latent_states=2)
