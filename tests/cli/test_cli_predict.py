"""Forecasts, held-out trials and schemas on the command line."""

import json
import tomllib

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
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


def test_inputs_between_samples_are_as_the_user_says(done, fails, tmp_path, tank):
    predict = "predict", "tank.csv", "law.json", "--initial-samples", "1", "--save", "out.csv"
    done(*predict, "--input-interpolation", "held")
    np.testing.assert_allclose(pd.read_csv(tmp_path / "out.csv")["x forecast"], tank, atol=1e-6)
    for other in ([], ["--input-interpolation", "linear"], ["--input-interpolation", "cubic"]):
        done(*predict, *other)
        assert pd.read_csv(tmp_path / "out.csv")["x error"].abs().max() > 0.05
    assert "'zoh' is not one of 'held', 'linear', 'cubic'" in fails(*predict, "--input-interpolation", "zoh", code=2)


@pytest.mark.usefixtures("tank")
def test_a_law_of_one_object_forecasts_a_table_that_names_none(run, fails, tmp_path):
    frame = pd.read_csv(tmp_path / "tank.csv").drop(columns="object")
    frame.to_csv(tmp_path / "other.csv", index=False)
    code, out, err = run("predict", "other.csv", "law.json", "--initial-samples", "1")
    assert (code, "other" in out) == (0, True)
    assert err == "Note: no object is named: other has the coefficients of tank, the only object of the law\n"
    (tmp_path / "tank.toml").write_text('object_name = "tank"')
    words = ("--initial-samples", "1", "--schema", "tank.toml")
    assert run("predict", "other.csv", "law.json", *words)[2] == ""
    frame.assign(object="barrel").to_csv(tmp_path / "named.csv", index=False)
    assert "unknown object of this law 'barrel'" in fails("predict", "named.csv", "law.json")
    assert "column 'object' names the objects: leave object_name = ..." in fails(
        "predict", "named.csv", "law.json", "--schema", "tank.toml"
    )


@pytest.mark.usefixtures("tank")
def test_a_law_of_several_objects_asks_which_one_a_table_is_of(run, fails, tmp_path):
    law = Law.load(tmp_path / "law.json")
    several = Law(law.terms, law.schema, 1, ("tank", "tub"), np.array([[[-1.0, 1.0]], [[-2.0, 1.0]]]))
    several.save(tmp_path / "several.json")
    pd.read_csv(tmp_path / "tank.csv").drop(columns="object").to_csv(tmp_path / "other.csv", index=False)
    assert "the law has several: give --object-name ... of commonlaw data check --save, one of tank, tub" in fails(
        "predict", "other.csv", "several.json"
    )
    (tmp_path / "schema.toml").write_text('object_name = "tub"')
    code, out, err = run("predict", "other.csv", "several.json", "--schema", "schema.toml")
    assert (code, err) == (0, "")
    assert "tub" in out


def test_forecasts_begin_at_a_time(run, done, fails, tmp_path, tank):
    frame = pd.read_csv(tmp_path / "tank.csv")
    table = pd.concat([frame.assign(trial="long"), frame[:8].assign(trial="short")])
    table.to_csv(tmp_path / "two.csv", index=False)
    arguments = "predict", "two.csv", "law.json", "--input-interpolation", "held", "--from", "12", "--save", "out.csv"
    code, out, err = run(*arguments, "--save", "out.png")
    assert (code, "short" in out) == (0, False)
    assert err.startswith("Note: trials not forecast (no samples before or from --from 12.0 on: 1 (ta")
    found = pd.read_csv(tmp_path / "out.csv")
    assert found["t"].tolist() == list(range(12, 30))
    np.testing.assert_allclose(found["x forecast"], tank[12:], atol=0.02)
    done(*arguments, "--until", "40", "--step", "2.5")
    assert {14.5, 40.0} <= set(pd.read_csv(tmp_path / "out.csv")["t"])
    assert "no trial can be forecast (no samples before or from --from 100.0 on" in fails(
        *arguments[:-4], "--from", "100"
    )


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


@pytest.mark.usefixtures("tank")
@pytest.mark.parametrize("options", [["--until", "0"], ["--from", "12", "--until", "11"]])
def test_an_end_before_the_beginning_is_refused(run, options):
    assert run("predict", "tank.csv", "law.json", *options)[0] == 2


