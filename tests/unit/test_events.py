"""Models whose states change at events, against simulations by hand and SciPy."""

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.law import from_json, to_json, to_latex, to_script
from tests.refusals import refused
from tests.unit.decays import fitted

pytestmark = pytest.mark.usefixtures("few_starts")

BALL = "x'' = -g; x < 0: x = 0, v = -c v"
TIMES = np.linspace(0, 2, 60)


def heights(times, g, c, x, v):
    """Return the heights of a ball that bounces, from parabola to parabola."""
    result, begin = np.empty(len(times)), 0.0
    for i, time in enumerate(times):
        while time > (end := begin + (v + np.sqrt(v**2 + 2 * g * x)) / g):
            x, v, begin = 0.0, c * (g * (end - begin) - v), end
        result[i] = x + v * (time - begin) - g * (time - begin) ** 2 / 2
    return result


def table(columns):
    return pd.concat([pd.DataFrame({"object": name, "t": t, "y": y}) for name, (t, y) in columns.items()])


def trials(columns, **roles):
    return cl.Trials.from_frame(table(columns), object="object", time="t", **({"states": ["y"]} | roles))


@pytest.fixture(scope="module")
def ball():
    height = heights(TIMES, 9.81, 0.75, 1.2, 0.5) + 0.01 * np.random.default_rng(0).standard_normal(len(TIMES))
    measured = cl.Trials.from_arrays(TIMES, height, names=["x"])
    return measured, cl.fit(BALL, measured)


def test_a_ball_that_bounces_has_the_estimates_of_least_squares(ball):
    measured, law = ball
    (trial,) = measured
    expected, errors = fitted(lambda p: heights(TIMES, *p), [9.81, 0.75, 1.2, 0.5], trial.states[:, 0])
    found = law.trial_estimates
    values = [*law.params["estimate"], *(each.value for each in found)]
    assert values == pytest.approx(expected, rel=1e-5)
    own = [*law.params["standard error"], *(each.error for each in found)]
    assert own == pytest.approx(errors, rel=1e-3)


def test_the_time_of_an_event_is_estimated_for_each_object_within_bounds_and_priors():
    random, times = np.random.default_rng(0), np.linspace(0, 12, 25)

    def course(k, tau):
        return 5 * np.exp(-k * times) + np.where(times > tau, 3 * np.exp(-k * (times - tau)), 0.0)

    taus = {"A": 5.13, "B": 7.3}
    noise = {name: 0.05 * random.standard_normal(len(times)) for name in taus}
    measured = trials({name: (times, course(0.4, tau) + noise[name]) for name, tau in taus.items()})
    law = cl.fit("y' = -0.4 y; t > tau: y = y + 3; y(0) = 5; 0 < tau < 12", measured)
    data = np.concatenate([trial.states[:, 0] for trial in measured])
    expected, errors = fitted(lambda p: np.concatenate([course(0.4, tau) for tau in p]), [*taus.values()], data)
    assert law.params["estimate"].to_numpy() == pytest.approx(expected, rel=1e-5)
    assert law.params["standard error"].to_numpy() == pytest.approx(errors, rel=1e-3)
    one, prior = measured.select(object="A"), {"tau": (6.0, 1e-4)}
    near = cl.fit("y' = -0.4 y; t > tau: y = y + 3; y(0) = 5; 5 < tau < 7", one, priors=prior)
    assert near.params.set_index("parameter")["estimate"]["tau"] == pytest.approx(6.0, abs=1e-2)


def test_a_tank_that_overflows_has_a_state_for_it():
    """What `equation-event-endless` advises; the solution of Euler's method in short steps."""
    times, steps = np.linspace(0, 20, 41), 100
    inflow, levels = 1.0 + (np.sin(0.7 * times) > 0), [0.3]
    for i in range(steps * (len(times) - 1)):
        now, h = np.interp((i + 0.5) / steps, np.arange(len(times)), inflow), (times[1] - times[0]) / steps
        levels.append(min(levels[-1] + h * (0.5 * now - 0.5 * np.sqrt(levels[-1])), 2.2))
    data = np.array(levels[::steps]) + 0.01 * np.random.default_rng(0).standard_normal(len(times))
    table = pd.DataFrame({"t": times, "h": data, "u": inflow})
    measured = cl.Trials.from_frame(table, time="t", states=["h"], inputs=["u"])
    text = "h' = (1 - s) (0.5 u - 0.5 sqrt(h)); s' = 0 s; s(0) = 0; h(0) = 0.3; h > top: s = 1; u < sqrt(h): s = 0"
    law = cl.fit(text, measured, input_interpolation="linear")
    (top,), (error,) = law.params["estimate"], law.params["standard error"]
    assert abs(top - 2.2) < 4 * error < 0.2 * 2.2


