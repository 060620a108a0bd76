"""A schema file stands for the options of a table."""

import tomllib

import pytest

import commonlaw as cl

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
    code, out, err = run("data", "check", LONG_FILE, *options, "--save", "schema.toml")
    assert (code, "Wrote schema.toml" in out) == (0, True), err
    by_options = read(run, monkeypatch, *options)
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
def test_what_is_no_schema_is_refused(run, tmp_path, content):
    (tmp_path / LONG_FILE).write_text(LONG)
    (tmp_path / "schema.toml").write_bytes(content)
    code, out, err = run("discover", LONG_FILE, "--schema", "schema.toml")
    assert (code, out) == (1, "")
    assert "help table-schema]" in err
