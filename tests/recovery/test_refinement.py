"""A law's coefficients fitted to its trajectories, beside SciPy's least squares on the measurements themselves."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

import commonlaw as cl
from commonlaw import datasets
from commonlaw.diagnostics import Diagnostic
from commonlaw.inference.fit import covariance
from commonlaw.law import select_objects
from commonlaw.law.law import object_index
from commonlaw.law.parameters import standard_errors
from tests.refusals import refused
from tests.simulations import solved

NOISE = 0.3
OWN = {"partial_pooling": False}


@pytest.fixture(scope="module")
def prey():
    return datasets.lotka_volterra(noise=NOISE, trials=2, samples=80)


@pytest.fixture(scope="module")
def by_rates(prey):
    return cl.discover(
        prey,
        library="terms:x,y,x*y",
        method=cl.DerivativeRegression(differentiation="spline", solver="group-stlsq:0.15"),
        order=1,
    )


def shooting(trials, truth):
    """Coefficients and their standard errors by least squares from one start a trial, integrated by SciPy."""
    times, size = trials[0].times, len(trials)

    def residuals(parameters):
        a, b, c, d = parameters[:4]
        starts = parameters[4:].reshape(size, 2)
        rest = []
        for start, trial in zip(starts, trials, strict=True):
            states = solved(lambda _, z: [a * z[0] + b * z[0] * z[1], c * z[1] + d * z[0] * z[1]], start, times)
            rest.append((states - trial.states) / NOISE)
        return np.concatenate(rest).ravel()

    found = least_squares(residuals, [*truth, *np.concatenate([trial.states[0] for trial in trials])], method="lm")
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    return found.x[:4], np.sqrt(np.diag(covariance))[:4]


def own(law, values):
    """The coefficients of x and x*y in x', then of y and x*y in y'."""
    x, y, both = (law.terms.index(name) for name in ("x", "y", "x*y"))
    return np.array([values[0, x], values[0, both], values[1, y], values[1, both]])


def test_refined_coefficients_are_those_of_shooting(prey, by_rates):
    law = cl.refine(by_rates, prey, noise={"x": NOISE, "y": NOISE}, huber_threshold=np.inf, **OWN)
    name = prey.objects[0]
    expected, errors = shooting(
        prey.of_object(name), own(by_rates, by_rates.coefficients[by_rates.objects.index(name)])
    )
    np.testing.assert_allclose(own(law, law.coefficients[object_index(law, name)]), expected, atol=0.02 * errors.min())
    np.testing.assert_allclose(own(law, standard_errors(law)[0]), errors, rtol=0.05)
    np.testing.assert_array_equal(law.support, by_rates.support)
    assert law.history[-1].stage == "coefficients"


def test_errors_by_drawing_blocks_anew_agree_with_those_of_the_likelihood(prey, by_rates):
    likely, drawn = (
        cl.refine(by_rates, prey, partial_pooling=False, covariance=errors) for errors in ("likelihood", "bootstrap")
    )
    ratios = (standard_errors(drawn) / standard_errors(likely))[:, likely.support]
    assert 0.9 < np.exp(np.mean(np.log(ratios))) < 1.1
    assert np.all((ratios > 0.6) & (ratios < 1.6))
    np.testing.assert_array_equal(likely.coefficients, drawn.coefficients)


def test_blocks_drawn_anew_may_tell_nothing_of_a_term():
    rows = np.random.default_rng(0).standard_normal((60, 3))
    rows[:, 1] = 0
    rows[7, 1] = 1
    found = covariance.bootstrapped([rows], np.array([0, 1]))
    assert np.isfinite(found).all()
    # As by White's sandwich, of blocks of two rows
    library, target = rows[:, :2], rows[:, 2]
    pulls = (library[:, 0] * (target - library @ np.linalg.lstsq(library, target, rcond=None)[0])).reshape(30, 2)
    expected = np.sum(pulls.sum(axis=1) ** 2) / np.sum(library[:, 0] ** 2) ** 2
    assert found[0, 0] == pytest.approx(expected, rel=0.25)


def test_known_coefficients_stay_and_other_objects_are_left_out():
    drops = datasets.linear_drag(drag=(-0.1, -0.3, -0.5), trials=1, noise=0.05)
    law = cl.discover(drops, order=2, library="poly:1", known={"1": -9.8})
    some = drops.select(object=list(drops.objects[1:3]))
    refined = cl.refine(law, some)
    assert refined.objects == some.objects
    gravity, slope = refined.terms.index("1"), refined.terms.index("v")
    np.testing.assert_array_equal(refined.coefficients[:, 0, gravity], -9.8)
    errors = standard_errors(refined)
    np.testing.assert_array_equal(errors[:, 0, gravity], 0)
    assert np.all(errors[:, 0, slope] > 0)


def test_what_cannot_be_refined_is_refused(prey, by_rates):
    with refused("discrete-not-refined"):
        cl.refine(replace(by_rates, order=0), prey)
    with refused("unknown-name", kind="object of this law"):
        cl.refine(select_objects(by_rates, by_rates.objects[:1]), prey)
    for setting, message in (
        ({"covariance": "guess"}, Diagnostic("unknown-name", {"kind": "covariance"})),
        ({"huber_threshold": 0.0}, "huber-threshold"),
    ):
        with refused(message):
            cl.refine(by_rates, prey, **setting)
    with refused("columns-differ", kind="states"):
        cl.refine(by_rates, datasets.linear_drag())
    own = by_rates.coefficients.copy()
    own[1, 0, by_rates.terms.index("x")] = 0
    with refused("refine-own-terms"):
        cl.refine(replace(by_rates, coefficients=own), prey)
    with refused("noise-missing"):
        cl.refine(by_rates, prey, noise={"x": 1.0})


@pytest.mark.slow
def test_more_terms_fit_no_worse_also_where_they_are_much_alike():
    # Of balls that fall from rest v^2 is nearly a function of x, and large model errors leave coefficients undetermined
    drops = datasets.linear_drag(noise=0.1, seed=1)

    def misfit(equation):
        frame = cl.fit(equation, drops, noise={"x": 0.1}, errors="white").residuals(drops).to_frame()
        return float(np.sum((frame["x"] - frame["x fitted"]) ** 2)) / 0.1**2

    fewer = misfit("x'' = a + b v")
    assert 0.95 * fewer < misfit("x'' = a + b v + c x + d v^2 + k x v") < fewer
