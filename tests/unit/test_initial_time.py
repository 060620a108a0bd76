"""The time of initial values: zero where they are written, against closed forms and independent least squares."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares

import commonlaw as cl
from commonlaw.app.equations import solved
from commonlaw.app.question import Equations, Table
from commonlaw.law.io import from_json, to_json
from commonlaw.law.parameters import named_parameters
from commonlaw.law.script import to_script
from commonlaw.report.markup import law_markdown
from tests.refusals import refused

pytestmark = pytest.mark.usefixtures("few_starts")

HOURS = np.array([1.0, 2.0, 3.0, 5.0, 8.0, 12.0])
BOLUS = "c' = -k c; c(0) = 100/V"


def of_hours(hours=HOURS, count=2, **options):
    """Concentrations after a dose of 100 at hour 0, and what least squares find, (k, V) of each object."""
    random, measured, expected = np.random.default_rng(4), [], []
    for k, volume in ((0.3, 10.0), (0.2, 15.0))[:count]:
        elapsed = hours - options.get("origin", 0.0)
        values = 100 / volume * np.exp(-k * elapsed) + 0.02 * random.standard_normal(len(hours))
        measured.append(values)
        fit = least_squares(lambda p, t=elapsed, y=values: 100 / p[1] * np.exp(-p[0] * t) - y, [k, volume], xtol=1e-12)
        expected.append(fit.x)
    trials = cl.Trials.from_arrays(
        [hours] * count, measured, object=["a", "b"][:count], names=["c"], units={"t": "h", "c": "mg/L"}
    )
    return trials, np.array(expected)


@pytest.fixture(scope="module")
def bolus():
    trials, expected = of_hours()
    return trials, expected, cl.fit(BOLUS, trials)


def estimates(law):
    return named_parameters(law).values


def test_written_initial_values_are_those_at_time_zero(bolus):
    trials, expected, law = bolus
    parameters = named_parameters(law)
    assert parameters.names == ("k", "V")
    assert (np.abs(parameters.values - expected) < 0.01 * parameters.errors).all()
    assert law.observation.initial_time == 0.0
    apart = cl.fit("c' = -k c", trials, initial_values={"c": "100/V"})
    np.testing.assert_allclose(estimates(apart), expected, rtol=1e-4)


def test_what_follows_from_a_law_has_the_same_origin(bolus):
    trials, expected, law = bolus
    law = from_json(to_json(law))
    later = trials.with_trials([trial.rows(slice(2, None)) for trial in trials])
    for forecast in (law.predict(trials), law.predict(later), law.predict(trials, times=[1.5, 20.0])):
        for trial, trajectory, (k, volume) in zip(forecast.trials, forecast.trajectories, expected, strict=True):
            np.testing.assert_allclose(trajectory.states[:, 0], 100 / volume * np.exp(-k * trial.times), rtol=1e-3)
    np.testing.assert_allclose(estimates(cl.refine(law, trials)), expected, rtol=1e-4)
    assert "initial_time=0.0" in to_script(law)
    for text in (str(law), law.summary(), law_markdown(law)):
        assert "c(0) at t = 0 h" in text.replace("\\", "")
    with refused("forecast-before-start", time=0.5, begins=1.0):
        law.predict(trials, times=[0.5])


def test_saved_laws_of_earlier_versions_begin_at_the_first_sample(bolus):
    """They have no time of initial values, and neither has the call that made them."""
    trials, expected, law = bolus
    document = json.loads(to_json(law))
    document["observation"]["initial_time"] = None
    document["provenance"]["calls"] = [f'cl.fit("{BOLUS}", trials)']
    before = from_json(json.dumps(document))
    (k, volume), *_ = expected
    found = before.predict(trials).trajectories[0].states[:, 0]
    np.testing.assert_allclose(found, 100 / volume * np.exp(-k * (HOURS - 1)), rtol=1e-3)
    assert "initial_time='first'" in to_script(before)
    assert "c(0) at the first sample of each trial" in str(before)


def test_the_first_sample_and_any_time_may_be_the_origin():
    for origin, given in ((1.0, "first"), (1.0, 1.0), (-2.0, -2.0)):
        trials, expected = of_hours(count=1, origin=origin)
        law = cl.fit(BOLUS, trials, initial_time=given)
        np.testing.assert_allclose(estimates(law), expected, rtol=1e-4)
        assert law.observation.initial_time == (None if given == "first" else given)


def test_starts_that_are_not_written_stay_at_the_first_sample():
    trials, _ = of_hours(count=1)
    law = cl.fit("c' = -k c; 0 < k < 5", trials, priors={"k": (0.3, 1.0)})
    (start,) = law.trial_estimates
    assert law.observation.initial_time is None
    assert start.value == pytest.approx(trials[0].states[0, 0], rel=0.02)


def test_an_origin_that_is_doubtful_is_refused():
    for hours, code, parameters in (
        (HOURS + 1900, "initial-time-far", {"time": 1901.0, "length": 11.0}),
        (HOURS - 2, "initial-time-late", {"time": -1.0, "initial_time": 0.0}),
    ):
        trials, _ = of_hours(hours, count=1)
        with refused(code, **parameters):
            cl.fit(BOLUS, trials)
        with refused(code, **parameters):
            cl.fit("c' = ka d/V - k c; d' = -ka d", trials, initial_values={"d": 100.0})
        assert cl.fit(BOLUS, trials, initial_time="first").observation.initial_time is None
    course, few = np.exp(-0.3 * HOURS), HOURS[:4]
    one_clock = cl.Trials.from_arrays([few, HOURS + 5], [course[:4], course], object=["a", "b"], names=["c"])
    with refused("initial-time-of-clock", time=6.0, end=5.0):
        cl.fit(BOLUS, one_clock)
    with refused("initial-time-unknown"):
        cl.fit(BOLUS, of_hours()[0], initial_time="last")


def test_few_samples_of_some_objects_do_not_move_the_origin():
    """Animals of which one sample each is taken: the length of a trial is that of all."""
    _, ((k, volume), _) = of_hours()
    measured = 100 / volume * np.exp(-k * HOURS)
    trials = cl.Trials.from_arrays([[t] for t in HOURS], [[[c]] for c in measured], object=list("abcdef"), names=["c"])
    law = cl.fit(BOLUS, trials, shared=["k", "V"])
    np.testing.assert_allclose(estimates(law)[0], [k, volume], rtol=1e-4)


def test_latent_states_begin_at_time_zero_too():
    """A depot with the dose of each object, absorbed from hour 0 on, whose blood is first sampled at half an hour."""
    hours, doses = np.array([0.5, 1, 1.5, 2, 3, 4, 6, 8, 12]), {"a": 80.0, "b": 120.0}
    truth = {"a": (1.2, 20.0, 0.2), "b": (0.9, 25.0, 0.15)}

    def absorbed(p, dose):
        ka, volume, k = p
        return dose / volume * ka / (ka - k) * (np.exp(-k * hours) - np.exp(-ka * hours))

    random = np.random.default_rng(5)
    measured = {name: absorbed(truth[name], dose) + 0.02 * random.standard_normal(9) for name, dose in doses.items()}
    trials = cl.Trials.from_arrays(
        [hours] * 2,
        list(measured.values()),
        object=list(doses),
        names=["conc"],
        properties={name: {"dose": dose} for name, dose in doses.items()},
    )
    equations = "depot' = -ka depot; conc' = ka depot/V - k conc; k < 0.5"
    for text, given in (
        (equations, {"depot": "dose", "conc": 0.0}),
        (f"{equations}; depot(0) = dose; conc(0) = 0", {}),
    ):
        parameters = named_parameters(cl.fit(text, trials, initial_values=given))
        columns = [parameters.names.index(name) for name in ("ka", "V", "k")]
        rows = (parameters.values[:, columns], parameters.errors[:, columns])
        for name, found, errors in zip(doses, *rows, strict=True):
            best = least_squares(lambda p, name=name: absorbed(p, doses[name]) - measured[name], truth[name]).x
            assert (np.abs(found - best) < 0.05 * errors).all()
    plain = cl.fit(equations, trials, initial_values={"depot": "dose"}, errors="white")
    assert plain.schema.initial_time == 0.0
    assert (np.abs(named_parameters(plain).values - [*truth.values()]) < 4 * named_parameters(plain).errors).all()
    assert "depot(0) = dose at t = 0" in str(plain)


@pytest.mark.parametrize(
    ("times", "at"),
    [
        (["2021-03-01", "2021-03-02", "2021-03-03", "2021-03-05", "2021-03-08"], None),
        (["09:30", "09:45", "10:00", "10:30", "11:00"], None),
        (["0:15", "0:30", "0:45", "1:15", "1:45"], 0.0),
    ],
)
def test_dates_and_times_of_day_begin_at_their_first_sample_and_durations_at_zero(times, at):
    table = pd.DataFrame({"time": times, "x": [4.0, 2.1, 1.0, 0.24, 0.06]})
    trials = cl.Trials.from_frame(table, time="time", states=["x"], dates="h:mm" if ":" in times[0] else None)
    assert trials.schema.calendar == (at is None)
    assert cl.fit("x' = -k x; x(0) = 4", trials).observation.initial_time == at


def test_inputs_before_the_first_measurement_drive_the_solution():
    """A heater that is switched on at 2 s, in rows without a temperature until 4 s."""
    times, power = np.arange(0.0, 20.0), np.where(np.arange(20) >= 2, 3.0, 0.0)
    rise = np.where(times > 2, 3.0 / 0.5 * (1 - np.exp(-0.5 * np.clip(times - 2, 0, None))), 0.0)
    table = pd.DataFrame({"t": times, "T": np.where(times < 4, np.nan, rise), "Q": power})
    trials = cl.Trials.from_frame(table, time="t", states=["T"], inputs=["Q"])
    law = cl.fit("T' = -k T + a Q; T(0) = 0", trials, input_interpolation="held")
    np.testing.assert_allclose(estimates(law), [[0.5, 1.0]], rtol=1e-4)


def test_the_app_takes_the_time_of_initial_values():
    rows = "".join(f"a,{t},{10 * np.exp(-0.3 * t)}\n" for t in HOURS)
    table = Table("doses.csv", f"object,t,c\n{rows}".encode())
    for given, at in ((None, 0.0), ("first", None), (0.5, 0.5)):
        equations = Equations(BOLUS, initial_time=given)
        law = equations.fit(table.trials({}), {})
        assert law.observation.initial_time == at
        curve = solved(table, {}, Equations(BOLUS, {"k": (0.3,), "V": (10.0,)}, initial_time=given))["curves"][0]
        assert curve["t"][0] == (1.0 if at is None else at)
    assert solved(table, {}, Equations(BOLUS, initial_time="last"))["problem"]
