"""Parameters that only columns of zeros would determine are refused by name."""

import numpy as np
import pytest

import commonlaw as cl
from tests.refusals import refused

T = np.linspace(0.0, 8.0, 17)
X = np.exp(-0.3 * T) + 0.01 * np.cos(7 * T)


def _trials(*columns, names=("u",)):
    return cl.Trials.from_arrays(T, X, inputs=np.stack(columns, axis=1), names=["x", *names])


@pytest.mark.parametrize(
    ("equation", "names"),
    [
        ("x' = b u", ["b"]),
        ("x' = -k x + b u", ["b"]),
        ("x' = -k x + c abs(u)^p", ["c", "p"]),
        ("x' = -k x + b u; x(0) = a", ["b"]),
        ("x' = -k x + b (u > 0)", ["b"]),
        ("x' = -k x (1 + b sin(u))", ["b"]),
    ],
)
def test_parameters_of_a_column_of_zeros_are_refused(equation, names):
    with refused("parameters-of-zero-column") as caught:
        cl.fit(equation, _trials(0 * T))
    parameters = caught.value.diagnostic.parameters
    assert (sorted(parameters["names"]), parameters["columns"]) == (names, ["u"])


def test_a_property_that_is_zero_for_all_objects_determines_nothing():
    trials = cl.Trials.from_arrays(T, X, names=["x"], properties={"object": {"u": 0.0}})
    with refused("parameters-of-zero-column", names=["b"], columns=["u"]):
        cl.fit("x' = -k x + b `u`", trials)


@pytest.mark.parametrize("equation", ["x' = -k x + k u", "x' = -k x + b exp(u)", "x' = -k x + b (u + w)"])
def test_parameters_that_stand_elsewhere_too_are_fitted(equation):
    law = cl.fit(equation, _trials(0 * T, 0.01 * np.sin(T), names=("u", "w")))
    assert (law.params["standard error"] > 0).all()
