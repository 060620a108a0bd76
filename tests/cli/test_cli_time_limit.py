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
    assert "search-stopped" in err
    assert "--time-limit None" in err
    saved = cl.Law.load(law)
    assert saved.provenance.is_stopped
    assert "stopped after" in done("show", law, "--history")


def test_a_stopped_search_goes_on(done, fails, drops, tmp_path, monkeypatch):
    monkeypatch.setenv("COMMONLAW_CACHE", str(tmp_path / "cache"))
    law = tmp_path / "law.json"
    done("discover", drops, "--order", "2", "--time-limit", "0", "--save", law)
    assert cl.Law.load(law).provenance.is_stopped
    assert "resume-with-other-trials" in fails("discover", drops, "--exclude", "object=Ball 1", "--resume", law)
    assert "resume-with-changes" in fails("discover", drops, "--library", "poly:1", "--resume", law)
    done("discover", drops, "--resume", law, "--save", tmp_path / "whole.json")
    assert cl.Law.load(tmp_path / "whole.json").structure == ("x'' = a + b v",)
    assert "resume-complete" in fails("discover", drops, "--resume", tmp_path / "whole.json")
    assert "--each" in fails("discover", drops, drops, "--each", "--resume", law, code=2)


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
