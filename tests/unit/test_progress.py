"""How far work has come is told on a terminal, without harm to it or to the work."""

from io import StringIO
from types import SimpleNamespace

import pytest

from commonlaw import progress


class Terminal(StringIO):
    """What stands for a terminal."""

    is_open = True

    def isatty(self):
        return True

    def write(self, text):
        if not self.is_open:
            raise OSError(5, "Input/output error")
        return super().write(text)


@pytest.fixture
def terminal(monkeypatch):
    """A terminal that is standard error, where people want to know at once."""
    opened = Terminal()
    monkeypatch.setattr(progress, "PATIENCE", -1.0)
    monkeypatch.setattr(progress, "sys", SimpleNamespace(stderr=opened))
    return opened


def test_steps_are_told_with_nothing_that_the_terminal_obeys(terminal):
    progress.on_terminal()("fitting ball\x1b[2J\n")
    assert terminal.getvalue() == "commonlaw: fitting ball\\u001b[2J\\n (0 s)\n"


def test_a_terminal_that_is_closed_does_not_end_the_work(terminal):
    tell = progress.on_terminal()
    terminal.is_open = False
    tell("fitting")


def test_nothing_is_told_where_standard_error_is_closed(terminal, monkeypatch):
    monkeypatch.setattr(progress, "sys", SimpleNamespace(stderr=None))
    progress.on_terminal()("fitting")
    assert terminal.getvalue() == ""
