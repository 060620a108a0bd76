import numpy as np
import pytest

import commonlaw as cl
from tests.refusals import refused

TIMES = np.linspace(0, 6, 61)
NAMES = ["x", "y"]
TRUE = {"a": 1.0, "b": 0.5, "c": 0.3, "d": 0.8}
FIT = {"library": "poly:2", "order": 1}


@pytest.fixture(scope="module")
def measured():
    """Return states of two trials, and noisy derivatives."""
    law, random = cl.Law.from_text("x' = a x - b x y; y' = c x y - d y", TRUE), np.random.default_rng(0)
    states = [law.simulate(TIMES, start)["object"].states for start in ([1.0, 2.0], [2.0, 1.0])]
    rates = [np.column_stack([x - 0.5 * x * y, 0.3 * x * y - 0.8 * y]) for x, y in (state.T for state in states)]
    return states, [rate + 0.01 * random.standard_normal(rate.shape) for rate in rates]


def trials_of(states, names=NAMES):
    return cl.Trials.from_arrays([TIMES] * len(states), states, names=names)


def test_derivatives_that_are_given_are_fitted_by_least_squares(measured):
    states, rates = measured
    law = cl.discover(trials_of(states), x_dot=rates, **FIT)
    assert law.structure == ("x' = a x + b x y", "y' = c y + d x y")
    (x, y), (of_x, of_y) = np.concatenate(states).T, np.concatenate(rates).T
    expected = (
        np.linalg.lstsq(np.column_stack([x, x * y]), of_x)[0],
        np.linalg.lstsq(np.column_stack([y, x * y]), of_y)[0],
    )
    np.testing.assert_allclose(law.coefficients[0][law.support], np.concatenate(expected), rtol=1e-9)


def test_they_are_given_by_state_or_as_columns(measured):
    states, rates = measured
    whole = cl.discover(trials_of(states), x_dot=rates, **FIT)
    by_state = {name: [rate[:, j] for rate in rates] for j, name in enumerate(NAMES)}
    both = [np.hstack(pair) for pair in zip(states, rates, strict=True)]
    columns = cl.discover(trials_of(both, [*NAMES, "u", "w"]), x_dot={"x": "u", "y": "w"}, **FIT)
    for law in (cl.discover(trials_of(states), x_dot=by_state, **FIT), columns):
        np.testing.assert_array_equal(law.coefficients, whole.coefficients)
    assert columns.schema.states == ("x", "y")
    one, listed = (cl.discover(trials_of(states[:1]), x_dot=each, **FIT) for each in (rates[0], rates[:1]))
    np.testing.assert_array_equal(one.coefficients, listed.coefficients)


def test_derivatives_that_do_not_fit_are_refused(measured):
    states, rates = measured
    trials = trials_of(states)
    for code, given in {
        "derivatives-of-trials": rates[0],
        "derivatives-shape": [rate[1:] for rate in rates],
        "derivatives-not-finite": [np.where(rate == rate[5, 0], np.nan, rate) for rate in rates],
        "derivatives-missing": {"x": [rate[:, 0] for rate in rates]},
    }.items():
        with refused(code):
            cl.discover(trials, x_dot=given, **FIT)
    for method in (cl.TrajectoryLikelihood(), cl.WeakRegression()):
        with refused("derivatives-unsupported"):
            cl.discover(trials, x_dot=rates, method=method, **FIT)
    with refused("derivatives-unsupported", order=2):
        cl.discover(trials, x_dot=rates, library="poly:2", order=2)


def test_each_equation_may_have_its_own_library(measured):
    states, rates = measured
    libraries = {"x": "poly:1", "y": cl.library.ExpressionLibrary("y", "x*y", "sin(x)")}
    law = cl.discover(
        trials_of(states), library=libraries, method=cl.DerivativeRegression(solver="stlsq:0"), x_dot=rates
    )
    (x, y), targets = np.concatenate(states).T, np.concatenate(rates).T
    for j, columns in enumerate(({"1": x**0, "x": x, "y": y}, {"y": y, "x y": x * y, "sin(x)": np.sin(x)})):
        expected = dict(zip(columns, np.linalg.lstsq(np.column_stack([*columns.values()]), targets[j])[0], strict=True))
        for k, name in enumerate(law.terms.names):
            assert law.coefficients[0, j, k] == pytest.approx(expected.get(name, 0.0), rel=1e-9)


def test_libraries_of_equations_that_do_not_fit_are_refused(measured):
    trials = trials_of(measured[0])
    with refused("library-of-equation-missing", states=["y"]):
        cl.discover(trials, library={"x": "poly:2"})
    with refused("library-of-equation-parametric", state="y"):
        cl.discover(trials, library={"x": "poly:2", "y": "poly:1 + saturating"})
