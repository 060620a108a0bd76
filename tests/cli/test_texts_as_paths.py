"""A text that may be the name of a file, or an equation, is tried as one whatever its length and its signs."""

import numpy as np
import pytest

from commonlaw.runtime.files import is_file, is_folder

LONG = "a" * 300
TEXTS = [LONG, f"{LONG}.json", f"{LONG}.csv", f"{LONG}.parquet", "a/" * 3000, f"*{LONG}", "x**2*.csv", "**a/[", "a\0b"]


@pytest.fixture
def table(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = [f"{time},{np.exp(-0.5 * time) + 1e-3 * np.sin(30 * time)}" for time in np.linspace(0, 3, 20)]
    (tmp_path / "T.csv").write_text("\n".join(["t,x", *rows]))
    return "T.csv"


def test_an_equation_of_more_characters_than_a_name_may_have_is_fitted(run, table):
    code, out, _ = run("fit", table, "x' = -k x" + " + 0 x" * 60)
    assert code == 0
    assert "0.50" in out


@pytest.mark.parametrize("text", TEXTS[:-1], ids=range(len(TEXTS) - 1))
def test_no_text_in_the_place_of_a_file_ends_in_a_traceback(run, table, text):
    commands = (
        ("fit", table, text),
        ("fit", text, "x' = -k x"),
        ("fit", text),
        ("data", "check", text),
        ("show", text),
        ("predict", table, text),
        ("discover", table, "--known", text),
        ("compare", table, text, text),
    )
    for command in commands:
        code, _, err = run(*command)
        assert code in (1, 2), command
        assert "Traceback" not in err


@pytest.mark.parametrize("text", TEXTS, ids=range(len(TEXTS)))
def test_a_text_that_no_file_can_have_as_its_name_is_none(text):
    assert not is_file(text)
    assert not is_folder(text)