@pytest.mark.usefixtures("tank")
def test_forecasts_end_before_the_last_sample_too(run, done, tmp_path):
    frame = pd.read_csv(tmp_path / "tank.csv")
    later = frame[20:].assign(trial="late")
    pd.concat([frame.assign(trial="long"), later]).to_csv(tmp_path / "two.csv", index=False)
    code, out, err = run("predict", "two.csv", "law.json", "--until", "12", "--step", "4", "--save", "out.csv")
    assert (code, "late" in out, "1 (tank, trial late)" in err) == (0, False, True)
    assert pd.read_csv(tmp_path / "out.csv")["t"].tolist() == list(range(13))
    last = json.loads(done("predict", "tank.csv", "law.json", "--until", "12", "--json"))["errors"][0]["last error"]
    assert last == pytest.approx(abs(pd.read_csv(tmp_path / "out.csv")["x error"].iloc[-1]))


@pytest.mark.usefixtures("tank")
def test_times_of_a_file_are_refused_without_one(fails):
    assert "--save" in fails("predict", "tank.csv", "law.json", "--step", "0.5", code=2)


@pytest.mark.usefixtures("tank")
def test_a_forecast_of_one_sample_has_no_score(done, tmp_path):
    pd.read_csv(tmp_path / "tank.csv")[:1].to_csv(tmp_path / "one.csv", index=False)
    assert "nan" not in done("predict", "one.csv", "law.json")


@pytest.fixture
def table(tmp_path):
    """Three objects that decay, twice each."""
    times, noise = np.linspace(0.0, 4.0, 40), np.random.default_rng(5)
    pairs = [(name, rate) for name, rate in (("a", 0.5), ("b", 0.7), ("c", 1.0)) for _ in range(2)]
    states = [5 * np.exp(-rate * times) + noise.normal(0, 0.05, 40) for _, rate in pairs]
    trials = cl.Trials.from_arrays([times] * 6, states, object=[name for name, _ in pairs])
    trials.to_csv(tmp_path / "decays.csv")


def learned(run, *options):
    """Return what `commonlaw fit` says about the decays with these options."""
    code, out, err = run("fit", "decays.csv", "x' = -k x", *options, "--json")
    assert (code, err) == (0, "")
    document = json.loads(out)
    trials = {(each["object"], each["trial"]) for each in document["forecast"]["errors"]}
    return document, trials, sorted(document["law"]["coefficients"])


@pytest.mark.usefixtures("table")
def test_trials_that_are_held_out_are_forecast(run):
    document, trials, objects = learned(run, "--hold-out", "trial=2")
    assert document["forecast"]["of"] == "held out"
    assert trials == {("a", "2"), ("b", "2"), ("c", "2")}
    assert objects == ["a", "b", "c"]
    same, *_ = learned(run, "--where", "trial=1")
    assert same["law"]["coefficients"] == document["law"]["coefficients"]


@pytest.mark.usefixtures("table")
def test_excluded_trials_are_neither_learned_from_nor_forecast(run):
    _, trials, objects = learned(run, "--exclude", "object=a", "--exclude", "trial=2", "--hold-out", "trial=1")
    assert trials == {("b", "1"), ("c", "1")}
    assert objects == ["b", "c"]
    _, trials, objects = learned(run, "--exclude", "object=a,b")
    assert trials == {("c", "1"), ("c", "2")}
    assert objects == ["c"]


@pytest.mark.usefixtures("table")
def test_samples_after_a_time_can_be_held_out(run, tmp_path):
    document, trials, _ = learned(run, "--learn-until", "2")
    early = cl.Trials.read(tmp_path / "decays.csv").until(2.0)
    assert max(each.times[-1] for each in early) <= 2 < max(each.times[-1] + 4 / 39 for each in early)
    law = cl.fit("x' = -k x", early)
    assert document["law"]["coefficients"]["a"] == law.coefficients[0].tolist()
    assert len(trials) == 6


def test_the_figure_of_a_forecast_may_be_its_phase_plane(run, done, tmp_path):
    cl.datasets.lotka_volterra(trials=1).until(5.0).select(object=["Pair 1", "Pair 5"]).to_csv(tmp_path / "pairs.csv")
    cl.datasets.truth_of("lotka-volterra").save("law.json")
    done("predict", "pairs.csv", "law.json", "--phase-plane", "--save", "plane.svg")
    drawn = (tmp_path / "plane.svg").read_text()
    assert all(f"<!-- {each} -->" in drawn for each in ("Pair 1", "Pair 5", "saddle", "centre of its linearization"))
    cl.datasets.lorenz().until(1.0).to_csv(tmp_path / "lorenz.csv")
    cl.datasets.truth_of("lorenz").save("lorenz.json")
    code, _, err = run("predict", "lorenz.csv", "lorenz.json", "--phase-plane", "--save", "none.svg")
    assert (code, "none.svg was not made: the law has the states x, y, z" in err) == (1, True)
    assert run("predict", "lorenz.csv", "lorenz.json", "--phase-plane")[0] == 2
    assert not (tmp_path / "none.svg").exists()


