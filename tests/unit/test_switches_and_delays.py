"""Times of switches, dead times and interpolation of inputs, held against solutions in closed form."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import commonlaw as cl
from tests.unit.decays import assert_least_squares, estimates, trials_of

pytestmark = pytest.mark.usefixtures("few_starts")


@pytest.mark.parametrize("between", ["held", "linear"])
def test_a_dead_time_of_an_input_is_estimated(between):
    times = np.arange(0.0, 600.0, 10.0)
    u = 20.0 * (times >= 50) - 10.0 * (times >= 300)
    knots = times if between == "held" else None

    def curve(gain, tau, delay, first):
        def inputs(t):
            t = t - delay
            if knots is None:
                return np.interp(t, times, u)
            return u[max(int(np.searchsorted(times, t, side="right")) - 1, 0)]

        def rate(t, x):
            return (gain * inputs(t) - x) / tau

        return solve_ivp(rate, (0, 600), [first], "LSODA", times, rtol=1e-9, atol=1e-9, max_step=2).y[0]

    y = curve(0.62, 80.0, 18.0, 0.5) + 0.05 * np.random.default_rng(9).standard_normal(len(times))
    trial = cl.Trial("A", "1", times, y, u)
    trials = cl.Trials((trial,), cl.Schema(("x",), ("u",)))
    law = cl.fit("x' = (g u(t - d) - x)/s", trials, input_interpolation=between)
    known = estimates(law)
    for name, truth in {"g": 0.62, "s": 80.0, "d": 18.0}.items():
        value, error = known[name]
        assert abs(value - truth) < 4 * error < 0.05 * truth
    # Simulations delay what is given of the input
    solutions = law.simulate(times, trials[0].states[0], inputs={"u": u})
    assert_allclose(solutions["A"].states, law.predict(trials, start=1).trajectories[0].states, rtol=1e-6)
    notes = [diagnostic.code for diagnostic in cl.fit("x' = (g u(t - d) - x)/s", trials).diagnostics]
    assert notes == ["delay-by-interpolation"]


def test_the_time_of_a_switch_is_estimated():
    t, random = np.linspace(0, 20, 60), np.random.default_rng(1)

    def solution(k, a, begins):
        return 2 * np.exp(-k * t) + a / k * (1 - np.exp(-k * np.maximum(t - begins, 0)))

    measured = solution(0.5, 1.0, 6.3) + 0.02 * random.standard_normal(len(t))
    law = cl.fit("x' = -k x + a (t > t0); x(0) = 2", trials_of({"A": (t, measured)}, ["x"]))
    assert_least_squares(law, {"k": 0.45, "a": 0.9, "t0": 6.2}, lambda p: solution(*p) - measured)
    assert law.structure == ("x' = -k x + a (t > t0)",)


def test_rates_may_switch_with_the_state():
    t, random = np.linspace(0, 8, 60), np.random.default_rng(3)

    def solution(k, slow, limit):
        turns = np.log(2 / limit) / k
        return np.where(t < turns, 2 * np.exp(-k * t), limit * np.exp(-slow * (t - turns)))

    measured = solution(0.9, 0.1, 0.7) + 0.01 * random.standard_normal(len(t))
    law = cl.fit("x' = where(x > c, -k x, -s x); x(0) = 2", trials_of({"A": (t, measured)}, ["x"]))
    assert_least_squares(law, {"k": 0.8, "s": 0.12, "c": 0.75}, lambda p: solution(*p) - measured)


def heated(noise, seed):
    """Return a trial of x' = (0.6 u - x)/80 with held inputs, exactly but for the noise."""
    times, x = np.arange(0.0, 600.0, 10.0), [0.0]
    u = 20.0 * (times >= 50) - 10.0 * (times >= 300)
    for each in u[:-1]:
        x.append(0.6 * each + (x[-1] - 0.6 * each) * np.exp(-10 / 80))
    y = np.array(x) + noise * np.random.default_rng(seed).standard_normal(len(times))
    return cl.Trials((cl.Trial("A", "1", times, y, u),), cl.Schema(("x",), ("u",)))


