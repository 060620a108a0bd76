"""Options that are hidden, and arguments in another order, are taken with a line that says what they are now."""

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


def test_options_of_tables_are_those_of_a_schema(run, asked, tmp_path):
    _, _, err = run("discover", "drops.csv", "--unit", "drag=1/s", "--clip")
    assert "--unit is deprecated here: describe the table by `commonlaw data check TABLE --unit ..." in err
    (tmp_path / "schema.toml").write_text('units = {drag = "1/s"}\nclip = true\nexclude = ["object=Ball 2"]')
    run("discover", "drops.csv", "--schema", "schema.toml")
    assert asked[0][0].schema == asked[1][0].schema
    assert asked[1][0].objects == ("Ball 1",)


@pytest.mark.usefixtures("asked")
def test_a_law_before_its_table_is_put_after_it(run):
    code, out, err = run("fit", "x'' = -g - c v", "drops.csv", "--save", "law.svg", "--save", "law.json")
    assert code == 0
    assert "the table comes first now: commonlaw fit TABLE ..." in err
    assert "Wrote law.svg" in out
    code, first, err = run("predict", "law.json", "drops.csv", "--initial-samples", "3")
    assert code == 0
    assert run("predict", "drops.csv", "law.json", "--initial-samples", "3") == (0, first, "")
