"""The Reynolds numbers that de Silva et al. (2020) print for the dropped balls, and what they should be."""

import pytest

from commonlaw.datasets import PRINTED_VISCOSITY
from commonlaw.datasets.sphere_drag import reynolds_number

# Ball, radius in m, largest speed in m/s, largest Reynolds number as printed (truncated or rounded to three digits)
PRINTED = [
    ("Golf Ball", 0.021963, 26.63, 1.75e5),
    ("Baseball", 0.035412, 26.61, 2.83e5),
    ("Tennis Ball", 0.033025, 21.95, 2.18e5),
    ("Volleyball", 0.105, 22.09, 6.96e5),
    ("Blue Basketball", 0.119366, 24.80, 8.88e5),
    ("Green Basketball", 0.116581, 25.06, 8.77e5),
    ("Whiffle Ball 1", 0.036287, 16.91, 1.84e5),
    ("Whiffle Ball 2", 0.036287, 16.35, 1.78e5),
    ("Yellow Whiffle Ball", 0.046155, 15.30, 2.12e5),
    ("Orange Whiffle Ball", 0.046155, 15.77, 2.18e5),
]


@pytest.mark.parametrize(("ball", "radius", "speed", "printed"), PRINTED)
def test_printed_reynolds_numbers_come_out_with_the_printed_viscosity(
    ball: str, radius: float, speed: float, printed: float
) -> None:
    found = reynolds_number(speed, 2 * radius, PRINTED_VISCOSITY)
    assert found == pytest.approx(1.5e5 * speed * 2 * radius, rel=1e-12)
    assert found == pytest.approx(printed, abs=0.01e5), ball
