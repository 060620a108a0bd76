"""The course of inputs between samples: in meshes, chosen by evidence, kept with laws."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares
from scipy.signal import lfilter

import commonlaw as cl
from commonlaw.inference.search.setup import supported_interpolation
from commonlaw.integration import InitialValueProblem, Inputs, VectorField, jumps, simulate
from commonlaw.law import from_json, to_json
from commonlaw.law.parameters import standard_errors
from commonlaw.likelihood import meshes
from commonlaw.likelihood.collocation import defects
from tests.refusals import refused
from tests.unit.trajectories import terms_of, trial

TIMES = np.linspace(0, 20, 81)
KNOWN = {"noise": {"x": 0.01}}


def driven(course, noise=0.01, seed=0):
    """Tanks with x' = 0.2 - 0.8 x + u, whose input is set anew every third sample."""
    generator, states, inputs = np.random.default_rng(seed), [], []
    for _ in range(3):
        values = np.repeat(generator.uniform(0, 2, 27), 3)[:, np.newaxis]
        field = VectorField(
            terms_of("terms:1,x,u", ("x",), ("u",)), np.array([[0.2, -0.8, 1.0]]), 1, Inputs.of(TIMES, values, course)
        )
        exact = simulate([InitialValueProblem(field, generator.uniform(0, 2, 1), TIMES)])[0].states[:, 0]
        states.append(exact + noise * generator.standard_normal(81))
        inputs.append(values)
    return cl.Trials.from_arrays([TIMES] * 3, states, object=["tank"] * 3, inputs=inputs, names=["x", "u"])


def on(course, law):
    """The same law with another course of inputs."""
    return replace(law, schema=replace(law.schema, input_interpolation=course))


@pytest.mark.parametrize("points", [1, 2])
@pytest.mark.parametrize("course", ["held", "linear", "cubic"])
def test_a_solution_with_its_inputs_has_no_defects(course, points):
    times = np.array([0.0, 0.3, 0.5, 0.9, 1.0, 1.4])
    values = np.random.default_rng(0).standard_normal((6, 1))
    field = VectorField(terms_of("terms:u", ("x",), ("u",)), np.array([[1.0]]), 1, Inputs.of(times, values, course))
    (mesh,) = meshes([trial(times, times[:, np.newaxis], values)], points, input_interpolation=course)
    states = simulate([InitialValueProblem(field, np.zeros(1), mesh.times)], tolerance=1e-12)[0].states
    np.testing.assert_allclose(defects(field, mesh, states), 0, atol=1e-9)
    again = mesh.with_inputs(Inputs.of(times, values, course))
    np.testing.assert_array_equal(again.middle, mesh.middle)
    assert again.held == mesh.held == (course == "held")


@pytest.mark.slow
def test_inputs_that_are_held_are_found_out_and_the_law_with_them():
    trials = driven("held")
    law = cl.discover(trials, library="poly:2", method=cl.TrajectoryLikelihood(**KNOWN), order=1)
    assert law.structure == ("x' = a + b x + c u",)
    inside = law.support[0]
    missed = (law.coefficients[0, 0, inside] - [0.2, -0.8, 1.0]) / standard_errors(law)[0, 0, inside]
    assert np.all(np.abs(missed) < 3.5)
    assert (law.history[0].stage, law.history[0].choice) == ("inputs", "held")
    assert law.predict(trials).score() > 0.997
    compared = cl.compare({"held": law, "lines": on("linear", law)}, trials, **KNOWN)
    assert compared["law"].tolist() == ["held", "lines"]
    assert compared["2 log B"][1] > 100

    # The law keeps the course, for forecasts and refinements
    again = from_json(to_json(law))
    assert (
        again.predict(trials, start=10).score() == again.predict(trials, start=10, input_interpolation="held").score()
    )
    assert cl.refine(again, trials, **KNOWN).schema.input_interpolation == "held"
    assert (
        again.predict(trials, start=10).score() > again.predict(trials, start=10, input_interpolation="linear").score()
    )


def test_inputs_are_on_lines_between_their_levels_where_the_evidence_is_strong():
    trials = driven("linear")
    law = cl.fit("x' = a + b x + c u", trials, **KNOWN)
    (step,) = (each for each in law.history if each.stage == "inputs")
    assert step.choice == "linear"
    assert "against held" in step.reason
    with refused("unknown-name", kind="input_interpolation", name="steps"):
        cl.TrajectoryLikelihood(input_interpolation="steps")


WAVE, NOISE = np.sin(1.3 * TIMES), np.random.default_rng(3).standard_normal(81)


