"""Words of the last release are taken for one more, with a line that says what they are now."""

import pytest

import commonlaw as cl

FIT = ("fit", "drops.csv", "x'' = -g - c v", "--save", "law.json")


@pytest.fixture
def asked(monkeypatch, tmp_path):
    """What `discover` was asked, whose table is drops.csv."""
    cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.05, trials=1).to_csv(tmp_path / "drops.csv")
    found = []

    def discover(training, **parameters):
        found.append((training, parameters))
        raise cl.CommonlawError("other", text="enough")

    monkeypatch.setattr("commonlaw.discover", discover)
    return found


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (["--errors", "white"], ["--set", "errors=white"]),
        (["--huber-threshold=3"], ["--set", "huber_threshold=3"]),
        (["--positive", "x", "--jobs", "2"], ["--set", "log_states=x", "--set", "n_jobs=2"]),
        (["--no-partial-pooling"], ["--set", "partial_pooling=false"]),
        (["--unmeasured", "1"], ["--set", "latent_states=1"]),
        (["--solver", "group-stlsq:1.5", "--trim", "3"], ["--set", "solver=group-stlsq:1.5", "--set", "trim=3"]),
    ],
)
def test_options_of_methods_are_settings(run, asked, old, new):
    _, _, err = run("discover", "drops.csv", *old)
    assert all(
        f"is deprecated: write {option} {setting}" in err for option, setting in zip(new[::2], new[1::2], strict=True)
    )
    run("discover", "drops.csv", *new)
    (_, one), (_, other) = asked
    assert one["method"] == other["method"] is not None


def test_a_data_set_is_a_table(run, asked):
    _, _, err = run("discover", "--order", "2", "--dataset", "linear-drag:noise=0.01")
    assert "write dataset:linear-drag:noise=0.01 in place of TABLE" in err
    assert len(asked[0][0].objects) == 5


def test_options_of_tables_are_those_of_a_schema(run, asked, tmp_path):
    _, _, err = run("discover", "drops.csv", "--unit", "drag=1/s", "--clip")
    assert "--unit is deprecated here: describe the table by `commonlaw data check TABLE --unit ..." in err
    (tmp_path / "schema.toml").write_text('units = {drag = "1/s"}\nclip = true\nexclude = ["object=Ball 2"]')
    run("discover", "drops.csv", "--schema", "schema.toml")
    assert asked[0][0].schema == asked[1][0].schema
    assert asked[1][0].objects == ("Ball 1",)


@pytest.mark.usefixtures("asked")
def test_a_law_before_its_table_is_put_after_it(run):
    code, out, err = run("fit", "x'' = -g - c v", "drops.csv", "--plot", "law.svg", "--save", "law.json")
    assert code == 0
    assert "the table comes first now: commonlaw fit TABLE ..." in err
    assert "--plot is deprecated: write --save" in err
    assert "Wrote law.svg" in out
    code, first, err = run("predict", "law.json", "drops.csv", "--start", "3")
    assert (code, "--start is deprecated: write --initial-samples" in err) == (0, True)
    code, second, err = run("predict", "drops.csv", "law.json", "--initial-samples", "3")
    assert (code, first) == (0, second)
    assert "deprecated" not in err
    assert run("show", "law.json", "--object", "Ball 1")[1] == run("show", "law.json", "--select", "Ball 1")[1]


@pytest.mark.usefixtures("asked")
def test_steps_are_said_by_an_option_of_commonlaw(run):
    _, _, err = run("discover", "drops.csv", "-v")
    assert "write commonlaw -v discover ..." in err
    assert " s  reading the table" in err
