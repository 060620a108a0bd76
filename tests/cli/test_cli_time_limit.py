"""The time that a search for a law may take, and Ctrl-C."""

import json

import pytest

import commonlaw as cl


@pytest.fixture
def drops(tmp_path):
    path = tmp_path / "drops.csv"
    cl.datasets.linear_drag(drag=(-0.1, -0.5), trials=1, noise=0.01).to_frame().to_csv(path, index=False)
    return path


def test_a_search_without_time_prints_and_saves_the_first_law_and_what_is_untried(run, done, drops, tmp_path):
    law = tmp_path / "law.json"
    code, out, err = run("discover", drops, "--time-limit", "0s", "--save", law)
    assert code == 0, err
    assert "x' = " in out
    assert "--time-limit None [search-stopped]" in err
    saved = cl.Law.load(law)
    assert saved.provenance.is_stopped
    assert "stopped after" in done("show", law, "--history")


@pytest.mark.parametrize("none", ["none", "None"])
def test_a_search_without_limit_tries_everything(done, drops, none):
    found = json.loads(done("discover", drops, "--time-limit", none, "--json"))
    assert "search-stopped" not in json.dumps(found)


@pytest.mark.parametrize("time", ["soon", "-1", "inf", "nan"])
def test_what_is_no_time_is_refused(fails, drops, time):
    assert "is no time" in fails("discover", drops, "--time-limit", time, code=2)


def test_a_method_that_cannot_be_limited_is_refused_with_a_limit_and_goes_on_without(done, fails, drops):
    method = ("--method", "derivative-regression", "--order", "2")
    assert "time-limit" in fails("discover", drops, *method, "--time-limit", "60s")
    assert "x'' = " in done("discover", drops, *method)
