"""Work goes on in a process of its own: what it makes and says is taken in, and its end is told, however it comes."""

import os
import sys
import time

import psutil
import pytest

from commonlaw.app.working import Work, prepare
from commonlaw.errors import CommonlawError
from commonlaw.runtime.progress import Stage


def fails(show):
    show("counting")
    yield 1
    raise CommonlawError("time-missing", columns=["a"])


def dies(show):
    show(Stage("counting", 0.5))
    show("counting again")
    yield 1
    os._exit(3)


@pytest.mark.parametrize(
    ("task", "failure", "done", "stages"),
    [
        (
            fails,
            "which column holds the time? Name it with 'time' under Columns; columns: a",
            None,
            ["starting", "counting"],
        ),
        (dies, "ended by itself, with code 3", 0.5, ["starting", "counting", "counting again"]),
    ],
)
def test_what_was_made_stays_when_work_fails(task, failure, done, stages):
    work = Work(task)
    until = time.monotonic() + 60
    while work.is_running and time.monotonic() < until:
        time.sleep(0.05)
    told = work.state()
    assert failure in told["failure"]
    assert (work.made, told["made"], told["running"]) == (1, 1, False)
    assert ([what for what, _ in told["stages"]], told["done"]) == (stages, done)
    work.cancel()  # changes nothing any more
    assert work.state()["failure"] == told["failure"]


def waits(_):
    yield 1
    time.sleep(1000)


def test_work_that_is_closed_is_gone_without_a_trace():
    work = Work(waits)
    until = time.monotonic() + 60
    while not work.times_made and time.monotonic() < until:
        time.sleep(0.05)
    assert work.is_running
    process = work._process.pid
    work.close()
    assert work.state()["failure"] == "cancelled"
    assert not psutil.pid_exists(process)  # nor is it a zombie


def imported(_):
    yield os.getpid(), "commonlaw.discovery" in sys.modules


def test_a_process_that_was_prepared_does_the_next_work_only():
    prepare()
    prepare()
    ended = [Work(imported) for _ in range(2)]
    until = time.monotonic() + 60
    while any(each._listener.is_alive() for each in ended) and time.monotonic() < until:
        time.sleep(0.05)
    (first, warm), (second, cold) = (each.made for each in ended)
    assert (warm, cold) == (True, False)
    assert first != second
    assert not any(psutil.pid_exists(each) for each in (first, second))
