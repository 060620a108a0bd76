"""Files that a command cannot write, or must not, are refused before any work is done."""

import pytest

import commonlaw as cl
from commonlaw.cli import main

COLUMNS = ["--object", "object", "--trial", "trial", "--time", "t", "--state", "x"]
COMMANDS = {
    "discover": ["discover", "in.csv", *COLUMNS],
    "fit": ["fit", "in.csv", "x'' = -g - c v", *COLUMNS],
    "predict": ["predict", "in.csv", "law.json"],
    "refine": ["refine", "in.csv", "law.json"],
    "export": ["data", "export", "in.csv"],
}


@pytest.fixture
def refused(monkeypatch, capsys, tmp_path):
    """A function that runs a command which ends with a message before it loads anything, and returns the message."""
    monkeypatch.chdir(tmp_path)
    trials = cl.datasets.linear_drag(noise=0.01, seed=1)
    trials.to_csv("in.csv")
    cl.datasets.truth_of("linear-drag").save("law.json")
    (tmp_path / "folder").mkdir()
    (tmp_path / "link.csv").symlink_to("in.csv")
    before = {path: path.is_file() and path.read_bytes() for path in tmp_path.iterdir()}

    def call(*arguments):
        monkeypatch.setattr(cl.Trials, "read", lambda *_, **__: pytest.fail("read"))
        monkeypatch.setattr(cl.Law, "load", lambda *_, **__: pytest.fail("loaded"))
        monkeypatch.setattr("sys.argv", ["commonlaw", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 1
        assert {path: path.is_file() and path.read_bytes() for path in tmp_path.iterdir()} == before
        return capsys.readouterr().err

    return call


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("path", ["in.csv", "./in.csv", "link.csv"])
def test_the_table_is_not_written_over(refused, command, path):
    said = refused(*COMMANDS[command], "--save", path)
    assert (
        said
        == f"commonlaw: cannot write {path}: it is read here too; choose another name [commonlaw help output-twice]\n"
    )


@pytest.mark.parametrize("command", ["predict", "refine"])
def test_the_law_that_a_command_reads_is_not_written_over(refused, command):
    assert "cannot write law.json: it is read here too" in refused(*COMMANDS[command], "--save", "law.json")


@pytest.mark.parametrize("command", ["discover", "fit", "predict"])
@pytest.mark.parametrize("plot", ["s.svg", "./s.svg", "folder/../s.svg"])
def test_table_or_law_and_figure_are_not_written_to_one_file(refused, command, plot):
    said = refused(*COMMANDS[command], "--save", "s.svg", "--save", plot)
    assert said.startswith(f"commonlaw: cannot write {plot}: it is the same file as s.svg; choose another name [")


@pytest.mark.parametrize("command", ["discover", "fit", "predict"])
def test_a_figure_of_a_format_that_there_is_not_is_refused(refused, command):
    said = refused(*COMMANDS[command], "--save", "law.jpeg")
    assert said.startswith("commonlaw: law.jpeg: the ending says what is written")


@pytest.mark.parametrize("command", ["discover", "fit", "predict", "refine"])
@pytest.mark.parametrize("path", ["folder", "absent/law.json", "a" * 300, ""])
def test_a_file_that_cannot_be_written_is_refused(refused, command, path):
    assert refused(*COMMANDS[command], "--save", path).startswith(f"commonlaw: cannot write {path}: ")
