"""The command line as a user meets it."""

import json
import re
import shlex
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.law import Step, from_json, to_frame
from commonlaw.law.text import with_error

DROPS = ["--object", "ball", "--trial", "drop", "--time", "t", "--state", "height"]
ORDER = ["--order", "2", "--library", "poly:3"]
METHOD = cl.DerivativeRegression(differentiation="savgol:25:3", trim=8, solver="group-stlsq:1.5")
SETTINGS = [
    *ORDER, "--set", "differentiation=savgol:25:3", "--set", "trim=8", "--set", "solver=group-stlsq:1.5",
]  # fmt: skip


@cache
def drops():
    """Return simulated drops with columns of a user's own names, and their law, which has no errors."""
    frame = cl.datasets.linear_drag(noise=0.01, seed=1).to_frame()
    frame = frame[["object", "trial", "t", "x"]].set_axis(["ball", "drop", "t", "height"], axis=1)
    trials = cl.Trials.from_frame(frame, object="ball", trial="drop", time="t", states=["height"])
    return frame, cl.discover(trials, order=2, library="poly:3", method=METHOD)


@pytest.fixture
def law(tmp_path):
    """The law of a table, both saved."""
    frame, law = drops()
    frame.to_csv(tmp_path / "drops.csv", index=False)
    law.save(tmp_path / "law.json")
    return law


@pytest.mark.usefixtures("law")
def test_discover_predict_show_and_check_as_in_the_help(run, tmp_path):
    code, out, err = run("discover", "drops.csv", *DROPS, *SETTINGS, "--save", "law.json", "--save", "law.png")
    assert (code, err) == (0, "")
    assert "height'' = a + b v" in out
    assert "Ball 3" in out
    assert "Wrote law.json\nWrote law.png" in out
    assert (tmp_path / "law.png").read_bytes().startswith(b"\x89PNG")

    code, out, err = run("discover", "drops.csv", *DROPS, *SETTINGS, "--json")
    assert json.loads(out)["textbook"]["models"] == ["free-fall-with-linear-drag"]

    code, out, err = run("predict", "drops.csv", "law.json", "--save", "forecast.csv")
    assert (code, err) == (0, "")
    assert "rms error" in out
    forecast = pd.read_csv(tmp_path / "forecast.csv")
    assert list(forecast.columns) == ["ball", "drop", "t", "height", "height forecast", "height error"]
    assert np.abs(forecast["height error"]).median() < 0.1

    code, out, err = run("show", "law.json")
    law, ranges = out.split("\nRange of the training data (forecasts outside it are extrapolations):\n")
    law, quantities = law.split("\nDerived quantities:\n")
    saved = cl.Law.load(tmp_path / "law.json")
    assert (code, law.splitlines()[0], err) == (0, saved.structure[0], "")
    assert all(f"{value:.4g}" in law for value in saved.params["estimate"])
    assert (quantities.count("terminal speed"), quantities.count("Ball")) == (1, 5)
    assert [line.split()[0] for line in ranges.splitlines() if line.strip()][:4:2] == ["variable", "height"]
    assert "Reliable forecast horizon: 2.6 (error below half a standard deviation" in ranges
    code, out, err = run("show", "law.json", "--latex", "--average")
    assert "\\ddot{\\mathrm{height}} &= -9." in out

    code, out, err = run("data", "check", "drops.csv", *DROPS)
    assert (code, err) == (0, "")
    assert "drops.csv: 10 trials of 5 objects, measured: height" in out


def test_a_law_that_knows_how_accurate_it_is_says_so(run, done, law, tmp_path):
    steps = (Step("noise", "height: 0.01", "given"),)
    replace(
        law,
        uncertainty=replace(law.uncertainty, covariance=[np.diag([0.01, 0.0004])] * 5, noise=[0.01]),
        provenance=replace(law.provenance, history=steps),
    ).save("law.json")

    code, out, _ = run("show", "law.json")
    assert (code, "Ball 3" in out, "± 0.10" in out, "standard error" in out) == (0, True, True, True)
    assert "from" not in out
    code, out, _ = run("show", "law.json", "--history")
    assert "height: 0.01" in out
    done("predict", "drops.csv", "law.json", "--save", "forecast.csv", "--save", "bands.svg")
    forecast = pd.read_csv(tmp_path / "forecast.csv")
    assert np.all(forecast["height low"] < forecast["height forecast"])
    assert np.all(forecast["height high"] > forecast["height forecast"])
    assert np.all(forecast["height measured high"] - forecast["height high"] > 0)
    assert np.all(forecast["height measured low"] - forecast["height low"] < 0)
    assert "95 % band (measured)" in (tmp_path / "bands.svg").read_text()


