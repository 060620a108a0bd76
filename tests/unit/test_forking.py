"""A process that is forked while other threads compute does not wait for what these hold."""

import ast
import os
import time
from pathlib import Path
from threading import Event, Thread

import pytest

import commonlaw
from commonlaw.runtime.forking import ProcessLock, cached_property
from commonlaw.trials.headers import _LOADING, parse_unit


def ends_well(function):
    """Return whether a forked process gets something true from a function within ten seconds."""
    child = os.fork()
    if not child:
        os._exit(0 if function() else 1)
    for _ in range(1000):
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return status == 0
        time.sleep(0.01)
    os.kill(child, 9)
    os.waitpid(child, 0)
    return False


@pytest.fixture
def busy():
    """Run a function in a thread that is given two events: it sets the first and waits for the second."""
    began, may_end, threads = Event(), Event(), []

    def run(function):
        threads.append(Thread(target=function, args=(began, may_end)))
        threads[-1].start()
        assert began.wait(20)

    yield run
    may_end.set()
    for thread in threads:
        thread.join()


class Number:
    def __init__(self, wait=lambda: None):
        self.wait = wait

    @cached_property
    def value(self):
        """One."""
        self.wait()
        return 1


def test_a_cached_property_that_another_thread_computes_is_computed_in_a_forked_process(busy):
    def compute(began, may_end):
        return Number(lambda: began.set() or may_end.wait(30)).value

    busy(compute)
    assert ends_well(lambda: Number().value)


@pytest.mark.parametrize("lock", [ProcessLock(), _LOADING])
def test_a_lock_that_another_thread_holds_is_free_in_a_forked_process(busy, lock):
    def hold(began, may_end):
        with lock.held():
            began.set()
            may_end.wait(30)

    def take():
        with lock.held():
            return lock is not _LOADING or parse_unit("m")

    busy(hold)
    assert ends_well(take)


def test_a_cached_property_is_computed_once_and_kept():
    counts = []
    number = Number(lambda: counts.append(1))
    assert (number.value, number.value, len(counts)) == (1, 1, 1)
    assert Number.value.__doc__ == "One."


def test_no_module_has_a_cached_property_with_a_lock():
    for path in Path(commonlaw.__file__).parent.rglob("*.py"):
        text = path.read_text()
        if "cached_property" not in text or "functools" not in text:  # Parsing all takes seconds
            continue
        imports = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom)]
        names = [name.name for node in imports if node.module == "functools" for name in node.names]
        assert "cached_property" not in names or path.name == "forking.py", path