@pytest.mark.usefixtures("table")
def test_the_verdict_is_on_what_was_held_out(run, done):
    for option, judged_on in (
        (("--hold-out", "trial=2"), "held-out trials"),
        (("--learn-until", "2"), "held-out later samples"),
        ((), "whole trials"),
    ):
        document, *_ = learned(run, *option)
        verdict = document["verdict"]
        assert (verdict["judged_on"], verdict["usable"]) == (judged_on, True)
        first = verdict["sentences"][0]
        assert first.startswith("This law can be used for forecasts" if option else "Forecasts its training data well")
    document, *_ = learned(run, "--hold-out", "object=a")
    assert document["verdict"]["unknown_objects"] == ["a"]
    assert "\nThis law can be used for forecasts up to" in done(
        "discover", "decays.csv", "--library", "poly:1", "--learn-until", "2"
    )


READ = ["--object", "who", "--trial", "run", "--time", "s", "--state", 'a "b"', "--property", "mass"]

LONG = 'who,run,s,"a ""b"" [m]",u,mass [kg]\n' + "".join(
    f"{who},{run},{0.1 * i:.1f},{i * i + k}.5,{i},{k + 1}\n"
    for k, who in enumerate("pq")
    for run in (1, 2)
    for i in range(8)
)

LONG_FILE, NAMELESS = "drops.csv", "t,x\n" + "".join(f"{i},{i}.5\n" for i in range(8))
RUNS = "run,t,x\n" + "".join(f"{run},{i},{i}.5\n" for run in (1, 2, 3) for i in range(8))
WIDE = "t,a,b\n" + "".join(f"{i},{i}.5,{2 * i}.5\n" for i in range(8))


def read(run, monkeypatch, *options):
    """Return the trials that `commonlaw discover` learns from."""
    learned = []

    def discover(training, **_):
        learned.append(training)
        raise cl.CommonlawError("other", text="enough")

    monkeypatch.setattr("commonlaw.discover", discover)
    _, _, err = run("discover", LONG_FILE, *options)
    assert "enough" in err
    return learned[0]


@pytest.mark.parametrize(
    ("table", "options"),
    [
        (LONG, READ),
        (LONG, [*READ, "--unit", "u=V", "--input", "u"]),
        (RUNS, ["--object", "", "--trial", "run", "--exclude", "run=2"]),
        (LONG, []),
        (NAMELESS, []),
        (NAMELESS.replace("x", "x,sd_x", 1).replace(".5", ".5,0.1"), []),
        (NAMELESS.replace("x", "x,sd_x", 1).replace(".5", ".5,0.1"), ["--noise-column", "x=sd_x"]),
        (NAMELESS.replace("x", "x,sd_x", 1).replace(".5", ".5,0.1"), ["--noise-column", ""]),
        (NAMELESS, ["--object-name", "ball"]),
        (WIDE, ["--wide", "OD [mm]"]),
        (WIDE.replace(",", ";").replace(".", ","), ["--decimal", ",", "--wide", "OD"]),
    ],
)
def test_a_schema_gives_the_trials_that_the_options_give(run, tmp_path, monkeypatch, table, options):
    (tmp_path / LONG_FILE).write_text(table)
    checked, check = list[cl.Trials](), cl.Trials.check

    def kept_and_checked(trials, **how):
        checked.append(trials)
        return check(trials, **how)

    monkeypatch.setattr(cl.Trials, "check", kept_and_checked)
    code, out, err = run("data", "check", LONG_FILE, *options, "--save", "schema.toml")
    assert (code, "Wrote schema.toml" in out) == (0, True), err
    (by_options,) = checked
    kept = options[options.index("--exclude") :] if "--exclude" in options else []
    by_schema = read(run, monkeypatch, "--schema", "schema.toml", *kept)
    assert by_schema.schema == by_options.schema
    assert by_schema.to_frame().equals(by_options.to_frame())
    assert by_schema.properties == by_options.properties


def test_options_win_over_the_schema(run, tmp_path, monkeypatch):
    (tmp_path / LONG_FILE).write_text(LONG)
    run("data", "check", LONG_FILE, *READ, "--save", "schema.toml")
    assert tomllib.loads((tmp_path / "schema.toml").read_text())["states"] == ['a "b"']
    trials = read(run, monkeypatch, "--schema", "schema.toml", "--state", "u")
    assert trials.schema.states == ("u",)
    assert trials.schema.object == "who"


@pytest.mark.parametrize("content", [b"object = 1", b"colour = 'red'", b"object", b"\xff", b"a = " + b"[" * 100_000])
def test_what_is_no_schema_is_refused(fails, tmp_path, content):
    (tmp_path / LONG_FILE).write_text(LONG)
    (tmp_path / "schema.toml").write_bytes(content)
    assert "help table-schema]" in fails("discover", LONG_FILE, "--schema", "schema.toml")
