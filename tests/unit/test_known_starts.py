"""Latent states, with known starts: doses that are absorbed, compartments, the susceptible."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.inference.fit.latent_initialization import _Object
from commonlaw.law import from_json, to_json, to_script
from commonlaw.law.parameters import named_parameters
from commonlaw.library import Variables, parse_library
from tests.refusals import refused
from tests.unit.trajectories import trial

TIMES = np.array([0, 0.25, 0.5, 0.75, 1, 1.5, 2, 3, 4, 6, 8, 10, 12.0])
ONE = "depot' = -ka depot; conc' = ka depot/V - k conc"
TWO = "depot' = -ka depot; conc' = ka depot/V - b conc + q slow; slow' = conc - h slow"
TYPICAL = {ONE: (1.5, 20.0, 0.3), TWO: (3.0, 20.0, 0.6, 0.1, 0.2)}
PARAMETERS = {ONE: ("ka", "V", "k"), TWO: ("ka", "V", "b", "q", "h")}
WHITE = {"errors": "white", "huber_threshold": np.inf, "partial_pooling": False}


def concentration(equations, values, dose, first=0.0):
    """Concentrations at the sample times, by an integrator of SciPy."""

    def rates(_, state):
        depot, conc, slow = state
        if equations == ONE:
            ka, volume, k = values
            return [-ka * depot, ka * depot / volume - k * conc, 0.0]
        ka, volume, b, q, h = values
        return [-ka * depot, ka * depot / volume - b * conc + q * slow, conc - h * slow]

    start, span = [dose, first, 0.0], (0, TIMES[-1])
    return solve_ivp(rates, span, start, t_eval=TIMES, rtol=1e-10, atol=1e-12, method="LSODA").y[1]


def people(equations, noise, seed=0, count=6):
    """Parameters, doses and trials of people whose concentration alone is measured."""
    generator = np.random.default_rng(seed)
    truth = np.array(TYPICAL[equations]) * np.exp(0.15 * generator.standard_normal((count, len(TYPICAL[equations]))))
    doses = 100 * np.exp(0.2 * generator.standard_normal(count))
    measured = [concentration(equations, *own) for own in zip(truth, doses, strict=True)]
    measured = [own + noise * generator.standard_normal(len(TIMES)) for own in measured]
    names = [f"person {i}" for i in range(count)]
    properties = {name: {"dose": dose} for name, dose in zip(names, doses, strict=True)}
    trials = cl.Trials.from_arrays(
        [TIMES] * count, measured, object=names, names=["conc"], units={"dose": "mg"}, properties=properties
    )
    return truth, doses, measured, trials


def starts_of(equations):
    return {"depot": "dose"} if equations == ONE else {"depot": "dose", "slow": 0.0}


def by_parameters(law, equations):
    """Values and standard errors, with columns in the order of `PARAMETERS`."""
    parameters = named_parameters(law)
    columns = [parameters.names.index(name) for name in PARAMETERS[equations]]
    return [each[:, columns] for each in (parameters.values, parameters.errors)]


def least_squares_of(equations, dose, measured, begin):
    """Least squares of parameters and of the first concentration, and their standard errors over the noise."""
    accuracy = dict.fromkeys(("xtol", "ftol", "gtol"), 1e-12)
    found = least_squares(
        lambda own: concentration(equations, own[:-1], dose, own[-1]) - measured,
        np.append(begin, 0.0), x_scale=np.append(begin, 0.1), **accuracy,
    )  # fmt: skip
    return found.x[:-1], np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))[:-1]


@pytest.mark.parametrize(
    ("equations", "accuracy", "noise"),  # Meshes are as fine as the noise asks for
    [
        (ONE, 1e-4, 0.03),
        (TWO, 4e-4, 0.001),
        pytest.param(ONE, 1e-4, 0.001, marks=pytest.mark.slow),
        pytest.param(TWO, 4e-4, 0.03, marks=pytest.mark.slow),
    ],
)
def test_estimates_and_errors_are_those_of_independent_least_squares(equations, accuracy, noise):
    truth, doses, measured, trials = people(equations, noise, count=2)
    law = cl.fit(equations, trials, initial_values=starts_of(equations), noise={"conc": noise}, **WHITE)
    for value, error, *data in zip(*by_parameters(law, equations), doses, measured, truth, strict=True):
        expected, bound = least_squares_of(equations, *data)
        np.testing.assert_allclose(error, noise * bound, rtol=0.03)
        if noise == 0.03:
            assert (abs(value - expected) < 0.05 * error).all()
        else:
            np.testing.assert_allclose(value, expected, rtol=accuracy)


@pytest.fixture(scope="module")
def trials():
    return people(ONE, 0.1, count=4)[3]


@pytest.fixture(scope="module")
def law(trials):
    return cl.fit(ONE, trials, initial_values={"depot": "dose"})


def test_it_says_what_was_given_and_what_fits_as_well(law):
    assert ("start", "depot = dose at t = 0") in [(each.stage, each.choice) for each in law.history]
    assert law.schema.units["depot"] == "mg"
    (outcome,) = [diagnostic for diagnostic in law.diagnostics if diagnostic.kind == "ambiguous"]
    ka, _, k = by_parameters(law, ONE)[0][0]
    assert ka > k
    swapped = [float(word.split(" = ")[1]) for word in outcome.text.split(": ")[1].split(". ")[0].split(", ")]
    assert (swapped[0], swapped[2]) == pytest.approx((k, ka), rel=0.1)


def test_a_saved_law_forecasts_tables_without_the_state(law, trials):
    again = from_json(to_json(law))
    assert str(again) == str(law)
    forecast = again.predict(trials, return_std=True)
    assert [trajectory.states[0, 1] for trajectory in forecast.trajectories] == pytest.approx(
        [trials.properties[name]["dose"] for name in trials.objects], rel=1e-3
    )
    assert set(forecast.errors()["state"]) == {"conc"}
    assert forecast.score() > 0.99
    verdict = again.assess(trials)
    assert verdict.usable
    assert [state_error.state for state_error in verdict.state_errors] == ["conc"]
    assert "states=['conc']" in to_script(law)
    assert "initial_values={'depot': 'dose'}" in to_script(law)


def test_doses_are_taken_in_the_units_of_the_law(law, trials):
    grams = {name: {"dose": attribute["dose"] / 1000} for name, attribute in trials.properties.items()}
    schema = cl.Schema(("conc",), units={"dose": "g"})
    others = cl.Trials(trials.trials, schema, grams)
    one, other = law.predict(trials), law.predict(others)
    np.testing.assert_allclose(one.trajectories[0].states, other.trajectories[0].states, rtol=1e-6)


def test_refining_keeps_to_the_coefficients(law, trials):
    np.testing.assert_allclose(cl.refine(law, trials).coefficients, law.coefficients, rtol=1e-6)


def test_starts_are_numbers_for_all_or_each_object_too(law, trials):
    doses = {name: attribute["dose"] for name, attribute in trials.properties.items()}
    each = cl.fit(ONE, trials, initial_values={"depot": doses})
    np.testing.assert_array_equal(each.coefficients, law.coefficients)
    some = trials.select(object=trials.objects[0])
    one, other = (cl.fit(ONE, some, initial_values={"depot": start}) for start in ("dose", doses[trials.objects[0]]))
    np.testing.assert_array_equal(one.coefficients, other.coefficients)


@pytest.mark.parametrize(
    ("equations", "starts", "settings", "message"),
    [
        (TWO, {"depot": 100.0}, {}, Diagnostic("equation-without-column", {"name": "slow"})),
        (ONE, {"dopot": 100.0}, {}, Diagnostic("unknown-name", {"kind": "state of the equations", "name": "dopot"})),
        (ONE, {"depot": "dos"}, {}, Diagnostic("unknown-name", {"kind": "property", "name": "dos"})),
        (ONE, {"depot": np.nan}, {}, Diagnostic("initial-value-not-finite", {"state": "depot", "object": "person 0"})),
        (ONE, {"depot": {"person 0": 1.0}}, {}, Diagnostic("initial-value-not-finite", {"object": "person 1"})),
        (ONE, {"depot": 100.0}, {"guesses": {"k": 1.0}}, "guess-with-latent-states"),
        (ONE, {"depot": 100.0}, {"noise": {"depot": 1.0}}, Diagnostic("noise-of-latent", {"name": "depot"})),
        (ONE, {"depot": 100.0}, {"log_states": ["depot"]}, Diagnostic("log-states-latent", {"state": "depot"})),
        (ONE.replace("'", "''"), {"depot": 100.0}, {}, "latent-of-second-order"),
        (TWO.replace("= conc -", "= p conc -"), {"depot": 100.0, "slow": 0.0}, {}, "latent-scale-of-zero"),
    ],
)
def test_what_cannot_be_fitted_is_refused_by_name(trials, equations, starts, settings, message):
    with refused(message):
        cl.fit(equations, trials, initial_values=starts, **settings)


def test_curves_that_are_far_from_any_law_leave_much_without_a_warning():
    terms = parse_library("terms:x").bind(Variables(("x",)))
    model = SimpleNamespace(terms=terms)
    one = SimpleNamespace(model=model, group=[trial(np.arange(3.0), np.ones((3, 1)))], started=np.array([False]))
    far = [(np.full((3, 1), 1e200), np.ones((3, 1)))]
    assert _Object._along(one, far, np.array([[1.0]]))[0] == np.inf


def test_models_without_unknowns_are_tested_for_outliers():
    times = np.linspace(0, 1, 20)
    x = np.exp(times) + 0.01 * np.random.default_rng(0).standard_normal((2, 20))
    trials = cl.Trials.from_arrays([times, times], list(x), names=["x"])
    law = cl.fit("x' = min(x, 20)", trials, initial_values={"x": 1.0}, huber_threshold=3.0)
    assert law.uncertainty.noise == pytest.approx([0.01], rel=0.3)
