"""What both back ends promise: events, dense output, sensitivities, divergence; and which one is chosen."""

import sys
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from importlib.util import find_spec
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.integration import Event, InitialValueProblem, Inputs, VectorField, simulate, simulation
from commonlaw.integration.problem import OutputOptions
from commonlaw.library import Terms, Variables, parse_term
from tests.refusals import refused

METHODS = ["auto", "scipy"] + (["heyoka"] if find_spec("heyoka") else [])
"""Where heyoka is not installed, "auto" is SciPy."""

GROUND = Event("x", direction="falling", terminal=True)


@pytest.fixture(autouse=True)
def _however_little_there_is_to_do(monkeypatch):
    """Have `auto` take heyoka for short runs too."""
    monkeypatch.setattr(simulation, "_FEW_POINTS", 0)


def field(states, *equations, order=1, inputs=None, input_names=()):
    """The vector field of these equations, each a mapping from term to coefficient."""
    variables = Variables(tuple(states), input_names)
    names = list(dict.fromkeys(name for equation in equations for name in equation))
    terms = Terms(variables, tuple(parse_term(name, variables) for name in names))
    rows = np.array([[float(equation.get(name, 0)) for name in names] for equation in equations])
    return VectorField(terms, rows, order, inputs)


def run(moved, initial, times, **options):
    return simulate([InitialValueProblem(moved, np.array(initial, float), np.array(times, float), "thing")], **options)[
        0
    ]


RAMP = Inputs.of(np.array([0.0, 9.0]), np.array([[0.0], [9.0]]))
FALL = field("xv", {"1": -9.8}, order=2)
PENDULUM = field("xv", {"sin(x)": -1.3, "v": -0.1, "cos(2*x)*v**3": 0.05, "x*t": 0.01}, order=2)
RATIONAL = field("xy", {"x/(1 + y**2)": -0.7, "exp(-x)": 0.3}, {"x*y**3": -0.2, "sqrt(1 + x**2)": 0.4, "1/y**2": 0.1})
LOGISTIC = field("x", {"x": 2.8, "x**2": -2.8}, order=0)
SMOOTH = {"pendulum": (PENDULUM, [1.0, 0.5]), "rational": (RATIONAL, [0.5, 0.8]), "logistic": (LOGISTIC, [0.3])}


@pytest.mark.parametrize("name", ["linear-drag", "reynolds-drag", "lorenz", "lotka-volterra", "nonlinear-oscillator"])
def test_the_back_ends_agree_on_every_law_that_is_known(name):
    law = cl.datasets.truth_of(name)
    start = {trial.object: trial.states[0] for trial in cl.datasets.load(name)}
    if law.order == 2:
        start = {each: [*state, 0.0] for each, state in start.items()}
    times = np.linspace(0, 2, 101)
    found, expected = (law.simulate(times, start, method=each, tolerance=1e-13) for each in ("auto", "scipy"))
    for each in law.objects:
        size = np.abs(expected[each].states).max()
        np.testing.assert_allclose(found[each].states, expected[each].states, rtol=0, atol=1e-8 * size)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["pendulum", "rational"])
def test_dense_output_is_the_trajectory_between_its_times(method, name):
    moved, start = SMOOTH[name]
    fine = np.linspace(0, 3, 31)
    expected = run(moved, start, fine, method="scipy", tolerance=1e-13).states
    sparse = run(moved, start, fine[::10], method=method, tolerance=1e-11, dense=True)
    np.testing.assert_allclose(sparse.at(fine), expected, atol=1e-8)
    np.testing.assert_allclose(sparse.at(1.0), sparse.states[1:2], atol=1e-9)
    with refused("trajectory-span", first=0.0, last=3.0):
        sparse.at(3.5)
    with refused("trajectory-not-dense"):
        run(moved, start, fine, method=method).at(1.0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SMOOTH)
