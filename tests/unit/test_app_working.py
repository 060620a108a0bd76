"""Work goes on in a process of its own: what it makes and says is taken in, and its end is told, however it comes."""

import os
import time

import pytest

from commonlaw.app.working import Work
from commonlaw.errors import CommonlawError


def fails(show):
    show("counting")
    yield 1
    raise CommonlawError("name it with time=...")


def dies(show):
    show("counting")
    yield 1
    os._exit(3)


@pytest.mark.parametrize(
    ("task", "failure"), [(fails, "name it with 'time' under Columns"), (dies, "ended by itself, with code 3")]
)
def test_what_was_made_stays_when_work_fails(task, failure):
    work = Work(task)
    until = time.monotonic() + 60
    while work.is_running and time.monotonic() < until:
        time.sleep(0.05)
    told = work.state()
    assert failure in told["failure"]
    assert (work.made, told["made"], told["running"]) == (1, 1, False)
    assert [what for what, _ in told["stages"]] == ["starting", "counting"]
    work.cancel()  # changes nothing any more
    assert work.state()["failure"] == told["failure"]
