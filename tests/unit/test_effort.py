"""Long work is announced with its length and shown as it goes on; what memory cannot hold is refused before it."""

from io import StringIO
from types import SimpleNamespace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.library import FourierLibrary, Variables, parse_library
from commonlaw.runtime import progress
from tests.refusals import refused


@pytest.mark.parametrize("method", [cl.WeakRegression(), cl.TrajectoryLikelihood()])
def test_a_library_that_memory_cannot_hold_is_refused_with_its_size(method):
    with refused("too-much-memory"):
        cl.discover(cl.datasets.linear_drag(noise=0.01), order=2, library="poly:100", method=method)


def test_work_of_less_than_a_minute_is_not_announced():
    progress.announce("this", 59.0, "do less")


def test_work_of_many_pieces_is_announced_by_what_the_first_take(monkeypatch):
    seconds = iter(np.arange(0.0, 1000.0, 6.0))
    monkeypatch.setattr(progress, "monotonic", lambda: next(seconds))
    with pytest.warns(cl.LongWorkWarning, match="integrating 100 trajectories will take about 20 minutes") as told:
        assert list(progress.announced(range(100), "integrating 100 trajectories", "take fewer")) == list(range(100))
    assert len(told) == 1


@pytest.mark.parametrize("text", ["fourier:500 * fourier:500", " * ".join(["poly:20"] * 8), "fourier:1000 * poly:30"])
def test_products_of_libraries_have_a_largest_number_of_terms(text):
    with refused("library-too-large", limit=100000):
        parse_library(text).bind(Variables(("x", "v")))


def test_a_fourier_library_of_many_variables_is_refused():
    with refused("library-too-large", count=200000):
        FourierLibrary(1000).bind(Variables(tuple(f"x{i}" for i in range(100))))


def test_simulations_that_memory_cannot_hold_are_refused():
    with refused("whole-number", name="samples", value=10**9, bounds="from 2 to 10000000"):
        cl.datasets.linear_drag(samples=10**9)
    with refused("too-much-memory", task="1000000000 trials of 5 objects, 49 samples each,"):
        cl.datasets.linear_drag(trials=10**9)


def test_pieces_of_longer_work_are_not_announced():
    @progress.unannounced()
    def piece():
        progress.announce("this", 600.0, "do less")

    piece()
    with pytest.warns(cl.LongWorkWarning, match="this will take about 10 minutes"):
        progress.announce("this", 600.0, "do less")


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
