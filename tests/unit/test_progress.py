"""How far work has come is told on a terminal, without harm to it or to the work."""

from io import StringIO
from types import SimpleNamespace

import pytest

from commonlaw.runtime import progress


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
    monkeypatch.setattr(progress, "SECONDS_UNTIL_SHOWN", -1.0)
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


def test_the_time_that_is_left_follows_from_the_share_that_is_done(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(progress, "monotonic", lambda: now[0])
    course = progress.Elapsed()
    course.take("smoothing")
    now[0] = 110.0
    assert str(course) == "smoothing (10 s)"
    course.take(progress.Stage("choosing", 0.25))
    assert str(course) == "choosing (10 s, 25 % done, about 30 s left)"
    now[0] = 120.0
    assert str(course) == "choosing (20 s, 25 % done, about 20 s left)"
    course.take("a step that says no share")
    assert "25 % done, about 20 s left" in str(course)
    now[0] = 200.0
    assert str(course).endswith("(2 min, 25 % done)")


def test_shares_of_a_part_are_shares_of_the_whole():
    taken = []
    tell = progress.part(
        progress.part(lambda step: taken.append((step, getattr(step, "done", None))), 0.5, 1.0), 0.0, 0.5
    )
    tell(progress.Stage("half", 0.5))
    tell("first")
    assert taken == [("half", 0.625), ("first", 0.5)]
