"""Solutions with their derivatives: the kernel against SciPy, and both against differences."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

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
    "a ball that bounces": (
        program("v1", "-v3", "-v0", "v0", "-v4*v1", variables=6),
        [9.81, 0.7], [1.3, 0.2], np.linspace(0, 2.1, 31), [1.0, 4.0], NO_INPUTS,
    ),
    "a ball that bounces on a spring": (
        program("v1", "-v3*v0 - v4*v7*(v0 + 1)", "v0 - v5", "-0.4 - v0", "-0.4 + 0*v0", "-v6*v1 + v2*v5", variables=9),
        [2.0, 3.0, 0.3, 0.7], [1.0, 0.0], np.linspace(0, 6, 25), [1.0, 1.0], NO_INPUTS,
    ),
    "a dose at some time": (
        program("-v2*v0", "v1 - v3", "v4*v0 + v5", variables=7),
        [0.5, 3.1, 0.4, 2.0], [1.0], np.linspace(0, 10, 41), [1.0], NO_INPUTS,
    ),
    "a cell that divides": (
        program("v2*v0", "v0 - 2*v3", "v0/2", variables=5),
        [0.7, 1.2], [1.5], np.linspace(0, 8, 33), [1.0], NO_INPUTS,
    ),
    "an event that brings about another": (
        program("v3", "-v4*v1", "v0 - v5", "v1 - v7", "0*v0", "v1 + v6*v0", "v0 + v7", "v1/2 - v2*v4", variables=10),
        [1.0, 0.1, 1.45, 2.0, 2.9], [0.0, 0.5], np.linspace(0, 6, 25), [1.0, 1.0], NO_INPUTS,
    ),
    "an input that makes an event happen": (
        program("-v3*v0", "v1 + 1e-3*v0 - 1.5", "v0 + v4*v1", variables=6),
        [0.01, 0.6], [0.5], TIMES, [1.0], DelayedInputs(STEPS, (0,), (-1,)),
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


@pytest.mark.parametrize("engine", ["compiled", pytest.param("numpy", marks=pytest.mark.slow)], indirect=True)
@pytest.mark.usefixtures("engine")
def test_a_solution_that_slides_along_a_switch_ends_there():
    code = program("1 - 2*v3", "v0 - v2", variables=4)
    found = shoot(code, np.array([0.5]), np.array([1.0]), np.linspace(0, 2, 9), np.ones(1))
    assert np.isfinite(found.states[:3]).all()
    assert np.isnan(found.states[4:]).all()


@pytest.mark.usefixtures("engine")
@pytest.mark.parametrize("case", ["a ball that bounces", "a cell that divides"])
def test_events_are_those_that_scipy_locates(case):
    code, parameters, initial, times, _, _ = CASES[case]
    outputs = {"a ball that bounces": 2, "a cell that divides": 1}

    def all_of(t, x):
        return code.evaluate(np.array([[*x, t, *parameters, 0.0]]))[0]

    def event(t, x):
        return all_of(t, x)[outputs[case]]

    vars(event).update(terminal=True, direction=1)
    states, x, t, count = np.full((len(times), len(initial)), np.nan), np.array(initial), times[0], 0
    while t < times[-1]:
        wanted = (times > t) | (times == t)
        own = solve_ivp(lambda t, x: all_of(t, x)[: len(x)], (t, times[-1]), x, "DOP853", rtol=1e-12, atol=1e-13,
                        events=event, dense_output=True)  # fmt: skip
        inside = wanted & (times <= own.t[-1])
        states[inside] = own.sol(times[inside]).T
        t = own.t[-1]
        if own.status == 1:
            x, count = all_of(t, own.y[:, -1])[outputs[case] + 1 :], count + 1
            x[0] = max(x[0], 0.0)  # Which rounding leaves below the ground
    assert count >= 2
    assert solved(case, tolerance=1e-10).states == pytest.approx(states, abs=1e-6)


@pytest.mark.usefixtures("engine")
def test_the_state_at_the_time_of_an_event_is_that_before_it():
    code = program("0*v0", "v1 - v2", "v0 + 1", variables=4)
    times = np.arange(0.0, 1.0, 0.1)
    for tau in times:
        found = shoot(code, np.array([tau]), np.array([1.0]), times, np.ones(1))
        assert found.states[:, 0] == pytest.approx(np.where(times > tau, 2.0, 1.0))


@pytest.mark.usefixtures("engine")
@pytest.mark.parametrize("restitution", [0.9, 0.5, 0.05, 0.0])
def test_events_without_end_end_the_solution(restitution):
    code = program("v1", "-v3", "-v0", "0*v0", "-v4*v1", variables=6)
    times, g = np.linspace(0, 100, 1001), 9.81
    found = shoot(code, np.array([g, restitution]), np.array([5.0, 0.0]), times, np.ones(2))
    # The sum of the geometric series of times between bounces
    end = np.sqrt(2 * 5 / g) * (1 + 2 * restitution / (1 - restitution))
    assert found.is_endless
    assert np.isfinite(found.states[times < end - 1e-3]).all()
    assert np.isnan(found.states[times > end]).all()
