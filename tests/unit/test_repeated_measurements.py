"""Several measurements at one time, held against fits to all rows."""

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.law.parameters import standard_errors
from commonlaw.trials import Trial
from commonlaw.trials.transformations import with_logarithms, with_starts
from tests.refusals import refused

TIMES = np.array([0.0, 5.0, 12.0, 20.0, 35.0, 60.0, 90.0])


COUNTS = np.array([3, 2, 3, 1, 4, 2, 3])


def decay(start, k, times):
    return start / (1 + start * k * times)


def rows(seed=0, noise=0.02):
    """A table of second-order decay with one to four measurements at each time."""
    times = np.repeat(TIMES, COUNTS)
    return pd.DataFrame(
        {"t": times, "a": decay(2.0, 0.05, times) + noise * np.random.default_rng(seed).normal(size=18)}
    )


def read(frame, **roles):
    return cl.Trials.from_frame(frame, time="t", states=["a"], **roles)


def of_all_rows(frame):
    """Coefficients, standard errors and noise by least squares of all rows."""
    fit = least_squares(lambda p: decay(p[0], p[1], frame.t) - frame.a, [2.0, 0.05], xtol=1e-14, ftol=1e-14, gtol=1e-14)
    variance = 2 * fit.cost / (len(frame) - 2)
    return fit.x, np.sqrt(variance * np.diag(np.linalg.inv(fit.jac.T @ fit.jac))), np.sqrt(variance)


def test_a_law_is_fitted_to_all_rows():
    frame = rows()
    trials = read(frame)
    law = cl.fit("a' = -k a^2", trials, errors="white")
    (start, k), (_, error), noise = of_all_rows(frame)
    k_of_law = -law.coefficients[0][0, 0]
    assert k_of_law == pytest.approx(k, abs=0.1 * error)
    assert standard_errors(law)[0][0, 0] == pytest.approx(error, rel=0.1)
    assert law.uncertainty.noise[0] == pytest.approx(noise, rel=0.1)
    assert law.uncertainty.degrees_of_freedom[0] == 16
    assert law.predict(trials, start="all").trajectories[0].states[0, 0] == pytest.approx(start, rel=1e-3)
    assert "18 measurements" in str([step for step in law.history if step.stage == "coefficients"])


def test_arrays_and_tables_hold_the_same_means_counts_and_squares():
    frame = rows()
    of_table = read(frame)[0]
    of_arrays = cl.Trials.from_arrays(frame.t.to_numpy(), frame.a.to_numpy())
    groups = frame.groupby("t").a
    for trial in (of_table, of_arrays[0]):
        np.testing.assert_array_equal(trial.times, TIMES)
        np.testing.assert_allclose(trial.states[:, 0], groups.mean())
        np.testing.assert_array_equal(trial.counts[:, 0], COUNTS)
        np.testing.assert_allclose(trial.repeats.squares[:, 0], groups.apply(lambda a: np.sum((a - a.mean()) ** 2)))
        np.testing.assert_allclose(trial.std(np.array([0.3]))[:, 0], 0.3 / np.sqrt(COUNTS))
    assert of_arrays.notes == ("17 measurements at 6 times in 1 trial are averaged, weighted by their number",)
    assert of_arrays.notes == read(frame).notes


def test_measurements_with_standard_deviations_are_weighted_by_these():
    trial = Trial("a", "1", [0, 0, 1], [1.0, 2.0, 3.0], noise=np.array([1.0, 0.5, 1.0]))
    np.testing.assert_allclose(trial.states[:, 0], [(1 + 4 * 2) / 5, 3])
    np.testing.assert_allclose(trial.noise[:, 0], [5**-0.5, 1])
    np.testing.assert_allclose(trial.std(np.array([9.0])), trial.noise)


def test_a_value_that_is_missing_among_repeated_ones_does_not_count():
    trial = Trial("a", "1", [0, 0, 1, 1], np.array([[1.0, np.nan], [3.0, 5.0], [np.nan, 1.0], [np.nan, 2.0]]))
    np.testing.assert_array_equal(trial.counts, [[2, 1], [0, 2]])
    np.testing.assert_array_equal(trial.states, [[2, 5], [np.nan, 1.5]])
    np.testing.assert_array_equal(trial.rows(slice(1, None)).repeats.squares[:, 1], [0.5])


def test_a_sample_that_was_not_repeated_has_one_measurement():
    trials = cl.Trials.from_arrays([0, 0, 1.0, 2.0], [2.0, 4.0, 6.0, 8.0], names=["x"])
    (more,) = cl.Law.from_text("x' = a", {"a": 2.0}).predict(trials, start=1, times=[0.5]).trials
    np.testing.assert_array_equal(np.hstack([more.repeats.counts, more.repeats.squares]), [[2, 2], *[[1, 0]] * 3])
    (latent,) = with_starts(trials, {"w": None})
    np.testing.assert_array_equal(np.hstack([latent.repeats.counts, latent.repeats.squares])[0], [2, 1, 2, 0])


def test_units_and_logarithms_scale_the_scatter_of_repeated_measurements():
    trials = cl.Trials.from_arrays([0, 0, 1.0], [2.0, 4.0, 6.0], names=["a"])
    (logarithms,) = with_logarithms(trials, ["a"])
    np.testing.assert_allclose(logarithms.repeats.squares[0], 2 / 3**2)
    frame = pd.DataFrame({"t": [0, 0, 1.0, 2.0, 3.0], "x": [2.0, 4.0, 6.0, 7.0, 8.0]})
    metres = cl.Trials.from_frame(frame, time="t", states=["x"], units={"x": "m", "t": "s"})
    law = cl.Law.from_text("x' = a", {"a": 1.0}, units={"x": "cm", "t": "s"})
    forecast = law.predict(metres, start=1)
    np.testing.assert_allclose(forecast.trials[0].repeats.squares[0], 2 * 100**2)


def test_copies_of_rows_are_refused_and_a_column_that_separates_them_names_objects():
    frame = rows().drop_duplicates("t")
    with refused("copies"):
        read(pd.concat([frame, frame]).sort_values("t"))
    rigs = pd.concat([frame.assign(w=1), frame.assign(a=frame.a + 0.1, w=2)]).sort_values("t")
    assert read(rigs).objects == ("1", "2")


def test_rows_of_one_time_that_stand_apart_are_repeated_measurements_if_that_is_said():
    frame = rows().drop_duplicates("t")
    again = pd.concat([frame, frame.assign(a=frame.a + 0.1)])
    with refused("name-trials"):
        read(again)
    levels = pd.concat([rows().assign(dose=1), rows().assign(dose=2)])
    with refused("name-trials-by"):
        read(levels)
    np.testing.assert_allclose(read(again, restarts="sort")[0].states[:, 0], frame.a + 0.05)


def test_a_time_that_stands_still_is_refused_by_its_column():
    trials = cl.Trials.from_frame({"clock": [3.0] * 6, "x": [1.0, 1.1, 1.3, 1.2, 1.05, 1.6]}, time="clock")
    for learn in (cl.discover, lambda table: cl.fit("x' = -k x", table)):
        with refused(Diagnostic("time-stands-still", {"column": "clock", "time": 3.0})):
            learn(trials)