def test_sensitivities_are_derivatives_of_the_trajectory(method, name):
    moved, start = SMOOTH[name]
    options = {"method": method, "tolerance": 1e-12}
    times = np.arange(0.0, 4.0, 1.0)
    found = run(moved, start, times, sensitivities=True, **options)
    plain = run(moved, start, times, **options)
    np.testing.assert_allclose(found.states, plain.states, rtol=1e-9)
    columns = []
    for i in range(len(moved.parameters)):
        step = np.zeros(len(moved.parameters))
        step[i] = 1e-5
        ends = []
        for sign in (1, -1):
            coefficients = moved.coefficients.copy()
            coefficients[moved.kept] += sign * step
            ends.append(run(VectorField(moved.terms, coefficients, moved.order), start, times, **options).states)
        columns.append((ends[0] - ends[1]) / 2e-5)
    for step in 1e-5 * np.eye(len(start)):
        ends = [run(moved, start + sign * step, times, **options).states for sign in (1, -1)]
        columns.append((ends[0] - ends[1]) / 2e-5)
    assert found.sensitivities.shape == (len(times), len(start), len(moved.parameters) + len(start))
    np.testing.assert_allclose(found.sensitivities, np.stack(columns, axis=2), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_a_parameter_of_the_support_keeps_its_sensitivity_when_it_is_zero(method):
    moved = field("x", {"x": -1.0, "1": 0.5})
    off = VectorField(moved.terms, np.array([[-1.0, 0.0]]), free=np.ones((1, 2), dtype=bool))
    found = run(off, [2.0], [0.0, 1.0], method=method, tolerance=1e-11, sensitivities=True)
    np.testing.assert_allclose(found.sensitivities[1, 0], [2 * np.exp(-1), 1 - np.exp(-1), np.exp(-1)], rtol=1e-8)


@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("method", METHODS)
def test_a_terminal_event_ends_the_trajectory(method, dense):
    times = np.linspace(0, 4, 41)
    top = Event("v", direction="falling")
    found = run(FALL, [30.0, 5.0], times, method=method, events=[top, GROUND], dense=dense)
    landed = (5 + np.sqrt(25 + 2 * 9.8 * 30)) / 9.8
    assert found.outcome is None
    assert found.ended == pytest.approx(landed, rel=1e-9)
    np.testing.assert_allclose(found.events[0].times, [5 / 9.8], rtol=1e-9)
    np.testing.assert_allclose(found.events[1].states, [[0, 5 - 9.8 * landed]], atol=1e-7)
    before = times <= landed
    np.testing.assert_allclose(found.states[before, 0], (30 + 5 * times - 4.9 * times**2)[before], atol=1e-6)
    assert np.isnan(found.states[~before]).all()
    if dense:
        assert np.isnan(found.at([landed - 0.01, landed + 0.01])).all(axis=1).tolist() == [False, True]


@pytest.mark.parametrize("direction", ["any", "falling", "rising"])
@pytest.mark.parametrize("method", METHODS)
def test_a_start_on_the_level_is_no_crossing(method, direction):
    event = Event("x", 7.0, direction)
    thrown = run(FALL, [7.0, 10.0], np.linspace(0, 5, 6), method=method, events=[event]).events[0]
    dropped = run(FALL, [7.0, 0.0], np.linspace(0, 5, 6), method=method, events=[event]).events[0]
    np.testing.assert_allclose(thrown.times, [] if direction == "rising" else [20 / 9.8], rtol=1e-8)
    assert dropped.times.tolist() == []


@pytest.mark.parametrize("method", METHODS)
def test_events_of_expressions_are_found_each_time(method):
    spring = field("xy", {"y": 1.0}, {"x": -1.0})
    events = [Event("x*y"), Event("x", 0.5, "rising"), Event("x**2 + y**2", 2.0)]
    found = run(spring, [1.0, 0.0], [0.0, 6.0, 12.0], method=method, tolerance=1e-11, events=events).events
    np.testing.assert_allclose(found[0].times, np.arange(1, 8) * np.pi / 2, atol=1e-8)
    np.testing.assert_allclose(found[1].times, [5 * np.pi / 3, 11 * np.pi / 3], atol=1e-8)
    np.testing.assert_allclose(found[1].states[:, 0], 0.5, atol=1e-8)
    assert found[2].times.size == 0
    assert found[2].states.shape == (0, 2)


@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("method", METHODS)
def test_a_blow_up_is_an_outcome_with_its_time(method, dense):
    square = field("x", {"x**2": 1.0})
    times = np.array([0.0, 0.5, 0.9, 1.5, 2.0])
    found = run(square, [1.0], times, method=method, dense=dense)
    np.testing.assert_allclose(found.states[:3, 0], 1 / (1 - times[:3]), rtol=1e-5)
    assert np.isnan(found.states[3:]).all()
    assert found.ended == pytest.approx(1.0, abs=1e-6)
    assert str(found.outcome).startswith("diverged (thing): the forecast ran away at t = 1 (a state reached")
    if dense:
        assert np.isnan(found.at([0.7, 1.2])).ravel().tolist() == [False, True]


@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("method", METHODS)
def test_exponential_growth_is_followed_until_it_has_run_away(method, dense):
    found = run(field("x", {"x": 1.0}), [1.0], np.linspace(0, 1000, 1001), method=method, dense=dense)
    np.testing.assert_allclose(found.states[:20, 0], np.exp(np.arange(20.0)), rtol=1e-6)
    assert found.outcome is not None
    assert np.log(1e10) <= found.ended < 30
    assert np.isnan(found.states[31:]).all()


@pytest.mark.parametrize("options", [{}, {"dense": True}, {"sensitivities": True}])
@pytest.mark.parametrize("method", METHODS)
def test_a_trajectory_ends_where_it_goes_beyond_a_limit(method, options):
    """What grows makes this law ever stiffer: without a limit it takes all steps that there are."""
    growing = field("xy", {"x": 1.0}, {"x*y": -1.0})
    found = run(growing, [1.0, 1.0], np.linspace(0, 20, 41), method=method, limit=1e3, **options)
    assert str(found.outcome).startswith("diverged (thing): the forecast ran away at t = ")
    assert np.log(1e3) <= found.ended < np.log(1e3) + 0.5
    np.testing.assert_allclose(found.states[:13, 0], np.exp(found.times[:13]), rtol=1e-5)
    assert np.isnan(found.states[15:]).all()


@pytest.mark.parametrize("method", METHODS)
def test_whole_powers_are_integrated_through_zero(method):
    moved = field("x", {"1": 1.0, "x**3": 0.5, "(x - 1)**5": 0.0, "exp(x**7)": -0.1})
    found = run(moved, [0.0], [0.0, 0.5, 0.9], method=method, tolerance=1e-11)
    np.testing.assert_allclose(found.states, run(moved, [0.0], [0.0, 0.5, 0.9], method="scipy").states, atol=1e-6)


def test_laws_that_have_no_taylor_series_are_integrated_by_scipy():
    drag = field("xv", {"1": -9.8, "v*abs(v)": -0.02}, order=2)
    expected = np.sqrt(9.8 / 0.02)
    assert run(drag, [0.0, 0.0], [0.0, 100.0]).states[1, 1] == pytest.approx(-expected, rel=1e-6)
    driven = field("x", {"u": 1.0}, inputs=RAMP, input_names=("u",))
    assert run(driven, [0.0], [0.0, 2.0]).states[1, 0] == pytest.approx(2.0)
    root = run(field("x", {"1": 1.0, "sqrt(x)": 1.0}), [0.0], [0.0, 1.0])
    inverse = 2 * (np.sqrt(root.states[1, 0]) - np.log(1 + np.sqrt(root.states[1, 0])))
    assert inverse == pytest.approx(1.0, abs=1e-5)
    if "heyoka" in METHODS:
        assert run(drag, [0.0, 0.0], [0.0, 1.0]).method == "scipy (abs has no Taylor series where it jumps or bends)"
        assert run(driven, [0.0], [0.0, 1.0]).method == "heyoka"
        between = run(driven, [0.0], [0.0, 1.0], dense=True)
        assert between.method == "scipy (the law has inputs, and states between the times are wanted)"
        np.testing.assert_allclose(between.at([0.5]), [[0.125]], rtol=1e-6)
        assert root.method == "scipy (heyoka stopped, at t = 0: a state is not finite)"
        with refused("heyoka-failed", reason="abs has no Taylor series where it jumps or bends"):
            run(drag, [0.0, 0.0], [0.0, 1.0], method="heyoka")


@pytest.mark.parametrize("options", [{}, {"dense": True}, {"events": [Event("x"), GROUND]}, {"sensitivities": True}])
def test_a_law_that_is_not_finite_at_the_start_is_an_outcome(options):
    found = run(field("x", {"1/x": 1.0}), [0.0], [0.0, 1.0, 2.0], **options)
    assert str(found.outcome).startswith(
        "diverged (thing): the forecast ran away at t = 0 (the law is not finite there)"
    )
    assert (found.ended, found.states[0, 0]) == (0.0, 0.0)
    assert np.isnan(found.states[1:]).all()


def test_a_stiff_law_goes_to_scipy_when_heyoka_needs_too_many_steps():
    stiff, times = field("x", {"x": -1e6}), [0.0, 1e-6, 10.0]
    found = run(stiff, [1.0], times)
    np.testing.assert_allclose(found.states[:, 0], [1, np.exp(-1), 0], atol=1e-6)
    if "heyoka" in METHODS:
        assert found.method.startswith("scipy (heyoka stopped, at t = ")
        assert found.method.endswith(": 100000 steps were not enough)")
        alone = run(stiff, [1.0], times, method="heyoka")
        assert alone.outcome.kind == "not integrated"
        assert np.isnan(alone.states[2, 0])


def test_without_heyoka_scipy_does_all(monkeypatch):
    monkeypatch.setitem(sys.modules, "heyoka", None)
    found = run(PENDULUM, [1.0, 0.5], [0.0, 1.0], events=[Event("v")], dense=True, sensitivities=True)
    assert found.method == "scipy (heyoka is not installed, pip install 'commonlaw[fast]')"
    assert found.sensitivities.shape == (2, 2, 6)
    with refused("heyoka-failed"):
        run(PENDULUM, [1.0, 0.5], [0.0, 1.0], method="heyoka")


@pytest.mark.parametrize("method", METHODS)
def test_many_objects_give_what_each_gives_alone_also_from_threads(method):
    starts = np.random.default_rng(0).uniform(0.2, 1, (8, 2))
    runs = [
        InitialValueProblem(
            VectorField(RATIONAL.terms, RATIONAL.coefficients * (1 + i / 20)), start, np.linspace(0, 2, 5)
        )
        for i, start in enumerate(starts)
    ]
    together = simulate(runs, method=method)
    with ThreadPoolExecutor(4) as pool:
        alone = list(pool.map(lambda each: simulate([each], method=method)[0], runs))
    for a, b in zip(together, alone, strict=True):
        np.testing.assert_array_equal(a.states, b.states)


def test_objects_of_one_law_share_what_is_compiled():
    if "heyoka" in METHODS:
        from commonlaw.integration.heyoka import compiled

        law = cl.datasets.truth_of("lotka-volterra")
        compiled.cache_clear()
        law.simulate([0.0, 1.0], [20.0, 10.0])
        law.simulate([0.0, 2.0], [10.0, 20.0], dense=True)
        assert compiled.cache_info().misses == 1


def test_a_law_in_discrete_time_is_iterated_and_may_diverge():
    states = run(LOGISTIC, [0.3], np.arange(4.0)).states[:, 0]
    for now, then in pairwise(states):
        assert then == pytest.approx(2.8 * now * (1 - now))
    lost = run(LOGISTIC, [3.0], np.arange(10.0))
    assert lost.outcome.kind == "diverged"
    assert np.isfinite(lost.states[lost.times < lost.ended]).all()
    assert np.isnan(lost.states[lost.times >= lost.ended]).all()
    driven = field("x", {"x": 0.5, "u": 1.0}, order=0, inputs=RAMP, input_names=("u",))
    assert run(driven, [8.0], np.arange(4.0)).states[:, 0].tolist() == [8, 4, 3, 3.5]
    with refused("discrete-without-dense-output"):
        run(LOGISTIC, [0.3], [0.0, 1.0], dense=True)


@pytest.mark.parametrize("method", METHODS)
def test_one_time_gives_the_initial_state(method):
    found = run(PENDULUM, [1.0, 0.5], [3.0], method=method, dense=True, sensitivities=True, events=[GROUND])
    assert found.states.tolist() == found.at(3.0).tolist() == [[1.0, 0.5]]
    assert found.sensitivities[0].tolist() == [[0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1]]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "euler"}, Diagnostic("unknown-name", {"kind": "method of integration", "name": "euler"})),
        ({"tolerance": 0.0}, Diagnostic("tolerance-range", {"tolerance": 0.0})),
        (
            {"events": [Event("height")]},
            Diagnostic("unknown-name", {"term": "height", "kind": "variable", "name": "height"}),
        ),
    ],
)
def test_what_cannot_be_integrated_is_refused(options, message):
    with refused(message):
        run(PENDULUM, [1.0, 0.5], [0.0, 1.0], **options)


