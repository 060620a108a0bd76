"""`commonlaw predict` as a user meets it."""

import numpy as np
import pandas as pd
import pytest

from commonlaw.law import Law, Uncertainty
from commonlaw.library import Variables, parse_library
from commonlaw.trials import Schema


@pytest.fixture
def tank(tmp_path):
    """A law of a tank with a valve that a controller moves, x' = -x + u, and a table of it; the exact states."""
    terms = parse_library("terms:x,u").bind(Variables(("x",), ("u",)))
    known = Uncertainty([np.diag([0.01, 0.01]) ** 2], noise=[0.02])
    law = Law(terms, Schema(("x",), ("u",)), 1, ("tank",), np.array([[[-1.0, 1.0]]]), uncertainty=known)
    law.save(tmp_path / "law.json")
    valve, states = np.tile([0.0, 2.0, 1.0], 10), [1.5]
    for each in valve[:-1]:
        states.append(each + (states[-1] - each) * np.exp(-1))
    frame = pd.DataFrame({"object": "tank", "t": np.arange(30.0), "x": states, "u": valve})
    frame.to_csv(tmp_path / "tank.csv", index=False)
    return np.array(states)


def test_inputs_between_samples_are_as_the_user_says(run, tmp_path, tank):
    predict = "predict", "tank.csv", "law.json", "--initial-samples", "1", "--save", "out.csv"
    assert run(*predict, "--input-between", "held")[0] == 0
    np.testing.assert_allclose(pd.read_csv(tmp_path / "out.csv")["x forecast"], tank, atol=1e-6)
    for other in ([], ["--input-between", "linear"], ["--input-between", "cubic"]):
        assert run(*predict, *other)[0] == 0
        assert pd.read_csv(tmp_path / "out.csv")["x error"].abs().max() > 0.05
    code, _, err = run(*predict, "--input-between", "zoh")
    assert (code, "'zoh' is not one of 'held', 'linear', 'cubic'" in err) == (2, True)


@pytest.mark.usefixtures("tank")
def test_a_law_of_one_object_forecasts_a_table_that_names_none(run, tmp_path):
    frame = pd.read_csv(tmp_path / "tank.csv").drop(columns="object")
    frame.to_csv(tmp_path / "other.csv", index=False)
    code, out, err = run("predict", "other.csv", "law.json", "--initial-samples", "1")
    assert (code, "other" in out) == (0, True)
    assert err == "Note: no object is named: other has the coefficients of tank, the only object of the law\n"
    (tmp_path / "tank.toml").write_text('object_name = "tank"')
    words = ("--initial-samples", "1", "--schema", "tank.toml")
    assert run("predict", "other.csv", "law.json", *words)[2] == ""
    frame.assign(object="barrel").to_csv(tmp_path / "named.csv", index=False)
    code, _, err = run("predict", "named.csv", "law.json")
    assert (code, "unknown object of this law 'barrel'" in err) == (1, True)
    code, _, err = run("predict", "named.csv", "law.json", "--schema", "tank.toml")
    assert (code, "column 'object' names the objects: leave object_name = ..." in err) == (1, True)


@pytest.mark.usefixtures("tank")
def test_a_law_of_several_objects_asks_which_one_a_table_is_of(run, tmp_path):
    law = Law.load(tmp_path / "law.json")
    several = Law(law.terms, law.schema, 1, ("tank", "tub"), np.array([[[-1.0, 1.0]], [[-2.0, 1.0]]]))
    several.save(tmp_path / "several.json")
    pd.read_csv(tmp_path / "tank.csv").drop(columns="object").to_csv(tmp_path / "other.csv", index=False)
    code, _, err = run("predict", "other.csv", "several.json")
    assert (code, "the law has several: give object_name = ... (--schema), one of tank, tub" in err) == (1, True)
    (tmp_path / "schema.toml").write_text('object_name = "tub"')
    code, out, err = run("predict", "other.csv", "several.json", "--schema", "schema.toml")
    assert (code, err) == (0, "")
    assert "tub" in out


def test_forecasts_begin_at_a_time(run, tmp_path, tank):
    frame = pd.read_csv(tmp_path / "tank.csv")
    table = pd.concat([frame.assign(trial="long"), frame[:8].assign(trial="short")])
    table.to_csv(tmp_path / "two.csv", index=False)
    arguments = "predict", "two.csv", "law.json", "--input-between", "held", "--from", "12", "--save", "out.csv"
    code, out, err = run(*arguments, "--save", "out.png")
    assert (code, "short" in out) == (0, False)
    assert err.startswith("Note: trials not forecast (no samples before or from --from 12.0 on: 1 (ta")
    found = pd.read_csv(tmp_path / "out.csv")
    assert found["t"].tolist() == list(range(12, 30))
    np.testing.assert_allclose(found["x forecast"], tank[12:], atol=0.02)
    assert run(*arguments, "--until", "40", "--step", "2.5")[0] == 0
    assert {14.5, 40.0} <= set(pd.read_csv(tmp_path / "out.csv")["t"])
    code, _, err = run(*arguments[:-4], "--from", "100")
    assert (code, "no trial can be forecast (no samples before or from --from 100.0 on" in err) == (1, True)


@pytest.mark.usefixtures("tank")
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--until", "inf"], "--until inf: give a finite number"),
        (["--until", "nan"], "--until nan: give a finite number"),
        (["--step", "inf"], "--step inf: give a finite number"),
        (["--until", "1e12", "--step", "1e-3"], "1000000000000000 times of 1 trials would need"),
    ],
)
def test_times_without_end_are_refused(run, options, message):
    code, _, err = run("predict", "tank.csv", "law.json", *options)
    assert (code, message in err) == (1, True), err