@pytest.mark.parametrize(
    ("inputs", "expected"),
    [
        ([WAVE], "cubic"),
        ([np.sin(np.pi / 2 * TIMES / 0.25 + 0.4)], "cubic"),  # Four samples a cycle
        ([WAVE, np.ones(81)], "cubic"),
        ([WAVE, TIMES], "cubic"),
        ([WAVE + 1e-3 * NOISE], "cubic"),
        ([WAVE, np.floor(TIMES / 4) % 2], "jumps"),
        ([WAVE + (TIMES > 8.1)], "jumps"),
        ([np.floor(TIMES / 4) % 2], "held"),
        ([abs(TIMES / 4 % 2 - 1)], "linear"),
        ([WAVE + 0.2 * NOISE], "linear"),
        ([np.ones(81)], "linear"),
        ([TIMES], "linear"),
    ],
)
@pytest.mark.parametrize("times", [TIMES, 60 * TIMES + 1e4])
def test_samples_of_inputs_show_whether_these_are_smooth(inputs, expected, times):
    """In any unit of time; a trial of four has none to leave out."""
    columns = np.column_stack(inputs)
    trials = cl.Trials.from_arrays([times, times[:4]], [TIMES, TIMES[:4]], inputs=[columns, columns[:4]])
    assert supported_interpolation(trials) == expected


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ((TIMES > 8.1) + 0.0, [32]),
        (WAVE + 2.0 * (TIMES > 8.1), [32]),
        (0.01 * NOISE + 2.0 * (TIMES > 8.1), [32]),
        (TIMES / 6 % 1, [23, 47, 71]),
        (abs(TIMES / 4 % 2 - 1), []),  # Kinks
        (NOISE, []),
        (np.cumsum(NOISE), []),
        (np.exp(-(((TIMES - 8.1) / 0.3) ** 2)), []),  # A pulse of a few samples
        (WAVE + 2.0 * ((TIMES > 8.1) & (TIMES < 8.8)), []),  # Too short to stand out of a wave
        ((TIMES > 8.1) & (TIMES < 8.8), [32, 35]),  # Of an input with levels it is not
        ((TIMES < 0.1) + ((TIMES > 8.1) & (TIMES < 8.3)) - 1.0 * (TIMES > 19.8), [0, 32, 33, 79]),
        ((TIMES > 8.1) * np.minimum(TIMES - 8.1, 0.7), []),  # A ramp
        (np.floor(2 * TIMES) % 2, []),  # Too many: no curve is left between them
        (np.tanh((TIMES - 8.1) / 0.3), []),
    ],
    ids=[
        "step",
        "wave",
        "noise",
        "saw",
        "kinks",
        "white",
        "walk",
        "pulse",
        "in-wave",
        "short",
        "near",
        "ramp",
        "many",
        "smooth",
    ],
)
def test_intervals_in_which_an_input_jumps_are_recognized(values, expected):
    column = np.asarray(values, dtype=float)[:, np.newaxis]
    assert np.flatnonzero(jumps(TIMES, column)[:, 0]).tolist() == expected
    assert np.flatnonzero(jumps(60 * TIMES + 1e4, 3 - 7 * column)[:, 0]).tolist() == expected
    # From one curve to the other in the middle; without a jump it is a spline
    inputs, last = Inputs.of(TIMES, column, "jumps"), expected[-1:]
    assert_allclose(inputs.at(TIMES), column, atol=1e-12)
    assert [round(at / 0.25 - 0.5, 9) for at, _ in inputs.jumps_within] == expected
    for k in last:
        before, after = inputs.at(np.array([TIMES[k] + 0.1249, TIMES[k] + 0.1251]))[:, 0]
        assert before == pytest.approx(2 * column[k, 0] - inputs.at(TIMES[k : k + 1] - 0.125)[0, 0], abs=0.2)
        assert abs(after - before) == pytest.approx(abs(column[k + 1, 0] - column[k, 0]), rel=0.2)
    if not expected:
        assert_allclose(inputs.at(TIMES[:-1] + 0.1), Inputs.of(TIMES, column, "cubic").at(TIMES[:-1] + 0.1))


def stepped(time, rate=0.8, seed=5):
    """A tank with x' = 2 u - k x whose inflow begins at a time between two samples; the exact solution, with noise."""
    late = np.clip(TIMES - time, 0, None)
    exact = 0.5 * np.exp(-rate * TIMES) + 2 / rate * (1 - np.exp(-rate * late))
    x = exact + 0.02 * np.random.default_rng(seed).standard_normal(len(TIMES))
    return cl.Trials.from_arrays(TIMES, x, inputs=np.heaviside(TIMES - time, 0), names=["x", "u"])


