"""Solutions with their derivatives: the kernel against SciPy, and both against differences."""

import numpy as np
import pytest

from commonlaw.integration.shooting import NO_INPUTS, DelayedInputs, shoot
from commonlaw.integration.vector_field import Inputs
from commonlaw.kernel import VARIABLE, kernel
from commonlaw.library.program import Program
from commonlaw.library.term import Factor


def program(*expressions, variables):
    return Program.of([((Factor(expression), 1),) for expression in expressions], variables)


TIMES = np.arange(0.0, 400.0, 10.0)
STEPS = Inputs.of(TIMES, ((TIMES >= 50) * 2.0 - (TIMES >= 200))[:, None], "held")
RAMPS = Inputs.of(TIMES, ((TIMES >= 50) * 2.0 - (TIMES >= 200))[:, None], "linear")
CASES = {
    "prey and predators": (
        program("v3*v0 - v4*v0*v1", "v5*v0*v1 - v6*v1", variables=7),
        [1.0, 0.5, 0.3, 0.8], [1.0, 2.0], np.linspace(0, 20, 41), [1.0, 1.0], NO_INPUTS,
    ),
    "Robertson's stiff reactions": (
        program("-v4*v0 + v5*v1*v2", "v4*v0 - v5*v1*v2 - v6*v1**2", "v6*v1**2", variables=7),
        [0.04, 1e4, 3e7], [1.0, 0.0, 0.0], np.append(0, np.logspace(-3, 4, 15)), [1.0, 1e-4, 1.0], NO_INPUTS,
    ),
    "a heater with dead time, steps": (
        program("(v3*v1 - v0)/v4", variables=6),
        [0.6, 60.0, 18.3], [0.5], TIMES, [1.0], DelayedInputs(STEPS, (0,), (2,)),
    ),
    "a heater with dead time, ramps": (
        program("(v3*v1 - v0)/v4", variables=6),
        [0.6, 60.0, 18.3], [0.5], TIMES, [1.0], DelayedInputs(RAMPS, (0,), (2,)),
    ),
    "a switch in time": (
        program("-v2*v0 + v3*v5", "v1 - v4", variables=6),
        [0.5, 1.0, 3.1], [1.0], np.linspace(0, 10, 41), [1.0], NO_INPUTS,
    ),
    "a spring that stiffens": (
        program("v1", "-v3*v0 - v4*v6*(v0 + 1)", "v0 - v5", variables=7),
        [2.0, 3.0, 0.3], [1.0, 0.0], np.linspace(0, 6, 25), [1.0, 1.0], NO_INPUTS,
    ),
}  # fmt: skip


def solved(case, *, tolerance=1e-8, derivatives=True, **changed):
    code, parameters, initial, times, sizes, inputs = CASES[case]
    values = {"parameters": parameters, "initial": initial} | changed
    arrays = (np.array(values["parameters"]), np.array(values["initial"]), times, np.array(sizes))
    return shoot(code, *arrays, inputs, tolerance=tolerance, derivatives=derivatives)


@pytest.fixture(params=["compiled", "numpy"])
def engine(request, monkeypatch):
    if request.param == "compiled" and kernel() is None:
        pytest.skip("there is no kernel here")
    monkeypatch.setenv(VARIABLE, request.param)
    return request.param


@pytest.mark.parametrize("case", CASES)
def test_derivatives_are_those_of_the_solution(case):
    found, (_, parameters, initial, _, sizes, _) = solved(case), CASES[case]
    values = np.array([*parameters, *initial])
    for i, value in enumerate(values):
        step = 1e-5 * (abs(value) or 1e-3)
        ends = []
        for side in (-1, 1):
            moved = values.copy()
            moved[i] += side * step
            own = {"parameters": moved[: len(parameters)], "initial": moved[len(parameters) :]}
            ends.append(solved(case, tolerance=1e-11, derivatives=False, **own).states)
        expected = (ends[1] - ends[0]) / (2 * step)
        scale = np.max(np.abs(expected), axis=0) + np.array(sizes) / (abs(value) or 1.0) * 1e-3
        assert np.max(np.abs(found.derivatives[:, :, i] - expected) / scale) < 2e-5


@pytest.mark.parametrize("case", CASES)
def test_kernel_and_scipy_agree(case, monkeypatch):
    found = []
    for name in ("compiled", "numpy"):
        monkeypatch.setenv(VARIABLE, name)
        found.append(solved(case))
    one, other = found
    scale = np.max(np.abs(other.states), axis=0)
    assert np.max(np.abs(one.states - other.states) / scale) < 1e-6
    scale = np.max(np.abs(other.derivatives), axis=0) + 1e-300
    assert np.max(np.abs(one.derivatives - other.derivatives) / scale) < 1e-5


@pytest.mark.usefixtures("engine")
def test_a_solution_that_runs_away_is_not_a_number_after_it():
    code = program("v2*v0**2", variables=3)
    found = shoot(code, np.array([1.0]), np.array([1.0]), np.array([0.0, 0.5, 2.0]), np.ones(1))
    assert found.states[1, 0] == pytest.approx(2.0, rel=1e-6)
    assert np.isnan(found.states[2, 0])
    assert np.isnan(found.derivatives[2]).all()


@pytest.mark.usefixtures("engine")
def test_a_switch_in_time_has_the_solution_in_closed_form():
    _, parameters, _, times, _, _ = CASES["a switch in time"]
    k, a, begins = parameters
    later = np.maximum(times - begins, 0)
    found = solved("a switch in time", tolerance=1e-10)
    assert found.states[:, 0] == pytest.approx(np.exp(-k * times) + a / k * (1 - np.exp(-k * later)), abs=1e-8)
    expected = np.where(times > begins, -a * np.exp(-k * later), 0.0)
    assert found.derivatives[:, 0, 2] == pytest.approx(expected, abs=1e-7)


@pytest.mark.usefixtures("engine")
def test_a_solution_that_slides_along_a_switch_ends_there():
    code = program("1 - 2*v3", "v0 - v2", variables=4)
    found = shoot(code, np.array([0.5]), np.array([1.0]), np.linspace(0, 2, 9), np.ones(1))
    assert np.isfinite(found.states[:3]).all()
    assert np.isnan(found.states[4:]).all()
