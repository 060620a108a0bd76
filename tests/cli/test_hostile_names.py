"""Names of strangers reach neither a terminal nor LaTeX alive, in whatever command they are shown."""

import json
import re
from xml.etree.ElementTree import fromstring

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.law import select_objects, to_latex
from commonlaw.plots import plot_trials, render

CLEAR = "\x1b[2J\x1b]0;title\x07"
BALL, STATE = f"ball{CLEAR}\nNote: all is well\n\\input{{/etc/passwd}}", f"height\x9b31m\u202e {CLEAR}"
CONTROLS = re.compile("[\0-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


@pytest.fixture
def named(tmp_path, monkeypatch):
    """A folder with a table and a law whose names are hostile, by the names of their files."""
    monkeypatch.chdir(tmp_path)
    times = np.arange(40) / 15
    frame = {STATE: np.tile(50 - 4.9 * times**2, 2), "t": np.tile(times, 2), "object": [BALL] * 40 + ["b"] * 40}
    trials = cl.Trials.from_frame(pd.DataFrame(frame))
    trials.to_csv("drops.csv")
    law = cl.discover(trials, order=2, library="poly:1", method=cl.DerivativeRegression(solver="group-stlsq:1"))
    law.save("law.json")
    return law


COMMANDS = {
    "check": ["data", "check", "drops.csv"],
    "check as JSON": ["data", "check", "drops.csv", "--json"],
    "discover": ["discover", "drops.csv", "--order", "2", "--set", "solver=group-stlsq:1"],
    "discover as JSON": ["discover", "drops.csv", "--order", "2", "--set", "solver=group-stlsq:1", "--json"],
    "predict": ["predict", "drops.csv", "law.json"],
    "show": ["show", "law.json", "--history"],
    "show an object": ["show", "law.json", "--select", BALL],
    "show LaTeX": ["show", "law.json", "--latex"],
    "an unknown object": ["show", "law.json", "--select", f"c{CLEAR}"],
    "an unknown file": ["show", f"law{CLEAR}.json"],
    "an unknown option": ["show", "law.json", f"--no{CLEAR}"],
    "an unknown command": [f"show{CLEAR}"],
    "a value that does not fit": ["discover", "drops.csv", "--order", CLEAR],
    "a state that is not there": ["data", "check", "drops.csv", "--state", f"hight{CLEAR}"],
}


@pytest.mark.usefixtures("named")
@pytest.mark.parametrize("arguments", COMMANDS.values(), ids=COMMANDS)
def test_nothing_that_a_terminal_obeys_is_printed(run, arguments):
    code, out, err = run(*arguments)
    assert code == (0 if out else 2 if "Usage" in err else 1)
    assert CONTROLS.findall(out + err) == []
    assert "\nNote: all is well" not in out + err
    assert "\n\\input" not in out


@pytest.mark.usefixtures("named")
def test_json_holds_the_names_as_they_are(run):
    _, out, _ = run("discover", "drops.csv", "--order", "2", "--set", "solver=group-stlsq:1", "--json")
    assert set(json.loads(out)["equations"]) == {BALL, "b"}


def test_a_law_that_is_printed_in_python_is_harmless_too(named):
    for text in (str(named), to_latex(named, "b")):
        assert CONTROLS.findall(text) == []
        assert "\nNote: all is well" not in text
    with pytest.raises(cl.CommonlawError) as refused:
        select_objects(named, [f"c{CLEAR}"])
    assert CONTROLS.findall(str(refused.value)) == []


@pytest.mark.usefixtures("named")
def test_a_figure_with_such_names_is_drawn(tmp_path):
    trials = cl.Trials.read(tmp_path / "drops.csv")
    assert fromstring(render(plot_trials(trials), ".svg")).tag.endswith("svg")
