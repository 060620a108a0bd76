"""What tests of the command line share."""

import pytest

from commonlaw.cli import main, working


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """Run the command in an empty folder; return exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(working, "INTERVAL", 1e6)  # However slow the machine, nothing is said of progress

    def call(*arguments):
        monkeypatch.setattr("sys.argv", ["commonlaw", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        return ended.value.code, captured.out, captured.err

    return call
