"""Terms of a user: functions of Python, and properties of the objects inside terms."""

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.law import from_json, to_json, to_script
from commonlaw.law.parameters import standard_errors
from commonlaw.law.tables import coefficients_by_object
from commonlaw.trials import Trials
from tests.refusals import refused
from tests.simulations import simulated, solved

NOISE = 0.05


def drag(v):
    return v * np.abs(v)


def tanh_v(x, v):
    return np.tanh(x) * v


@pytest.fixture(scope="module")
def fitted():
    drops = cl.datasets.linear_drag(drag=(-0.1, -0.5), quadratic=-0.02, noise=0.01, trials=1)
    return cl.fit("x'' = -g - c v - q drag(v)", drops, functions=[drag], errors="white"), drops


def test_a_fit_with_a_function_is_that_of_the_same_expression(fitted):
    law, drops = fitted
    expected = cl.fit("x'' = -g - c v - q v*abs(v)", drops, errors="white")
    assert law.terms.names == ("1", "v", "drag(v)")
    np.testing.assert_allclose(law.coefficients, expected.coefficients, rtol=1e-6)
    np.testing.assert_allclose(standard_errors(law), standard_errors(expected), rtol=1e-4)
    last = [each.predict(drops).trajectories[0].states[-1] for each in (law, expected)]
    np.testing.assert_allclose(*last, rtol=1e-6)


def test_a_parameter_inside_a_function_is_that_inside_the_same_expression():
    times = np.linspace(0, 4, 40)
    random = np.random.default_rng(1)
    fall = solved(lambda _, x: -1.5 * np.tanh(0.7 * x), [3.0], times)[:, 0]
    trials = cl.Trials.from_arrays(times, fall + 0.01 * random.standard_normal(40), names=["x"])
    settings = {"errors": "white", "noise": {"x": 0.01}}
    law = cl.fit("x' = -a f(x, p)", trials, functions=[lambda x, p: np.tanh(p * x)], **settings)
    expected = cl.fit("x' = -a tanh(p x)", trials, **settings)
    np.testing.assert_allclose(law.params["estimate"], expected.params["estimate"], rtol=1e-4)
    assert np.all(abs(law.params["estimate"] - [1.5, 0.7]) < 3 * law.params["standard error"])


def test_saved_laws_are_read_with_their_functions_alone(fitted, tmp_path):
    law, _ = fitted
    again = from_json(to_json(law), [drag])
    assert again.terms == law.terms
    assert np.array_equal(again.coefficients, law.coefficients)
    with refused("functions-missing"):
        from_json(to_json(law))
    law.save(tmp_path / "law.parquet")
    assert cl.Law.load(tmp_path / "law.parquet", [drag]).terms == law.terms
    for ending in ("py", "c", "m", "mo", "xlsx"):
        with refused("function-unavailable"):
            law.save(tmp_path / f"law.{ending}")
    with refused("function-unavailable"):
        law.simplify()


def test_fits_that_take_no_functions_refuse_them():
    drops = cl.datasets.linear_drag()
    with refused("function-with-observation"):
        cl.fit("h'' = -g - q drag(v)", drops, observe={"x": "h + b"}, functions=[drag])


def test_discover_finds_a_law_with_a_function():
    def rates(_, y, a, c):
        return [y[1], -a * y[0] - c * tanh_v(*y)]

    objects, starts = {"a": (1.5, 0.5), "b": (2.0, 0.8)}, ([2.0, 0.0], [0.5, 1.0])
    trials = simulated(rates, objects, starts, np.linspace(0, 8, 80), 0.005, ["x"], absolute=True)
    law = cl.discover(trials, order=2, library=["poly:2", tanh_v])
    assert [name for name, there in zip(law.terms.names, law.support[0], strict=True) if there] == ["x", "tanh_v(x, v)"]
    errors = standard_errors(law)[:, 0, law.support[0]]
    assert np.all(abs(law.coefficients[:, 0, law.support[0]] - [[-1.5, -0.5], [-2.0, -0.8]]) < 3.5 * errors)
    assert "functions" not in to_script(law)


@pytest.fixture(scope="module")
def growing():
    """Ten populations with capacities, ``x' = 0.9 x (1 - x/K)``."""
    random, times, frames = np.random.default_rng(3), np.linspace(0, 8, 60), []
    for i in range(10):
        capacity, mass = random.uniform(5, 20), random.uniform(1, 4)
        for trial, start in enumerate(random.uniform(0.3, 1.5, 2)):
            exact = capacity / (1 + (capacity / start - 1) * np.exp(-0.9 * times))
            own = {"object": f"o{i}", "trial": trial, "t": times, "x": exact + NOISE * random.standard_normal(60)}
            frames.append(pd.DataFrame(own | {"K": capacity, "mass": mass}))
    return cl.Trials.from_frame(pd.concat(frames), properties=["K", "mass"])


@pytest.mark.slow
def test_discover_finds_the_term_with_the_right_property(growing):
    library = ["x", "x^2", "x*mass", "x**2/K", "x^2*mass", "x^2*K"]
    law = cl.discover(growing, order=1, library=library)
    assert [name for name, there in zip(law.terms.names, law.support[0], strict=True) if there] == ["x", "x^2/K"]
    found, errors = (each[:, 0, law.support[0]] for each in (law.coefficients, standard_errors(law)))
    deviations = (found - [0.9, -0.9]) / errors
    assert np.all(abs(deviations) < 3.5)
    assert 0.5 < np.sqrt(np.mean(deviations**2)) < 1.4
    forecast = law.predict(growing)
    assert forecast.score() > 0.99
    assert law.schema.inputs == ("K", "mass")
    with refused("columns-differ"):
        law.predict(cl.Trials.from_frame(growing.to_frame().drop(columns=["K"])))


def test_what_names_objects_stands_in_equations_and_explains_coefficients():
    times, random = np.linspace(0, 3, 40), np.random.default_rng(4)
    swings = {m: 0.1 * np.cos(np.sqrt(5 / m) * times) + 1e-3 * random.standard_normal(40) for m in (0.1, 0.2, 0.4)}
    frame = pd.concat([pd.DataFrame({"mass": m, "t": times, "x": x}) for m, x in swings.items()])
    trials = Trials.from_frame(frame.rename(columns={"mass": "mass [kg]"}))
    law = cl.fit("x'' = -k/mass x", trials, shared=["k"], errors="white")
    k = law.params.query("parameter == 'k'").iloc[0]
    assert abs(k["estimate"] - 5) < 3 * k["standard error"] < 0.1
    assert [*coefficients_by_object(law)] == ["mass", "k"]
    explained = cl.fit("x'' = -a x", trials, errors="white").explain()
    new = pd.DataFrame({"mass [kg]": 0.3, "t": times, "x": 0.1 * np.cos(np.sqrt(5 / 0.3) * times)})
    assert explained.predict(Trials.from_frame(new, object="mass")).score() > 0.99
