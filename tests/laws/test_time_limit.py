"""A search under a limit of time returns the best law so far, complete, and says what it has not tried."""

import signal
from threading import Event

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.discovery import cache
from commonlaw.discovery.best_so_far import LawSoFar
from commonlaw.law import from_json, to_json
from commonlaw.runtime.time_limit import TimeLimit, stoppable, stopped_by_interrupts
from tests.refusals import refused

DROPS = cl.datasets.linear_drag(drag=(-0.1, -0.5), trials=1, noise=0.01)


def codes(law):
    return [outcome.code for outcome in law.diagnostics]


@pytest.fixture(scope="module")
def at_once():
    return cl.discover(DROPS, time_limit=0, cache=False)


@pytest.fixture(scope="module")
def whole():
    return cl.discover(DROPS, cache=False)


def test_a_search_without_time_returns_its_first_law_with_errors_and_says_what_is_untried(at_once):
    assert at_once.order == 1
    assert np.isfinite(at_once.params["standard error"]).all()
    assert at_once.provenance.is_stopped
    (stopped,) = [outcome for outcome in at_once.diagnostics if outcome.code == "search-stopped"]
    assert "laws of order 2" in stopped.text
    assert [step.stage for step in at_once.history][-1] == "search"
    assert "search-stopped" in str(at_once)


def test_a_file_of_a_law_keeps_that_its_search_was_stopped(at_once):
    again = from_json(to_json(at_once))
    assert again.provenance.is_stopped
    assert codes(again) == codes(at_once)


def test_a_limit_that_does_not_strike_changes_nothing(whole):
    limited = cl.discover(DROPS, time_limit=3600, cache=False)
    assert not limited.provenance.is_stopped
    np.testing.assert_array_equal(limited.coefficients, whole.coefficients)
    np.testing.assert_array_equal(limited.params["standard error"], whole.params["standard error"])
    assert codes(limited) == codes(whole)
    assert limited.structure == whole.structure == ("x'' = a + b v",)


def test_laws_are_shown_as_they_come_each_better_than_the_one_before(whole):
    steps = list[str]()
    cl.discover(DROPS, progress=steps.append, cache=False)
    shown = [step.law for step in steps if isinstance(step, LawSoFar)]
    assert len(shown) > 1
    assert shown[-1].structure == whole.structure
    np.testing.assert_allclose(shown[-1].coefficients, whole.coefficients, rtol=1e-2)


def test_of_a_stopped_law_only_steps_are_kept_and_a_complete_one_serves_a_shorter_time(tmp_path, monkeypatch, whole):
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path))
    assert cl.discover(DROPS, time_limit=0).order == 1
    assert [path.suffix for path in tmp_path.iterdir()] == [".steps"]
    assert cl.discover(DROPS).structure == whole.structure
    assert cl.discover(DROPS, time_limit=0).structure == whole.structure


def test_an_event_ends_a_search_without_a_limit_with_the_law_that_was_shown():
    stop, shown = Event(), list[cl.Law]()
    stop.set()
    with stoppable(stop):
        law = cl.discover(DROPS, progress=lambda step: shown.append(getattr(step, "law", None)), cache=False)
    assert law.provenance.is_stopped
    assert [each for each in shown if each][-1].structure == law.structure


@pytest.fixture
def interruptible():
    """Ctrl-C ends the program; jobs in the background ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupt(step=None):
    if step is None or isinstance(step, LawSoFar):
        signal.raise_signal(signal.SIGINT)


@pytest.mark.usefixtures("interruptible")
def test_the_first_interrupt_ends_a_search_with_its_best_law():
    said = list[str]()
    with stopped_by_interrupts(lambda: said.append("stopping")):
        law = cl.discover(DROPS, progress=interrupt, cache=False)
    assert law.provenance.is_stopped
    assert said == ["stopping"]


@pytest.mark.usefixtures("interruptible")
def test_the_second_interrupt_ends_the_program():
    with stopped_by_interrupts(lambda: None):
        interrupt()
        with pytest.raises(KeyboardInterrupt):
            interrupt()


def test_time_for_errors_is_kept_as_long_as_the_first_law_took():
    seconds = [0.0]
    limit = TimeLimit(60, clock=lambda: seconds[0])
    seconds[0] = 100.0
    assert not limit.is_over  # The first law is awaited
    limit = TimeLimit(60, clock=lambda: seconds[0])
    seconds[0] += 10
    limit.take_result()
    seconds[0] += 39
    assert not limit.is_over
    with limit.until(1 / 2):
        assert limit.is_over
    seconds[0] += 2
    assert limit.is_over


@pytest.mark.parametrize("seconds", [-1.0, float("nan"), float("inf")])
def test_a_limit_is_a_time(seconds):
    with refused("time-limit"):
        cl.discover(DROPS, time_limit=seconds)


def test_what_cannot_be_limited_is_refused():
    with refused("time-limit-unsupported", what="DerivativeRegression"):
        cl.discover(DROPS, method=cl.DerivativeRegression(), time_limit=1)
    with refused("not-with-observation"):
        cl.discover(DROPS, observe={"x": "q"}, latent_states="q", time_limit=1)
