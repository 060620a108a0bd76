"""Laws that somebody has in mind, their coefficients found in trials."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

import commonlaw as cl
from commonlaw import datasets
from commonlaw.diagnostics import Diagnostic
from commonlaw.law import from_json, select_objects, to_json
from commonlaw.law.parameters import named_parameters, standard_errors
from tests.refusals import refused


@pytest.fixture(scope="module")
def drops():
    return datasets.linear_drag(drag=(-0.1, -0.3), trials=1, noise=0.05)


@pytest.fixture(scope="module")
def fitted(drops):
    return cl.fit("x'' = -9.8 - k v", drops)


def test_numbers_in_the_text_stay(fitted):
    constant, drag = (fitted.terms.index(name) for name in ("1", "v"))
    assert (fitted.coefficients[:, 0, constant] == -9.8).all()
    assert (standard_errors(fitted)[:, 0, constant] == 0).all()
    assert (np.abs(fitted.coefficients[:, 0, drag] - [-0.1, -0.3]) < 4 * standard_errors(fitted)[:, 0, drag]).all()


def test_parameters_of_the_text_name_what_was_found(fitted):
    assert fitted.structure == ("x'' = -9.8 - k v",)
    assert named_parameters(fitted).names == ("k",)
    values, errors = named_parameters(fitted).values, named_parameters(fitted).errors
    np.testing.assert_array_equal(values, -fitted.coefficients[:, 0, 1:])
    assert (errors > 0).all()
    one = select_objects(fitted, fitted.objects[:1])
    assert f"k [1/s] = {values[0, 0]:.2f}" in str(one)
    assert "x'' = -9.8 - k v" in str(fitted)
    history = fitted.provenance.history
    assert (history[0].stage, history[0].choice) == ("equations", "x'' = -9.8 - k v")


def test_a_coefficient_that_divides_has_the_error_of_its_inverse(drops, fitted):
    parameters, others = (named_parameters(each) for each in (cl.fit("x'' = -9.8 - v/tau", drops), fitted))
    np.testing.assert_allclose(parameters.values, 1 / others.values, rtol=1e-6)
    np.testing.assert_allclose(parameters.errors, others.errors / others.values**2, rtol=1e-6)


def test_a_saved_law_whose_terms_are_not_those_of_its_equations_is_refused(fitted):
    for after, message in (("- k x", "law-terms-and-equations"), ("- k v)", "parenthesis-not-opened")):
        with refused(message):
            from_json(to_json(fitted).replace("- k v", after))


def test_several_states_and_gaps():
    trials = datasets.lotka_volterra(noise=0.1, trials=1, samples=60)
    first = trials[0]
    states = first.states.copy()
    states[5, 0] = states[20:23, 1] = np.nan
    gaps = trials.with_trials([replace(first, states=states)])
    law = cl.fit(["x' = a x - b x y", "y' = -c y + d x y"], gaps)
    parameters, truth = named_parameters(law), datasets.truth_of("lotka-volterra")
    true = [[truth.coefficients[0, i, truth.terms.index(term)] for term in ("xy"[i], "x y")] for i in range(2)]
    assert parameters.names == ("a", "b", "c", "d")
    assert (np.abs(parameters.values[0] - np.abs(true).ravel()) < 4 * parameters.errors[0]).all()


def test_a_law_in_discrete_time_is_fitted_to_the_next_samples():
    states = [0.3]
    for _ in range(60):
        states.append(3.7 * states[-1] * (1 - states[-1]))
    trials = cl.Trials.from_arrays(np.arange(61.0), states)
    law = cl.fit("x[k+1] = r x (1 - x)", trials)
    assert named_parameters(law).values == pytest.approx(3.7)
    assert named_parameters(cl.fit("x[k+1] = r x - 3.7 x^2", trials)).values == pytest.approx(3.7)
    with refused("discrete-without-option", refused="noise"):
        cl.fit("x[k+1] = r x", trials, noise={"x": 0.1})


def test_a_coefficient_that_all_objects_have_in_common_is_that_of_a_fit_of_all_together():
    """A' = -k1 A; B' = k1 A - k2 B with k1 of each object and one k2, against least squares of all measurements."""
    times, source = np.linspace(0, 8, 25), np.random.default_rng(0)
    rates, noise = (0.9, 0.3, 1.3), 0.02

    def solution(k1, k2):
        a = np.exp(-k1 * times)
        return np.column_stack([a, k1 / (k2 - k1) * (a - np.exp(-k2 * times))])

    measured = [solution(k1, 0.25) + noise * source.standard_normal((25, 2)) for k1 in rates]
    trials = cl.Trials.from_arrays([times] * 3, measured, object=["a", "b", "c"], names=["A", "B"])
    law = cl.fit("A' = -k1 A; B' = k1 A - k2 B", trials, shared="k2", errors="white", noise={"A": noise, "B": noise})

    def left(p):
        starts, own = p[4:].reshape(3, 2), []
        for k1, (a, b), states in zip(p[1:4], starts, measured, strict=True):
            found = a * solution(k1, p[0])
            found[:, 1] += b * np.exp(-p[0] * times)
            own.append(found - states)
        return np.concatenate(own).ravel()

    fit = least_squares(left, [0.25, *rates, *[1.0, 0.0] * 3])
    error = noise * np.sqrt(np.linalg.inv(fit.jac.T @ fit.jac)[0, 0])
    parameters = named_parameters(law)
    own, shared = (parameters.names.index(name) for name in ("k1", "k2"))
    assert np.ptp(parameters.values[:, shared]) < 1e-12
    assert parameters.values[0, shared] == pytest.approx(fit.x[0], abs=0.1 * error)
    assert parameters.errors[0, shared] == pytest.approx(error, rel=0.05)
    assert np.ptp(parameters.values[:, own]) > 0.5
    with refused("unknown-name", name="k3"):
        cl.fit("A' = -k1 A; B' = k1 A - k2 B", trials, shared="k3")


@pytest.mark.parametrize(
    ("equations", "message"),
    [
        ("y = c x (1 + x)", "no-equation"),
        ("x' = u - k x(t - d)", Diagnostic("equation-with-delay", {"name": "x"})),
        ("x' = -k x if x > 1", "condition-syntax"),
        ("y = 2 x; x' = -k x; u' = -a u", Diagnostic("equation-of-input", {"name": "u"})),
    ],
)
def test_what_equations_cannot_say_is_refused_in_one_sentence(equations, message):
    times = np.linspace(0, 5, 20)
    trials = cl.Trials.from_arrays(times, np.exp(-times), inputs=np.sin(times), names=["x", "u"])
    with refused(message):
        cl.fit(equations, trials)


def test_a_law_is_evaluated_without_the_time_where_no_term_depends_on_it():
    ratio = cl.Law.from_text("s' = -V s/(K + s)", {"V": 2.0, "K": 1.0})
    np.testing.assert_allclose(ratio.rhs("object", [[1.0]]), [[-1.0]])
    np.testing.assert_allclose(ratio.rhs("object", [[1.0, 5.0]]), [[-1.0]])
    driven = cl.Law.from_text("x' = A sin(w t) - x", {"A": 1.0, "w": 2.0})
    for law, values in ((driven, [[1.0]]), (ratio, [[1.0, 0.0, 0.0]]), (ratio, [1.0, 2.0])):
        with refused("variables-shape"):
            law.rhs("object", values)


def test_coefficients_keep_to_bounds_as_in_bounded_least_squares():
    """Of two objects one has its rate at the bound; the other is as without it."""
    times, source = np.linspace(0, 10, 40), np.random.default_rng(0)
    measured = [2 * np.exp(-0.5 * times), 3 * np.exp(-0.3 * times)]
    measured = [own + 0.02 * source.standard_normal(40) for own in measured]
    trials = cl.Trials.from_arrays([times] * 2, measured, object=["p", "q"], names=["x"])
    white = {"errors": "white", "noise": {"x": 0.02}, "partial_pooling": False, "huber_threshold": np.inf}
    law, free = (cl.fit(text, trials, **white) for text in ("x' = a - k x; 0 < k < 0.4", "x' = a - k x"))

    def left(p):
        start, a, k = p
        return (start - a / k) * np.exp(-k * times) + a / k - measured[0]

    fit = least_squares(left, [2.0, 0.0, 0.35], bounds=([-10, -10, 0], [10, 10, 0.4]), xtol=1e-12)
    parameters = named_parameters(law)
    values, errors = parameters.values, parameters.errors
    a, k = parameters.names.index("a"), parameters.names.index("k")
    assert values[0, k] == 0.4
    assert errors[0, k] == 0
    assert values[0, a] == pytest.approx(fit.x[1], abs=0.1 * errors[0, a])
    alone = named_parameters(free)
    np.testing.assert_allclose(values[1], alone.values[1], atol=1e-4 * errors[1].min())
    np.testing.assert_allclose(errors[1], alone.errors[1], rtol=1e-4)
    (outcome,) = (diagnostic for diagnostic in law.diagnostics if diagnostic.kind == "bound")
    assert (outcome.where, "95 %: down to 0.39" in outcome.text) == ("p", True)
    for setting in ({"scheme": "collocation"}, {"partial_pooling": True}, {"errors": "random-walk"}):
        with refused("estimate-out-of-bounds", parameter="k", bound="0 < k < 0.4"):
            cl.fit("x' = a - k x; 0 < k < 0.4", trials, **{**white, **setting})


def test_quotients_of_coefficients_keep_to_bounds_as_in_bounded_least_squares():
    times = np.linspace(0, 10, 40)
    measured = 1 + 2 * np.exp(-0.5 * times) + 0.02 * np.random.default_rng(0).standard_normal(40)
    trials = cl.Trials.from_arrays([times], [measured], names=["x"])
    law = cl.fit("x' = -k (x - T); 1.1 < T < 6", trials, errors="white")
    fit = least_squares(lambda p: 1.1 + (p[0] - 1.1) * np.exp(-p[1] * times) - measured, [3.0, 0.5], xtol=1e-12)
    parameters = named_parameters(law)
    error = np.sqrt(2 * fit.cost / 38 * np.linalg.inv(fit.jac.T @ fit.jac)[1, 1])
    by_name = dict(zip(parameters.names, zip(parameters.values[0], parameters.errors[0], strict=True), strict=True))
    assert by_name["T"] == (pytest.approx(1.1), 0)
    assert by_name["k"] == (pytest.approx(fit.x[1], rel=1e-5), pytest.approx(error, rel=1e-3))


def test_a_parameter_that_is_divided_by_is_refused_where_its_best_value_is_below_zero():
    times, noise = np.linspace(0, 10, 60), np.random.default_rng(0)
    driven = np.exp(-0.3 * times) - 0.5 * np.where(times > 3, 1 - np.exp(-0.3 * (times - 3)), 0)
    table = {"t": times, "x": driven + 0.01 * noise.standard_normal(60), "u": (times > 3).astype(float)}
    trials = cl.Trials.from_frame(table, time="t", states=["x"], inputs=["u"])
    with refused("estimate-out-of-bounds", parameter="V", bound="V > 0"):
        cl.fit("x' = -k x + u/V; V > 0", trials)
