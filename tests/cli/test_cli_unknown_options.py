"""Options that a command does not have are refused, with the command that has them."""

import pytest

import commonlaw as cl
from commonlaw.cli.learning import compare, discover, fit, refine
from commonlaw.cli.options import options_of_check
from commonlaw.cli.saved_law import bounds, check, design, discrepancy, predict, report

OF_TABLES = [
    (command.name, option)
    for command in (discover, fit, compare, refine, bounds, check, design, discrepancy, predict, report)
    for option in options_of_check(command).values()
]


@pytest.mark.parametrize(("command", "option"), OF_TABLES)
def test_options_of_tables_lead_to_a_schema(fails, command, option):
    err = fails(command, "a.csv", option, "x", code=2)
    assert f"commonlaw data check TABLE {option} ... --save schema.toml, and give --schema schema.toml" in err


@pytest.mark.parametrize(
    ("words", "written"),
    [
        (("fit", "a.csv", "x' = -x", "--history"), "commonlaw show LAW.json --history"),
        (("refine", "a.csv", "law.json", "--history"), "commonlaw show LAW.json --history"),
        (("predict", "a.csv", "law.json", "--rival", "b.json"), "commonlaw design [TABLE] LAW.json --rival"),
    ],
)
def test_an_option_of_a_single_command_leads_to_it(fails, words, written):
    assert fails(*words, code=2).endswith(written)


@pytest.mark.parametrize(
    "words", [("discover", "--no-cache"), ("show", "--json"), ("predict", "--histroy"), ("app", "-x")]
)
def test_other_unknown_options_lead_to_no_command(fails, words):
    assert "commonlaw" not in fails(*words, code=2).partition("No such option")[2]


def test_a_schema_holds_what_options_of_data_check_say(done, run, monkeypatch, tmp_path):
    cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.05, trials=1).to_csv(tmp_path / "drops.csv")
    learned = []

    def discover_nothing(training, **_):
        learned.append(training)
        raise cl.CommonlawError("other", text="enough")

    monkeypatch.setattr("commonlaw.discover", discover_nothing)
    options = ("--unit", "drag=1/s", "--clip", "--exclude", "object=Ball 2")
    done("data", "check", "drops.csv", *options, "--save", "schema.toml")
    run("discover", "drops.csv", "--schema", "schema.toml")
    assert learned[0].schema.units["drag"] == "1/s"
    assert learned[0].objects == ("Ball 1",)
