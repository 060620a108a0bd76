"""Work goes on in a process of its own: what it makes and says is taken in, and its end is told, however it comes."""

import os
import signal
import sys
import threading
import time
import warnings
from contextlib import suppress
from functools import partial

import psutil
import pytest

from commonlaw.app.working import Work, prepare
from commonlaw.errors import CommonlawError
from commonlaw.runtime.progress import Interim, Stage
from commonlaw.runtime.time_limit import OutOfTimeError, check, limit_of, limited


def ended(*tasks):
    """Return work that was begun at once when it has ended and its process is kept or gone."""
    begun: list[Work] = [Work(task) for task in tasks]
    for work in begun:
        work._listener.join(60)
    return begun


def fails(show):
    show("counting")
    yield os.getpid()
    raise CommonlawError("time-missing", columns=["a"])


def dies(show):
    show(Stage("counting", 0.5))
    show("counting again")
    yield os.getpid()
    os._exit(3)


def waits(_):
    yield os.getpid()
    time.sleep(1000)


def searches(show):
    show(Interim("best law so far: x' = a x"))
    yield os.getpid()
    limit = limit_of(None)
    limit.take_result()
    with suppress(OutOfTimeError), limited(limit):
        while True:
            check()
            time.sleep(0.01)
    yield os.getpid(), "stopped"


def warns(_):
    warnings.warn("of this task", stacklevel=1)
    yield os.getpid(), "commonlaw.discovery" in sys.modules


def test_what_was_made_stays_when_work_fails_or_its_process_dies():
    (failed,) = ended(fails)
    (died,) = ended(dies)
    for work, failure, done, stages in (
        (failed, "Name it with 'time' under Columns; columns: a", None, ["counting"]),
        (died, "ended by itself, with code 3", 0.5, ["counting", "counting again"]),
    ):
        state = work.state()
        assert failure in state["failure"]
        assert (state["made"], state["running"], state["done"]) == (1, False, done)
        assert [what for what, _ in state["stages"]] == ["starting", *stages]
        work.cancel()  # changes nothing any more
        assert work.state()["failure"] == state["failure"]
    assert failed.made == died.made  # A process that has ended its work does the next
    assert not psutil.pid_exists(died.made)


def divides(_):
    yield os.getpid()
    yield 1 / (os.getpid() - os.getpid())


def breaks(*_):
    raise LookupError("on arrival")


class Breaking:
    """What can be sent, but not received."""

    def __reduce__(self):
        return breaks, ()


def sends(make, _):
    yield os.getpid()
    yield make()


def is_killed(_):
    yield os.getpid()
    os.kill(os.getpid(), signal.SIGKILL)


def runs_out(_):
    yield os.getpid()
    raise MemoryError


@pytest.mark.parametrize(
    ("task", "made", "code", "word"),
    [
        pytest.param(divides, 1, "work-failed", "ZeroDivisionError", marks=pytest.mark.slow),
        (partial(sends, Breaking), 1, "work-failed", "LookupError"),
        pytest.param(partial(sends, threading.Lock), 1, "work-failed", "TypeError", marks=pytest.mark.slow),
        (threading.Lock().__enter__, 0, "work-failed", "TypeError"),
        (runs_out, 1, "work-out-of-memory", "memory"),
        (is_killed, 1, "work-ended", "code -9"),
    ],
)
def test_whatever_fails_is_shown_within_two_seconds(task, made, code, word):
    work = Work(task)
    until = time.monotonic() + 60
    while work.times_made < made and time.monotonic() < until:
        time.sleep(0.01)
    began = time.monotonic()
    while work.is_running and time.monotonic() < until:
        time.sleep(0.01)
    state = work.state()
    assert (state["running"], state["made"]) == (False, made)
    assert time.monotonic() - began < 2
    assert word in state["failure"]
    assert state["failure"].endswith(f"[{code}]")


def test_work_that_is_stopped_goes_on_with_what_it_has_and_its_process_does_the_next():
    work = Work(searches)
    until = time.monotonic() + 60
    while not work.times_made and time.monotonic() < until:
        time.sleep(0.01)
    assert work.state()["interim"] == "best law so far: x' = a x"
    process = work.made
    work.stop()
    work.stop()
    work._listener.join(60)
    assert work.made == (process, "stopped")
    assert not work.state()["failure"]
    work.stop()  # changes nothing any more
    (after,) = ended(fails)
    assert after.made == process


def test_work_that_is_closed_is_gone_without_a_trace():
    work = Work(waits)
    until = time.monotonic() + 60
    while not work.times_made and time.monotonic() < until:
        time.sleep(0.01)
    assert work.is_running
    work.close()
    assert work.state()["failure"] == "cancelled"
    assert not psutil.pid_exists(work.made)  # nor is it a zombie


def test_a_process_that_was_prepared_does_the_next_work_and_one_of_those_that_have_ended_theirs_the_work_after_it():
    ended(dies)  # whichever process an earlier test has left waiting
    prepare()
    prepare()
    first, second = ended(warns, warns)
    (after,) = ended(warns)
    (prepared, is_warm), (new, is_also_warm) = first.made, second.made
    assert (is_warm, is_also_warm) == (True, False)
    assert prepared != new
    assert after.made[0] in (prepared, new)
    assert all([what for what, _ in work.state()["stages"]] == ["starting", "of this task"] for work in (first, after))
    ended(dies)
    assert not any(psutil.pid_exists(process) for process in (prepared, new))
