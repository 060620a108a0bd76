"""Angles in degrees are in radians in trials, as sines take them."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import commonlaw as cl


def test_angles_in_degrees_are_read_in_radians():
    rows = {
        "t [s]": [0.0, 1.0, 2.0],
        "angle [deg]": [180.0, 90.0, 0.0],
        "sd [deg]": 1.8,
        "rate [°/s]": [0.0, 36.0, 18.0],
    }
    table = rows | {"T [degC]": [20.0, 21.0, 22.0], "slope [deg]": 45.0}
    trials = cl.Trials.from_frame(table, inputs=["T"], properties=["slope"], noise_columns={"angle": "sd"})
    np.testing.assert_allclose(trials[0].states, np.pi * np.array([[1, 0], [0.5, 0.2], [0, 0.1]]))
    np.testing.assert_allclose(trials[0].noise[:, 0], np.pi / 100)
    assert trials.properties["object"]["slope"] == pytest.approx(np.pi / 4)
    assert trials[0].inputs[:, 0].tolist() == [20, 21, 22]
    assert [trials.schema.units[name] for name in ("angle", "rate", "slope", "T")] == ["rad", "rad/s", "rad", "degC"]
    assert "a given noise is in radians" in trials.notes[-1]
    assert trials.notes[-1].endswith(
        "angle from deg to rad, rate from °/s to rad/s, sd from deg to rad, slope from deg to rad"
    )
    arrays = cl.Trials.from_arrays([0.0, 1.0, 2.0], [180.0, 90.0, 0.0], names=["angle"], units={"angle": "degree"})
    np.testing.assert_allclose(arrays[0].states[:, 0], [np.pi, np.pi / 2, 0])

    named = cl.Trials.from_frame(
        {"t": [0.0, 1.0, 2.0], "theta_deg": [180.0, 90.0, 0.0], "omega_deg_s": [0.0, 36.0, 18.0]}
    )
    np.testing.assert_allclose(named[0].states, trials[0].states)


def test_sines_of_angles_in_degrees_are_those_of_the_angles():
    times = np.linspace(0, 4, 80)
    angle = solve_ivp(lambda _, y: [y[1], -9 * np.sin(y[0])], (0, 4), [1.2, 0], t_eval=times, rtol=1e-10, atol=1e-10).y[
        0
    ]
    trials = cl.Trials.from_arrays(times, np.degrees(angle), names=["angle"], units={"angle": "deg", "t": "s"})
    law = cl.fit("angle'' = -k sin(angle)", trials, errors="white")
    assert law.params["estimate"].item() == pytest.approx(9, rel=1e-6)
