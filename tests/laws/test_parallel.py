"""Work in threads gives what it gives alone, in the same order, and ends when it is given up."""

import sys
from threading import Barrier, Event, current_thread, enumerate as running

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.law import to_json
from commonlaw.runtime.parallel import cores, in_parallel, threads
from tests.refusals import refused

TOGETHER = 20.0
"""Seconds that threads wait for each other at most."""


@pytest.fixture
def switching():
    """Let threads take turns so often that what they share is seen half done."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.mark.parametrize("n_jobs", [1, 2, 5])
def test_rows_come_back_in_their_order(n_jobs):
    told = []
    with threads(n_jobs):
        found = in_parallel(lambda a, b: 10 * a + b, range(20), range(1, 21), done=told.append)
    assert found == [11 * a + 1 for a in range(20)]
    assert told == list(range(1, 21))


def test_as_many_rows_are_done_at_a_time_as_there_are_threads():
    barrier = Barrier(3)
    with threads(3):
        assert sorted(in_parallel(lambda _: barrier.wait(TOGETHER), range(3))) == [0, 1, 2]


def test_threads_within_threads_are_no_more_than_were_asked_for():
    at_once, most = set(), []

    def inner(_):
        at_once.add(current_thread())
        most.append(len(running()))
        return current_thread()

    before = len(running())
    with threads(3), threads(50):
        in_parallel(lambda _: in_parallel(inner, range(20)), range(4))
    assert max(most) - before <= 2


def test_without_a_number_of_threads_everything_is_done_here():
    assert in_parallel(lambda _: current_thread(), range(5)) == [current_thread()] * 5


def test_the_first_row_that_fails_is_what_is_said():
    late = Event()

    def work(number):
        if number == 0:
            assert late.wait(TOGETHER)
            raise ValueError("first")
        if number == 1:
            late.set()
            raise ValueError("second")

    with threads(2), pytest.raises(ValueError, match="first"):
        in_parallel(work, range(9))


def test_whoever_is_interrupted_waits_for_nobody_and_they_begin_nothing_more():
    begun, may_go_on = Barrier(2), Event()
    here, before, done = current_thread(), {*running()}, []

    def work(_):
        begun.wait(TOGETHER)
        if current_thread() is here:
            raise KeyboardInterrupt
        assert may_go_on.wait(TOGETHER)
        in_parallel(done.append, range(3))

    with threads(2), pytest.raises(KeyboardInterrupt):
        in_parallel(work, range(2))
    (other,) = {*running()} - before
    may_go_on.set()
    other.join(TOGETHER)
    assert not other.is_alive()
    assert not done


@pytest.mark.parametrize("n_jobs", [0, -2, 1.0, True])
def test_what_is_no_number_of_threads_is_refused(n_jobs):
    with refused("n-jobs"), threads(n_jobs):
        pass


def test_there_are_as_many_threads_as_other_numerical_libraries_take(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    assert cores() == 3
    monkeypatch.delenv("OMP_NUM_THREADS")
    assert cores() >= 1


@pytest.mark.usefixtures("switching")
def test_a_law_is_the_same_for_any_number_of_threads():
    drag = tuple(np.linspace(-0.7, -0.1, 5).tolist())
    trials = cl.datasets.linear_drag(drag=drag, noise=0.05, samples=30, trials=1)
    laws = [
        cl.discover(trials, order=2, library="poly:2", method=cl.TrajectoryLikelihood(n_jobs=n_jobs), cache=False)
        for n_jobs in (1, 4)
    ]
    assert to_json(laws[0]) == to_json(laws[1])


def test_laws_fitted_and_compared_are_the_same_for_any_number_of_threads():
    trials = cl.datasets.linear_drag(drag=(-0.1, -0.3, -0.5), noise=0.05, samples=30, trials=1)
    texts, found = ("x'' = a + b v", "x'' = a"), []
    for n_jobs in (1, 3):
        laws = {text: cl.fit(text, trials, n_jobs=n_jobs) for text in texts}
        found.append((cl.compare(laws, trials, n_jobs=n_jobs).to_json(), *(to_json(law) for law in laws.values())))
    assert found[0] == found[1]