def test_events_are_checked():
    with refused("unknown-name", kind="direction of an event", name="faling"):
        Event("x", direction="faling")
    with refused("event-level", expression="x"):
        Event("x", level=np.nan)


def test_short_runs_do_not_wait_for_a_compiler(monkeypatch):
    monkeypatch.setattr(simulation, "_FEW_POINTS", 5000)
    law = cl.datasets.lorenz.truth()
    (short,) = law.simulate(np.linspace(0, 1, 11), [1.0, 2.0, 3.0]).values()
    (long,) = law.simulate(np.linspace(0, 1, 5000), [1.0, 2.0, 3.0]).values()
    assert (short.method, long.method) == ("scipy", "heyoka")


def test_a_grid_ends_where_all_but_a_rounding_error_of_the_time_is_done():
    """heyoka keeps the time to twice the digits: it may have a step left where the time is the last one."""
    heyoka, integrator = pytest.importorskip("heyoka"), import_module("commonlaw.integration.heyoka")
    stepper = SimpleNamespace(state=np.array([1.0]), time=0.0)

    def propagate_grid(grid, max_steps):
        stepper.time, stepper.state = grid[-1], np.array([3.0])
        return heyoka.taylor_outcome.step_limit, 0.0, 0.0, max_steps, None, np.array([[1.0], [2.0]])

    stepper.propagate_grid = propagate_grid
    law = SimpleNamespace(stepper=stepper, width=1, follow=lambda _: 2.0)
    problem = InitialValueProblem(field("x", {"x": 1}), np.array([1.0]), np.array([0.0, 1.0, 2.0]), "thing")
    result, rows = integrator._rows(law, problem, OutputOptions())
    assert result == heyoka.taylor_outcome.time_limit
    assert rows.ravel().tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("method", METHODS)
def test_integration_ends_at_a_pole_where_steps_are_too_short_for_time_to_pass(method):
    law = cl.Law.from_text("x' = (a + b x)/(K + x)", {"a": 376.20564098, "b": -9.61150563, "K": -50.18253575})
    options = {"tolerance": 1e-6, "sensitivities": True, "method": method}
    (path,) = law.simulate(np.linspace(0, 6, 40), [50.27012203], **options).values()
    assert path.ended == pytest.approx(3.5953e-5, rel=1e-3)
    # SciPy sees states run away before steps vanish, and so does a choice between both
    assert path.outcome.code == ("not-integrated" if method == "heyoka" else "diverged")
