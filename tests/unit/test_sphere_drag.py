"""Drag on spheres against limits, hand-worked values and force balances."""

import numpy as np
import pytest

from commonlaw.datasets import sphere_drag
from commonlaw.datasets.sphere_drag import AIR_DENSITY, AIR_DYNAMIC_VISCOSITY, AIR_VISCOSITY
from commonlaw.diagnostics import Diagnostic
from tests.refusals import refused


def test_reynolds_number_in_the_papers_air_is_0_665e5_times_speed_times_diameter() -> None:
    assert sphere_drag.reynolds_number(20.0, 0.1) == pytest.approx(0.665e5 * 20.0 * 0.1, rel=1e-3)


def test_drag_coefficient_at_1e5_is_the_value_worked_out_by_hand() -> None:
    # 1e5^0.681 = 10^3.405 = 2540.973, so 24e-5 (1 + 381.146) = 0.0917150; 0.407 / 1.0871 = 0.3743906
    assert sphere_drag.drag_coefficient(1e5) == pytest.approx(0.4661056, abs=1e-6)


def test_slow_spheres_obey_stokes() -> None:
    assert sphere_drag.drag_coefficient(1e-9) == pytest.approx(24 / 1e-9, rel=1e-6)
    stokes = 3 * np.pi * AIR_DYNAMIC_VISCOSITY * 1e-6 * 1e-5
    assert sphere_drag.drag_force(1e-5, 1e-6) == pytest.approx(stokes, rel=1e-6)


def test_force_at_rest_is_zero_without_a_warning_while_the_coefficient_is_infinite() -> None:
    assert sphere_drag.drag_force(0.0, 0.1) == 0.0
    assert sphere_drag.drag_coefficient(0.0) == np.inf


def test_force_is_the_textbook_product_of_coefficient_area_and_dynamic_pressure() -> None:
    speed, diameter = np.array([0.1, 3.0, 40.0])[:, np.newaxis], np.array([0.01, 0.24])
    coefficient = sphere_drag.drag_coefficient(sphere_drag.reynolds_number(speed, diameter, 1e-6))
    expected = coefficient * np.pi * diameter**2 / 4 * 998.0 * speed**2 / 2
    np.testing.assert_allclose(sphere_drag.drag_force(speed, diameter, 998.0, 1e-6), expected, rtol=1e-13)


def test_the_correlation_is_known_to_end_at_2e5_and_is_evaluated_beyond() -> None:
    assert sphere_drag.in_valid_range([0.0, 1.99e5, 2e5]).tolist() == [True, True, False]
    assert np.isfinite(sphere_drag.drag_coefficient(1e7))


def test_air_viscosity_is_kinematic() -> None:
    assert AIR_VISCOSITY == AIR_DYNAMIC_VISCOSITY / AIR_DENSITY == pytest.approx(1.503e-5, rel=1e-3)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: sphere_drag.reynolds_number([1.0, -2.0], 0.1),
            Diagnostic("not-in-range", {"name": "speed", "value": -2.0, "rule": "not be negative"}),
        ),
        (
            lambda: sphere_drag.reynolds_number(1.0, 0.0),
            Diagnostic("not-in-range", {"name": "diameter", "value": 0.0, "rule": "be positive"}),
        ),
        (
            lambda: sphere_drag.drag_coefficient(np.nan),
            Diagnostic("not-in-range", {"name": "Reynolds number"}),
        ),
        (
            lambda: sphere_drag.drag_force(1.0, 0.1, density=-1.0),
            Diagnostic("not-in-range", {"name": "density", "value": -1.0}),
        ),
        (
            lambda: sphere_drag.drag_force(1.0, 0.1, viscosity=0.0),
            Diagnostic("not-in-range", {"name": "viscosity", "value": 0.0}),
        ),
        (lambda: sphere_drag.drag_force(1.0, -0.1), Diagnostic("not-in-range", {"name": "diameter", "value": -0.1})),
    ],
)
def test_values_that_cannot_be_are_refused_by_name(call, message) -> None:
    with refused(message):
        call()
