"""Orders by state on the command line."""

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl

EQUATIONS = "theta'' = -a sin(theta) - b theta' + k i; i' = -r i - m theta'"
OPTIONS = ["--library", "poly:1 + terms:sin(theta)", "--no-cache"]


@pytest.fixture
def motor(tmp_path):
    """A table of a pendulum on a motor, written as motor.csv."""
    true = {"a": 4.0, "b": 0.3, "k": 1.5, "r": 1.2, "m": 0.4}
    swing = cl.Law.from_text(EQUATIONS, true).simulate(np.linspace(0, 6, 90), [1.2, 1.0, 0.5])["object"]
    values = swing.states[:, :2] + 0.01 * np.random.default_rng(1).standard_normal((90, 2))
    frame = pd.DataFrame({"t": swing.times, "theta": values[:, 0], "i": values[:, 1]})
    frame.to_csv(tmp_path / "motor.csv", index=False)


@pytest.mark.usefixtures("motor")
def test_orders_are_given_by_state(run):
    code, out, err = run("discover", "motor.csv", "--order", "theta=2,i=1", *OPTIONS, "--save", "law.json")
    assert (code, err.count("\n")) == (0, 1)
    assert "state: theta, i. If not, say --time ..." in err
    assert "theta'' = " in out
    assert "i' = " in out
    assert cl.Law.load("law.json").order == (2, 1)
    assert run("predict", "law.json", "motor.csv", "--save", "forecast.csv")[0] == 0
    assert "theta forecast" in pd.read_csv("forecast.csv")
    out = run("fit", EQUATIONS, "motor.csv", "--against", "law.json")[1]
    assert "2 log B" in out


@pytest.mark.parametrize(
    ("order", "message"),
    [
        ("theta=3,i=1", "3 is not in the range"),
        ("theta=2,theta=1", "gives theta twice"),
        ("theta=2", "order says nothing of i: give 1 or 2 for each state"),
        ("theta=0,i=1", "order 0 of theta is not supported"),
    ],
)
@pytest.mark.usefixtures("motor")
def test_orders_that_do_not_fit_are_refused(run, order, message):
    code, _, err = run("discover", "motor.csv", "--order", order, *OPTIONS)
    assert code != 0
    assert message in err