def test_events_go_with_doses():
    times = np.arange(0, 24, 0.5)

    def course(k, f, first):
        course = first * np.exp(-k * times) + 4 * np.exp(-k * (times - 6)) * (times > 6)
        return np.where(times > 10, f, 1.0) * course

    data = course(0.2, 0.5, 5.0) + 0.02 * np.random.default_rng(0).standard_normal(len(times))
    given = pd.DataFrame({"t": times, "y": data, "dose": np.where(times == 6, 4.0, 0.0)})
    measured = cl.Trials.from_frame(given, time="t", states=["y"], inputs=["dose"])
    law = cl.fit("y' = -k y + dose; t > 10: y = f y", measured, doses="dose")
    expected, _ = fitted(lambda p: course(*p), [0.2, 0.5, 5.0], data)
    k, f = law.params["estimate"]
    assert [k, f] == pytest.approx(expected[:2], rel=1e-4)
    (path,) = law.simulate(times, [5.0], doses={"dose": {6.0: 4.0}}).values()
    assert path.states[:, 0] == pytest.approx(course(k, f, 5.0), abs=1e-3)


def test_a_law_with_events_is_printed_saved_and_followed(ball):
    measured, law = ball
    assert [line for line in str(law).splitlines() if ":" in line] == ["x < 0: x = 0", "x < 0: v = -c v"]
    assert r"\mathrm{x\ <\ 0}:\ v &= -c v" in to_latex(law)
    again = from_json(to_json(law))
    assert again.observation == law.observation
    assert to_json(law) == to_json(again)
    assert BALL in to_script(law, "ball.csv")
    assert again.predict(measured, start="all").metric("rmse") == pytest.approx(0.01, rel=0.2)
    g, c = law.params["estimate"]
    (path,) = again.simulate(np.linspace(0, 1.5, 40), [1.0, 0.2]).values()
    assert path.states[:, 0] == pytest.approx(heights(path.times, g, c, 1.0, 0.2), abs=1e-6)
    assert path.outcome is None


def test_events_without_end_end_a_forecast_with_an_outcome(ball):
    measured, law = ball
    g, c = law.params["estimate"]
    end = np.sqrt(2 / g) * (1 + 2 * c / (1 - c))
    (path,) = law.simulate(np.linspace(0, 6, 601), [1.0, 0.0]).values()
    assert path.outcome.code == "diverged"
    assert path.ended == pytest.approx(end, abs=0.02)
    forecast = law.predict(measured, times=np.linspace(2.5, 10, 20))
    assert [path.outcome.code for path in forecast.trajectories] == ["diverged"]


def test_laws_with_events_are_refined_and_compared(ball):
    early = ball[0].until(0.9)
    text = "x'' = -g; x < 0: x = 0, v = -0.75 v; x(0) = 1.2; v(0) = 0.5"
    law, *given = (cl.fit(each, early) for each in (text, text.replace("0.75", "0.95").replace("g", "9.81")))
    again = cl.refine(law, early)
    assert again.params["estimate"].to_numpy() == pytest.approx(law.params["estimate"].to_numpy(), rel=1e-6)
    assert again.observation.events == law.observation.events
    assert cl.compare([*given, again], early)["law"].tolist() == ["law 2", "law 1"]


@pytest.mark.parametrize(
    ("code", "text"),
    [
        ("equation-event-syntax", "x'' = -g; 0 < x < 1: v = -c v"),
        ("equation-event-syntax", "x'' = -g; x < 0: v"),
        ("equation-event-syntax", "x'' = -g; x < 0: v = 1, v = 2"),
        ("condition-syntax", "x'' = -g; x < 0 and v < 0: v = -c v"),
        ("unknown-name", "x'' = -g; x < 0: w = 1"),
        ("equation-event-delay", "x'' = -g; x(t - d) < 0: v = -c v"),
        ("observation-of-discrete-time", "x[k+1] = a x; x < 0: x = 1"),
        ("equation-event-endless", "x' = a - b sqrt(x); x > top: x = top"),
        ("equation-event-endless", "x'' = -g; 2 x < 1: x = 0.5"),
    ],
)
def test_events_that_cannot_be_read_are_refused(ball, code, text):
    with refused(code):
        cl.fit(text, ball[0])


def test_what_cannot_have_events_refuses_them(ball):
    measured, law = ball
    with refused("equation-with-event"):
        cl.Law.from_text(BALL, {"g": 9.81})
    with refused("simulate-with-events"):
        law.simulate([0.0, 1.0], [1.0, 0.0], dense=True)
    with refused("no-finite-start-with-events"):  # At rest on the ground
        cl.fit("x'' = -9.81; x < 0: x = 0, v = 0; x(0) = 1; v(0) = 0", measured)
    # A time that later values do not depend on but by which samples are before it
    halves = trials({"A": (TIMES, np.where(TIMES < 1.01, 1.0, 0.5) * np.exp(TIMES))})
    with refused("parameters-not-identified"):
        cl.fit("y' = y; t > tau: y = y/2; y(0) = 1", halves)
