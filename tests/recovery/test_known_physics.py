"""Known physics as a base of a law: equations, laws and functions of Python."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw import Law, Trials
from commonlaw.datasets.sphere_drag import AIR_DENSITY, AIR_VISCOSITY
from commonlaw.diagnostics import Diagnostic
from commonlaw.law import from_json, to_json
from commonlaw.law.parameters import standard_errors, vector_field
from commonlaw.library.expansion import summands, traced
from tests.refusals import refused

SETTINGS = {"order": 2, "library": "poly:1"}


@pytest.fixture(scope="module")
def drops() -> Trials:
    """Drops of two balls with linear drag, which is a property too."""
    return cl.datasets.linear_drag(noise=0.02, drag=(-0.3, -0.5), trials=1)


def sphere_drag(v, radius, mass):
    """Return the acceleration by the drag of Brown and Lawler."""
    reynolds = abs(v) * 2 * radius / AIR_VISCOSITY
    coefficient_times = 24 * (1 + 0.150 * reynolds**0.681) + 0.407 * reynolds**2 / (reynolds + 8710)
    return -np.pi / 4 * AIR_DENSITY * AIR_VISCOSITY * radius * coefficient_times * v / mass


@pytest.mark.parametrize("known", ["-9.8", "x'' = -9.8", Law.from_text("x'' = -g", {"g": 9.8}), lambda: -9.8])
def test_gravity_is_a_base_in_every_form_and_drag_is_what_is_left(drops, known):
    law = cl.discover(drops, known=known, **SETTINGS)
    assert law.structure == ("x'' = -9.8 + a v",)
    np.testing.assert_array_equal(law.coefficients[:, 0, law.terms.index("1")], [-9.8, -9.8])
    np.testing.assert_array_equal(standard_errors(law)[:, 0, law.terms.index("1")], [0.0, 0.0])
    np.testing.assert_allclose(law.coefficients[:, 0, law.terms.index("v")], [-0.3, -0.5], rtol=0.01)


def test_names_in_known_equations_are_properties(drops):
    law = cl.discover(drops, known="drag v", **SETTINGS)
    np.testing.assert_array_equal(law.coefficients[:, 0, law.terms.index("v")], [-0.3, -0.5])
    np.testing.assert_allclose(law.coefficients[:, 0, law.terms.index("1")], -9.8, rtol=0.01)


@pytest.mark.slow
def test_a_function_of_speed_and_properties_is_a_base_and_gravity_is_left():
    drops = cl.datasets.reynolds_drag(trials=1, samples=25).select(object=["Ball 1", "Ball 5"])
    law = cl.discover(drops, known=sphere_drag, **SETTINGS)
    assert law.coefficients[:, 0, law.terms.index("1")] == pytest.approx(-9.8, abs=0.05)
    free = standard_errors(law)[0, 0] > 0
    assert [law.terms.names[k] for k in np.flatnonzero(free)] == ["1"]
    values = np.column_stack([np.zeros(9), np.linspace(-30.0, -1.0, 9), np.zeros(9)])
    own = drops.properties["Ball 5"]
    gravity = law.uncertainty.pooled.coefficients[1, np.flatnonzero(law.support).tolist().index(law.terms.index("1"))]
    expected = gravity + sphere_drag(values[:, 1], own["radius"], own["mass"])
    np.testing.assert_allclose(vector_field(law, "Ball 5").derivatives(values)[:, 1], expected, rtol=1e-9)
    assert law.provenance.calls == ()
    again = from_json(to_json(law))
    np.testing.assert_allclose(vector_field(again, "Ball 5").derivatives(values)[:, 1], expected, rtol=1e-9)


def test_traced_functions_are_sums_of_numbers_and_terms():
    result = traced(lambda v, m: np.sin(2 * v) / m - (3 * v) ** 2 * (1 - v) + 4, {"v": None, "m": 2.0})
    assert summands(result, ("v",)) == [(0.5, "sin(2.0*v)"), (-9.0, "v**2.0"), (9.0, "v**2.0*v"), (4.0, "1")]


@pytest.mark.parametrize(
    ("known", "message"),
    [
        (lambda v: v if v > 0 else -v, "known-function-branches"),
        (lambda v: np.expm1(v), "known-function-numpy"),
        (lambda v: v if v else 1.0, "known-function-branches"),
        (Law.from_text("x'' = -g - F v/(c + v)", {"g": 9.8, "F": 1.0, "c": 1.0}), "known-physics-parameters"),
        (lambda v: f"{v}", Diagnostic("known-function-result", {"result": "str"})),
        (lambda v, weight: v * weight, Diagnostic("known-physics-names", {"name": "weight", "object": "Ball 1"})),
        (lambda v: 0 * v, "known-physics-empty"),
        ("x' = -9.8", Diagnostic("known-physics-order-given", {"order": "1", "sought": "2"})),
        ("weight v", Diagnostic("known-physics-names", {"name": "weight"})),
        (Law.from_text("x' = -k x", {"k": 1.0}), Diagnostic("known-physics-order", {"order": "1"})),
    ],
)
def test_what_cannot_be_a_base_is_refused(drops, known, message):
    with refused(message):
        cl.discover(drops, known=known, **SETTINGS)
