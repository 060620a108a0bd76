"""Orders by state on the command line."""

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl

EQUATIONS = "theta'' = -a sin(theta) - b theta' + k i; i' = -r i - m theta'"
OPTIONS = ["--library", "poly:1 + terms:sin(theta)"]


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
    assert "state: theta, i. Correct them by --time ..." in err
    assert "theta'' = " in out
    assert "i' = " in out
    assert cl.Law.load("law.json").order == (2, 1)
    assert run("predict", "motor.csv", "law.json", "--save", "forecast.csv")[0] == 0
    assert "theta forecast" in pd.read_csv("forecast.csv")
    out = run("compare", "motor.csv", EQUATIONS, "law.json")[1]
    assert "2 log B" in out


@pytest.mark.parametrize(
    ("order", "message"),
    [
        ("theta=3,i=1", "3 is not in the range"),
        ("theta=2,theta=1", "gives theta twice"),
        ("theta=2", "no order is given for i: give 1 or 2 for each state"),
        ("theta=0,i=1", "order 0 of theta is not supported"),
    ],
)
@pytest.mark.usefixtures("motor")
def test_orders_that_do_not_fit_are_refused(run, order, message):
    code, _, err = run("discover", "motor.csv", "--order", order, *OPTIONS)
    assert code != 0
    assert message in err


def test_a_table_of_generations_hints_at_the_option_for_discrete_time(run, tmp_path):
    sizes = [0.3]
    for _ in range(60):
        sizes.append(3.9 * sizes[-1] * (1 - sizes[-1]))
    noise = 0.01 * np.random.default_rng(3).standard_normal(61)
    frame = pd.DataFrame({"generation": range(61), "size": sizes + noise})
    frame.to_csv(tmp_path / "flies.csv", index=False)
    code, _, err = run("discover", "flies.csv", "--time", "generation")
    assert code == 0
    assert "discover a law in discrete time: --order 0" in err
    code, out, err = run("discover", "flies.csv", "--time", "generation", "--order", "0")
    assert code == 0
    assert "size[k+1] = " in out
    assert "discrete time" not in err