def test_later_inputs_drive_forecasts():
    trials = heated(0.05, 13)
    y = trials[0].states[:, 0]
    law = cl.fit("x' = (g u - x)/s", trials, priors={"g": (0.6, 0.3)}, input_interpolation="held")
    later = law.predict(trials, from_time=250.0, return_std=True)
    assert np.abs(later.to_frame()["x error"]).max() < 0.2
    low, high = later.bands(measured=True)[0]
    assert 0.85 < np.mean((low[26:, 0] < y[26:]) & (y[26:] < high[26:, 0])) <= 1
    straight = law.predict(trials, from_time=250.0, input_interpolation="linear").to_frame()
    assert np.abs(straight["x error"]).max() > 2 * np.abs(later.to_frame()["x error"]).max()


def test_the_interpolation_of_inputs_is_the_one_that_fits():
    law = cl.fit("x' = (g u - x)/s", heated(0.01, 15), priors={"g": (0.6, 0.3)})
    assert law.observation.measured.input_interpolation == "held"
    assert next(each for each in law.history if each.stage == "inputs").choice == "held"


def test_a_dead_time_that_is_zero_at_its_bound_is_updated():
    times = np.linspace(0, 10, 40)
    x = 1.8 * np.exp(-0.5 * times) + 0.4 * np.sin(times) - 0.8 * np.cos(times)  # x' = -x/2 + sin t, x(0) = 1
    trial = cl.Trial("A", "1", times, x + 0.01 * np.random.default_rng(0).standard_normal(40), np.sin(times))
    trials = cl.Trials((trial,), cl.Schema(("x",), ("u",)))
    law = cl.fit("x' = -k x + b u(t - d)", trials, input_interpolation="cubic", priors={"d": (-0.1, 0.01)})
    assert estimates(law)["d"][0] == 0
    value, error = estimates(law.update(trials))["k"]
    assert abs(value - 0.5) < 4 * error < 0.1


def test_a_dead_time_at_its_bound_by_a_missing_constant_is_not_to_be_left_out():
    times = np.arange(30.0)  # x' = -0.3 x + 2 u + 5
    x = 20 * np.exp(-0.3 * times) + 5 / 0.3 * (1 - np.exp(-0.3 * times)) + 0.02 * np.cos(9 * times)
    x += 2 / 0.3 * (1 - np.exp(-0.3 * np.maximum(times - 10, 0)))
    trials = cl.Trials.from_arrays(times, x, inputs=1.0 * (times >= 10), names=["x", "u"])
    law = cl.fit("x' = -a x + b u(t - d)", trials, input_interpolation="held")
    assert [note.code for note in law.diagnostics[:2]] == ["residuals-exceed-noise", "dead-time-at-bound-of-misfit"]


def test_dead_times_that_depend_on_the_inputs_between_samples_are_named_for_every_object():
    times, source, trials = np.arange(0.0, 40.0, 1.0), np.random.default_rng(2), []
    for name, delay in {"A": 3.3, "B": 2.1}.items():
        since = np.maximum(times - 5 - delay, 0.0)
        x = 2 * (1 - np.exp(-since / 4)) + 0.04 * source.standard_normal(len(times))
        trials.append(cl.Trial(name, "1", times, x, 1.0 * (times >= 5)))
    law = cl.fit("x' = (g u(t - d) - x)/s", cl.Trials(tuple(trials), cl.Schema(("x",), ("u",))))
    notes = [note for note in law.diagnostics if note.code == "delay-by-interpolation"]
    assert [note.where for note in notes] == ["A", "B"]


def test_inputs_that_stay_at_levels_are_held_where_measurements_do_not_decide():
    """Lines between samples explain the measurements as well, with a dead time that is half a step longer."""
    times, source = np.arange(0.0, 40.0, 1.0), np.random.default_rng(2)
    x = 2 * (1 - np.exp(-np.maximum(times - 8.3, 0.0) / 4)) + 0.04 * source.standard_normal(len(times))
    trials = cl.Trials((cl.Trial("A", "1", times, x, 1.0 * (times >= 5)),), cl.Schema(("x",), ("u",)))
    law = cl.fit("x' = (g u(t - d) - x)/s", trials)
    value, error = estimates(law)["d"]
    assert abs(value - 3.3) < 3 * error < 0.45
