"""Values whose powers overflow are refused where they are read, and those within the bound make no warning."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.trials.files import table_in
from commonlaw.trials.recognition import last_digit
from commonlaw.trials.tables import rows_of
from commonlaw.trials.trial import EXTREME
from tests.refusals import refused

TIMES = np.arange(20.0)


@pytest.mark.parametrize("value", [1e52, -1e155, 1e308])
@pytest.mark.parametrize("column", ["t", "x", "u", "x_std", "mass"])
def test_a_value_whose_powers_overflow_is_refused_with_its_place(column, value):
    frame = {"object": ["a"] * 10 + ["b"] * 10, "t": np.tile(TIMES[:10], 2), "x": np.cos(TIMES), "u": np.sin(3 * TIMES)}
    frame |= {"x_std": np.full(20, 0.1), "mass": np.repeat([1.0, 2.0], 10)}
    frame[column] = frame[column].copy()
    frame[column][9 if column == "t" else 8] = abs(value) if column in ("t", "x_std") else value
    if column == "mass":
        frame[column][:10] = value
    roles = {"states": ["x"], "inputs": ["u"], "noise_columns": {"x": "x_std"}, "properties": ["mass"]}
    with refused("cell-extreme", value=abs(value) if column in ("t", "x_std") else value, limit=EXTREME) as caught:
        cl.Trials.from_frame(frame, **roles)
    assert f"column '{column}', row {1 if column == 'mass' else 10 if column == 't' else 9}" in str(caught.value)


def test_the_line_of_such_a_value_in_a_file_is_named():
    content = b"t,x\n" + b"".join(b"%d,%d\n" % (i, i * i) for i in range(9)) + b"9,1.5e300\n"
    with refused("cell-extreme", value=1.5e300) as caught:
        rows_of(table_in("t.csv", content), {})
    assert "line 11" in str(caught.value)


@pytest.mark.parametrize("what", ["states", "inputs", "noise"])
def test_arrays_are_refused_too(what):
    given = {"states": np.cos(TIMES), "inputs": np.sin(TIMES), "noise": np.full(20, 0.1)}
    given[what][3] = 1e200
    with refused("sample-extreme", value=1e200, limit=EXTREME):
        cl.Trials.from_arrays(TIMES, **given)


@pytest.mark.parametrize("column", ["x", "u", "x_std", "mass"])
@pytest.mark.parametrize("scale", [1e-300, 1e-320])
def test_columns_whose_powers_underflow_are_refused(column, scale):
    """Single small values among large ones are not."""
    frame = {"t": TIMES, "x": np.cos(TIMES), "u": np.sin(3 * TIMES), "x_std": np.full(20, 0.1), "mass": np.ones(20)}
    roles = {"states": ["x"], "inputs": ["u"], "noise_columns": {"x": "x_std"}, "properties": ["mass"]}
    frame["x"][3] *= scale
    cl.Trials.from_frame(frame, **roles)
    with refused("column-tiny", limit=1 / EXTREME) as caught:
        cl.Trials.from_frame(frame | {column: frame[column] * scale}, **roles)
    assert repr(column) in str(caught.value)
    if column != "mass":
        arrays = {"x": "states", "u": "inputs", "x_std": "noise"}
        given = {name: frame[key] * (scale if key == column else 1) for key, name in arrays.items()}
        with refused("column-tiny"):
            cl.Trials.from_arrays(TIMES, **given)


@pytest.mark.parametrize("scale", [1e50, 1e-50])
def test_values_within_the_bound_make_no_warning(scale):
    frame = {"t": TIMES, "x": np.cos(TIMES) * scale, "y": np.sin(TIMES) * scale, "u": np.repeat([0.0, 1.0], 10) * scale}
    trials = cl.Trials.from_frame(frame)
    assert np.array_equal(trials[0].states[:, 0], frame["x"])
    trials.check()


@pytest.mark.parametrize("scale", [1e-308, 1e-320])
def test_the_last_digit_of_the_smallest_numbers(scale):
    assert last_digit(np.array([1.0, 2.0]) * scale) == 0.0


@pytest.mark.parametrize("step", [1e-50, 1e-9, 1e50])
@pytest.mark.parametrize("spacing", [TIMES, TIMES**1.5])
def test_derivatives_scale_with_the_steps(step, spacing):
    method = cl.differentiation.FiniteDifference(accuracy=8)
    slopes = method.differentiate(spacing, np.sin(spacing / 5)[:, np.newaxis], 1).derivatives[0]
    scaled = method.differentiate(spacing * step, np.sin(spacing / 5)[:, np.newaxis], 1).derivatives[0]
    np.testing.assert_allclose(scaled * step, slopes, rtol=1e-9, atol=1e-12)
