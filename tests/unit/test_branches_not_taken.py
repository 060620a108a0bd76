"""Branches of `where` that are not taken leave values and derivatives as they are."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.estimation.model import ModelText, read_model
from commonlaw.integration.shooting import shoot
from commonlaw.trials import Schema

T = np.linspace(0.0, 20.0, 41)
RATE, START = 0.41, 4.0
ROOT = np.maximum(np.sqrt(START) - RATE * T / 2, 0.0)


@pytest.mark.parametrize("text", ["where(x > 0, sqrt(x), 0)", "where(x > 0, x^0.5, 0)", "where(0 > x, 0, sqrt(x))"])
def test_a_tank_that_empties_has_a_value_past_zero(text):
    model = read_model(ModelText.of(f"x' = -k {text}"), Schema(("x",)), ())
    solution = shoot(model.switched, np.array([RATE]), np.array([START]), T, np.array([START]))
    np.testing.assert_allclose(solution.states[:, 0], ROOT**2, atol=1e-6)
    assert np.isfinite(solution.derivatives).all()
    np.testing.assert_allclose(solution.derivatives[:, 0, 0], -ROOT * T, atol=0.01)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("where(x > 0, sqrt(x), 0)", lambda x: np.sqrt(np.maximum(x, 0))),
        ("where(x > 0, x^1.5, x)", lambda x: np.where(x > 0, np.abs(x) ** 1.5, x)),
        ("where(x > 1, log(x), 0)", lambda x: np.log(np.maximum(x, 1))),
        ("where(x > 0, 2, sqrt(1 - x))", lambda x: np.where(x > 0, 2, np.sqrt(np.maximum(1 - x, 0)))),
        ("where(x > 2, sqrt(log(x - 1)), x^2)", lambda x: np.where(x > 2, np.sqrt(np.log(np.maximum(x, 2) - 1)), x**2)),
    ],
)
def test_the_rate_is_that_of_the_branch_that_is_taken(text, value):
    x = np.linspace(-2.05, 3.05, 52)
    law = cl.Law.from_text(f"x' = 1 {text}")
    np.testing.assert_allclose(law.rhs(law.objects[0], x[:, np.newaxis])[:, 0], value(x), atol=1e-12)
    assert np.isfinite(law.terms.jacobian(np.stack([x, 0 * x], axis=1))).all()


def test_predictions_go_on_past_zero():
    law = cl.Law.from_text("h' = -0.41 where(h > 0, sqrt(h), 0)")
    (path,) = law.simulate(T, [START]).values()
    assert path.outcome is None
    np.testing.assert_allclose(path.states[:, 0], ROOT**2, atol=1e-5)