def test_a_law_by_rates_is_refined(run, done, law, tmp_path):
    arguments = ("refine", "drops.csv", "law.json", "--noise")
    assert "±" in done(*arguments, "height=0.01", "--save", "refined.json")
    assert "maximum likelihood of" in run("show", "refined.json", "--history")[1]
    refined = cl.Law.load(tmp_path / "refined.json")
    np.testing.assert_array_equal(refined.support, law.support)
    assert refined.uncertainty.noise == pytest.approx([0.01])
    assert run(*arguments, "height=much")[0] == 2


def test_a_forecast_can_start_where_the_first_samples_say(run, fails, law):
    replace(law, uncertainty=replace(law.uncertainty, noise=[0.01])).save("law.json")
    found = {}
    for start in (1, 15, "all"):
        code, out, err = run("predict", "drops.csv", "law.json", "--initial-samples", str(start), "--json")
        assert (code, err) == (0, "")
        found[start] = np.mean([row["rms error"] for row in json.loads(out)["errors"]])
    assert found["all"] < found[15] < found[1] / 2
    assert "start is 0: give the number of first samples" in fails(
        "predict", "drops.csv", "law.json", "--initial-samples", "0"
    )


@pytest.mark.usefixtures("law")
def test_forecasts_go_beyond_what_was_measured(done, tmp_path):
    drops = pd.read_csv(tmp_path / "drops.csv")
    ahead = "predict", "drops.csv", "law.json", "--until", "9", "--step", "0.5", "--save", "a.csv", "--save", "a.svg"
    done(*ahead)
    forecast, wanted = pd.read_csv(tmp_path / "a.csv"), np.arange(0.0, 9.1, 0.5)
    last = drops["t"].max()
    assert set(forecast["t"][forecast["t"] > last]) == set(wanted[wanted > last])
    assert forecast["height forecast"].notna().all()
    drops["height"] = drops["height"].where(drops.groupby(["ball", "drop"]).cumcount() < 12)
    drops.to_csv(tmp_path / "given.csv", index=False)
    done("predict", "given.csv", "law.json", "--save", "b.csv")
    forecast = pd.read_csv(tmp_path / "b.csv")
    assert len(forecast) == len(drops)
    assert forecast["height forecast"].notna().all()
    assert forecast["height error"].notna().sum() == drops["height"].notna().sum()


def test_errors_intervals_and_history_are_printed_where_they_are_known(run, done):
    fit = "fit", "dataset:linear-drag:noise=0.05:seed=1:trials=1", "x'' = -g - c v"
    out = done(*fit, "--save", "law.json")
    row = next(line for line in out.splitlines() if "Ball 3" in line)
    found = json.loads(run(*fit, "--json")[1])
    law = from_json(json.dumps(found["law"]))
    assert [each["standard error"] for each in found["intervals"]] == law.params["standard error"].tolist()
    assert [each["stage"] for each in found["history"]] == [each.stage for each in law.history]
    history = done("show", "law.json", "--history")
    assert all(each["stage"] in history for each in found["history"])
    estimate, error = law.params.query("object == 'Ball 3'")[["estimate", "standard error"]].to_numpy()[0]
    assert with_error(estimate, error).split() == row.split()[2:5]
    arguments = ("discover", "dataset:linear-drag:noise=0.01:seed=1", *SETTINGS)
    assert json.loads(done(*arguments, "--save", "search.json", "--json"))["intervals"] is None
    assert "There is no record of how the law was found." in done("show", "search.json", "--history")


@pytest.mark.usefixtures("law")
def test_json_holds_the_law_its_equations_and_the_errors_of_the_held_out_trials(run):
    code, out, _ = run("discover", "drops.csv", *DROPS, *SETTINGS, "--where", "drop=1", "--json")
    found = json.loads(out)
    assert code == 0
    assert list(found["equations"]) == [f"Ball {i}" for i in range(1, 6)]
    assert from_json(json.dumps(found["law"])).equations("Ball 2") == tuple(found["equations"]["Ball 2"])
    assert found["forecast"]["of"] == "held out"
    assert {row["drop"] for row in found["forecast"]["errors"]} == {"2"}
    assert found["forecast"]["score"] > 0.999


def test_a_data_set_shows_its_truth_beside_what_was_learned(run):
    code, out, _ = run("discover", "dataset:linear-drag:noise=0.01:seed=1", *SETTINGS, "--json")
    found = json.loads(out)
    assert code == 0
    truth, learned = (to_frame(from_json(json.dumps(found[key]))) for key in ("truth", "law"))
    assert (np.abs(learned / truth[learned.columns] - 1) < 0.03).all(axis=None)
    code, out, _ = run("discover", "dataset:linear-drag:noise=0.01:seed=1", *SETTINGS)
    assert "true b" in out