def test_an_input_that_jumps_between_samples_does_so_when_the_measurements_say():
    """Least squares with the time as a parameter, by SciPy, has the same estimates and errors."""
    trials = stepped(5.09)
    law = cl.fit("x' = g u - k x", trials, errors="white", noise={"x": 0.02})
    assert law.schema.input_interpolation == "jumps"
    assert [step.choice for step in law.history if step.stage == "jumps"] == ["u in 1 interval"]

    def residuals(unknowns):
        gain, rate, start, time = unknowns
        late = np.clip(TIMES - time, 0, None)
        fitted = start * np.exp(-rate * TIMES) + gain / rate * (1 - np.exp(-rate * late))
        return (fitted - trials[0].states[:, 0]) / 0.02

    solved = least_squares(residuals, [2, 0.8, 0.5, 5.1], jac="3-point", xtol=1e-12)
    errors = np.sqrt(np.diag(np.linalg.inv(solved.jac.T @ solved.jac)))[:2]
    rows = law.params.set_index("parameter").loc[["g", "k"]]
    assert_allclose(rows["estimate"], solved.x[:2], atol=0.02 * errors.min())
    assert_allclose(rows["standard error"], errors, rtol=0.02)
    lines = cl.fit("x' = g u - k x", trials, input_interpolation="linear")  # As asked for
    assert "jumps" not in [step.stage for step in lines.history]
    assert "inputs-jump" in [n.code for n in cl.fit("x' = g u - k x; x(0) = a", trials).diagnostics]


def test_pulses_of_a_heater_beside_a_smooth_input_leave_no_error_to_the_law():
    """T' = -0.13 (T - outside) + 0.8 power, switched between samples, at times one or two samples apart."""
    times, random, rate = np.arange(0, 40, 0.25), np.random.default_rng(11), 0.13
    states, inputs = [], []
    for _ in range(3):
        edges = np.sort(np.append(random.uniform(0, 40, 6), [0.1, 20.1, 20.4]))
        fine = np.linspace(0, 40, 32001)
        outside, power = 5 + 5 * np.sin(fine / 4 + random.uniform(0, 6)), 3.0 * (np.searchsorted(edges, fine) % 2)
        step = fine[1] - fine[0]
        heat = lfilter([1], [1, -np.exp(-rate * step)], (rate * outside + 0.8 * power) * step)
        curve = 18 * np.exp(-rate * fine) + heat
        states.append(curve[::200][:160] + 0.1 * random.standard_normal(160))
        inputs.append(np.column_stack([outside, power])[::200][:160].round(2))
    trials = cl.Trials.from_arrays([times] * 3, states, inputs=inputs, names=["T", "outside", "power"])
    law = cl.discover(trials)
    assert law.structure == ("T' = a T + b outside + c power",)
    assert law.schema.input_interpolation == "jumps"
    assert law.uncertainty.error_model.kind == "white"
    errors = law.params["standard error"].to_numpy()
    assert np.all(abs(law.params["estimate"].to_numpy() - [-0.13, 0.13, 0.8]) < 3 * errors)


@pytest.mark.parametrize("time", [5.01, 5.09, 5.24])
def test_forecasts_after_a_jump_count_that_its_time_is_unknown(time):
    law = cl.fit("x' = g u - k x", stepped(5.09), errors="white")
    trials = stepped(time, seed=6)
    forecast = law.predict(trials, start="all", return_std=True)
    middle, std = forecast.trajectories[0].states[:, 0], forecast.std[0][:, 0]
    at = np.searchsorted(TIMES, time)
    # A uniform time within the interval of 0.25 moves the state after it by 2 u of its standard deviation
    assert std[at] == pytest.approx(2 * 0.25 / np.sqrt(12) * np.exp(-0.8 * 0.125), rel=0.1)
    assert std[at - 1] < 0.02
    assert np.all(abs(trials[0].states[:, 0] - middle)[at:] < 3 * np.hypot(std[at:], 0.02))
    assert forecast.score() > 0.99


def test_the_interval_of_a_gain_holds_it_where_noise_hides_that_the_input_is_curved():
    """x' = -1.5 x + 25 u, with the exact solution for a sine: chords alone make the gain 0.6 % too large."""
    times, held = np.linspace(0, 20, 60), []
    angle = 1.3 * times
    u = np.sin(angle)
    exact = 25 * (1.5 * np.sin(angle) - 1.3 * np.cos(angle)) / (1.5**2 + 1.3**2) + 10 * np.exp(-1.5 * times)
    for seed in range(5):
        x = exact + 0.2 * np.random.default_rng(seed).standard_normal(60)
        law = cl.fit("x' = -k*x + g*u", cl.Trials.from_arrays(times, x, inputs=u, names=["x", "u"]))
        (row,) = law.conf_int().query("parameter == 'g'").itertuples()
        assert law.schema.input_interpolation == "cubic"
        held.append(row.low < 25 < row.high)
    assert sum(held) >= 4
