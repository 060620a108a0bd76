"""A column of standard deviations on the command line."""

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl

TIMES = np.linspace(0, 10, 60)
LEVELS = np.where(np.arange(60) % 3 == 0, 0.02, 0.3)


@pytest.fixture
def cups(tmp_path):
    """A table of a cup that cools, written as cups.csv."""
    states = 2 + 5 * np.exp(-0.3 * TIMES) + LEVELS * np.random.default_rng(0).standard_normal(60)
    frame = pd.DataFrame({"t": TIMES, "T": states, "s": LEVELS})
    frame.to_csv(tmp_path / "cups.csv", index=False)
    return frame


def test_deviations_are_heeded_by_every_command(run, done, cups):
    done("data", "check", "cups.csv", "--noise-column", "T=s", "--save", "schema.toml")
    code, out, err = run("discover", "cups.csv", "--schema", "schema.toml", "--save", "law.json")
    assert (code, err) == (0, "")
    assert "T' = a + b T" in out
    out = run("show", "law.json", "--history")[1]
    assert "as given for each measurement, T by s; their median" in out
    assert cl.Law.load("law.json").schema.noise_columns == {"T": "s"}

    # The column is found by the name that it had
    run("predict", "cups.csv", "law.json", "--save", "forecast.csv")
    widths = pd.read_csv("forecast.csv").eval("`T measured high` - `T measured low`")
    assert widths[30] < 0.3 * widths[31]
    done("refine", "cups.csv", "law.json", "--save", "refined.json")
    assert "T by s" in run("show", "refined.json", "--history")[1]
    code, out, _ = run("compare", "cups.csv", "T' = a + b T", "law.json", "--schema", "schema.toml")
    assert (code, "0.5" in out) == (0, True)

    # A table that has none is forecast with a typical one
    cups[["t", "T"]].to_csv("bare.csv", index=False)
    run("predict", "bare.csv", "law.json", "--save", "forecast.csv")
    widths = pd.read_csv("forecast.csv").eval("`T measured high` - `T measured low`")
    assert widths[30] == pytest.approx(widths[31], rel=0.05)


@pytest.mark.usefixtures("cups")
@pytest.mark.parametrize(
    ("schema", "options", "message"),
    [
        ("noise_columns = {x = 's'}", [], "cups.csv: noise_columns = ... in the --schema file: unknown state 'x'"),
        ("noise_columns = {T = 's'}", ["--noise", "T=1"], "the noise of 'T' is given as an option and in column 's'"),
        (
            "noise_columns = {T = 's'}",
            ["--set", "solver=stlsq"],
            "read the table with noise_columns = {} in the --schema file, --state 'T', or use --method trajectory",
        ),
    ],
)
def test_what_does_not_fit_is_refused_in_words_of_the_command(run, tmp_path, schema, options, message):
    (tmp_path / "schema.toml").write_text(schema)
    code, _, err = run("discover", "cups.csv", "--schema", "schema.toml", *options)
    assert code != 0
    assert message in err