def test_known_terms_and_each_objects_own_terms(done):
    own = ["--known", "1=-9.8", "--set", "differentiation=finite:6", "--set", "solver=stlsq:0.05"]
    out = done("discover", "dataset:linear-drag:noise=0", *ORDER, *own, "--json")
    assert json.loads(out)["equations"]["Ball 4"] == ["x'' = -9.8 - 0.5 v"]


def test_the_real_drops_give_the_printed_law_from_the_command_line(run, ball_drops_folder):
    code, out, err = run(
        "discover", f"dataset:ball-drops:folder={ball_drops_folder}", "--where", "trial=2", "--order", "2",
        "--library", "poly:3", "--set", "differentiation=savgol:35:3", "--set", "solver=group-stlsq:1.5",
    )  # fmt: skip
    assert code == 0
    assert "x'' = a + b v" in out
    row = next(line for line in out.splitlines() if "Golf Ball" in line)
    assert row.split()[2:4] == ["-9.443", "-0.03013"]
    assert "Forecasts of 10 held-out trials" in out
    assert "clipped" in err


def test_export_writes_a_table_that_reads_back(run, tmp_path):
    code, out, _ = run("data", "export", "dataset:linear-drag:noise=0.05", "--save", "drops.parquet")
    assert (code, out) == (0, "Wrote drops.parquet\n")
    again, original = cl.Trials.read(tmp_path / "drops.parquet"), cl.datasets.linear_drag(noise=0.05)
    assert again.schema == original.schema
    for one, other in zip(again, original, strict=True):
        np.testing.assert_array_equal(one.states, other.states)


def test_the_data_sets_are_listed(done):
    out = done("data", "list")
    for name in cl.datasets.DATASETS:
        assert name in out


@pytest.mark.parametrize("command", [[], ["discover"], ["predict"], ["show"], ["data"], ["data", "check"]])
def test_every_command_explains_itself(done, command):
    assert "Usage: commonlaw" in done(*command, "--help")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["discover"], "Missing argument 'TABLE'. Give a file, or a data set, dataset:NAME"),
        (["discover", "a.csv", "--order", "3"], "3 is not in the range 0<=x<=2"),
        (["discover", "dataset:lorenz", "--known", "1:9.8"], "'1:9.8' is not of the form NAME=VALUE"),
        (["discover", "dataset:lorenz", "--known", "1=g"], "'g' is not a number"),
        (["discvoer"], "No such command 'discvoer'"),
        (["predict", "a.csv"], "Missing argument 'LAW.json'"),
        (["fit", "a.csv"], "Missing argument 'EQUATIONS'"),
        (["show"], "Missing argument 'LAW.json'"),
        (["data", "export", "dataset:lorenz"], "Missing option '--save'"),
    ],
)
def test_wrong_usage_ends_with_2(fails, arguments, message):
    assert message in fails(*arguments, code=2)


def test_the_short_help_of_discover_lists_the_options_of_every_day(run):
    _, out, _ = run("discover", "--help")
    listed = re.findall(r"^  (--[a-z-]+)", out.partition("\nTable:")[2], re.MULTILINE)
    assert listed == [
        "--schema", "--object", "--trial", "--time", "--state", "--where", "--hold-out", "--order", "--library",
        "--time-limit", "--noise", "--set", "--save", "--json", "--help-all",
    ]  # fmt: skip
    assert "more options: commonlaw discover --help-all" in out


def test_the_help_of_discover_groups_options_by_method(run):
    _, out, _ = run("discover", "--help-all")
    heads = [line.rstrip(":") for line in out.splitlines() if line.endswith(":") and not line.startswith(" ")]
    assert heads == [
        "Table",
        "Law",
        "Method",
        "Output",
        "Several files",
        "Cluster",
        "Options",
        "Settings of a fit, --set NAME=VALUE, --method trajectory-likelihood",
        "Settings of --method derivative-regression",
        "Settings of --method weak-regression",
    ]


@pytest.mark.parametrize(
    ("options", "method"),
    [
        ([], None),
        (["--noise", "x=0.1"], cl.TrajectoryLikelihood(noise={"x": 0.1})),
        (["--set", "seed=3"], cl.TrajectoryLikelihood(seed=3)),
        (["--set", "solver=best-subset"], cl.DerivativeRegression(solver="best-subset")),
        (["--set", "trim=2", "--set", "n_jobs=2"], cl.DerivativeRegression(trim=2, n_jobs=2)),
        (["--set", "radii=9", "--set", "radii=20"], cl.WeakRegression(radii=(9.0, 20.0))),
        (["--method", "weak-regression", "--set", "n_resamples=0"], cl.WeakRegression(n_resamples=0)),
        (["--order", "0", "--set", "rule=bic"], cl.DiscreteTimeRegression(rule="bic")),
        (
            ["--method", "trajectory-likelihood", "--set", "solver=best-subset"],
            cl.TrajectoryLikelihood(solver="best-subset"),
        ),
    ],
)
def test_options_make_the_method_that_has_them(run, monkeypatch, options, method):
    asked = []

    def discover(*_, **parameters):
        asked.append(parameters["method"])
        raise cl.CommonlawError("other", text="enough")

    monkeypatch.setattr("commonlaw.discover", discover)
    run("discover", "dataset:linear-drag", *options)
    assert asked == [method]


def test_options_of_other_methods_are_left_out_where_these_do_not_take_the_order(run):
    code, _, err = run("discover", "dataset:lorenz", "--order", "0", "--set", "errors=white")
    assert code == 2
    assert " ".join(err.split()).endswith(
        "the setting errors does not go with --method discrete-time-regression: leave it out"
    )


def test_standard_deviations_are_left_out_by_the_options_that_the_message_names(run, done, tmp_path):
    rows = "".join(f"{i},{0.5**i},{0.01 * (1 + i % 2)}\n" for i in range(20))
    (tmp_path / "map.csv").write_text(f"t,x,x_std\n{rows}")
    code, _, err = run("discover", "map.csv", "--order", "0", "--library", "poly:1")
    assert code == 1
    (named,) = re.findall(r"--noise-column '' of commonlaw data check --save --state '\w+'", err.replace(",", ""))
    (tmp_path / "schema.toml").write_text("noise_columns = {}")
    words = ["--schema", "schema.toml", *shlex.split(named)[-2:]]
    assert "x[k+1] = 0.5 x" in done("discover", "map.csv", "--order", "0", "--library", "poly:1", *words)


def test_messages_are_in_the_words_of_the_command_line(run, tmp_path):
    (tmp_path / "few.csv").write_text("ticker,U [V],wind speed\n0,3,1\n1,2,2\n2,1.5,1\n4,1.2,2\n5,1.1,1\n")
    code, _, err = run("discover", "few.csv")
    assert code == 1
    assert "Name it with --time ...; columns: ticker, U, wind speed" in err
    named = ["few.csv", "--time", "ticker", "--state", "U"]
    run("discover", *named, "--save", "law.json")
    assert "known noise is given by noise={'U': ...}" in run("show", "law.json", "--history")[1]
    run("discover", *named, "--noise", "U [V]=0.03", "--save", "law.json")
    out = run("show", "law.json", "--history")[1]
    assert "U: 0.03 V" in out
    assert "as given" in out
    solver = ["--method", "trajectory-likelihood", "--set", "solver=best-subset:1"]
    assert run("discover", *named, *solver)[2].endswith(
        "use --method derivative-regression --set solver=... [commonlaw help solver-with-value]\n"
    )
    assert "or give it with --unit ...\n" in run("data", "check", *named)[1]


def test_of_a_table_of_thousands_the_first_rows_are_printed(done, tmp_path):
    rows = [f"{trial},{time},{trial + time}" for trial in range(1200) for time in range(3)]
    (tmp_path / "short.csv").write_text("\n".join(["trial,t,x", *rows]))
    out = done("data", "check", "short.csv")
    assert "clip" not in out
    assert " ... and 200 more rows" in out.splitlines()
    assert sum(line.startswith(" short") for line in out.splitlines()) == 1000


def test_a_remark_that_holds_for_many_trials_is_made_once(run, tmp_path):
    rows = [f"{tree},{age},{age / 10 + tree}" for tree in range(5) for age in (118 + tree, 484, 664, 1004, 1231)]
    (tmp_path / "trees.csv").write_text("\n".join(["object,age [day],girth [mm]", *rows]))
    _, out, _ = run("data", "check", "trees.csv")
    assert [line for line in out.splitlines() if line.startswith("Data check: ")] == [
        "Data check: in 5 cases, such as 0, trial 1: irregular sampling: steps are up to 104 day off their median "
        "284 day"
    ]


def test_a_code_is_explained_and_a_command_is_helped(run):
    assert "What to do: add trials with other initial values of <first>." in run("help", "confounded")[1]
    assert run("help", "data", "check")[1].startswith("Usage: commonlaw data check")
    assert run("help", "time-mising")[2].startswith(
        "commonlaw: no message has the code 'time-mising': did you mean 'time-mis"
    )
