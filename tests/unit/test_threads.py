"""Threads that draw, forecast or look for laws at the same time do not disturb each other."""

import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Event, Thread

import matplotlib as mpl
import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import commonlaw as cl
from commonlaw.discovery import AbstractMethod
from commonlaw.plots import plot_forecast, plot_trials, render

DROPS = cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.01)


def blas_threads():
    return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}


def settings():
    """Settings of matplotlib but for the back end, which it looks for when it is asked."""
    return {key: mpl.rcParams[key] for key in mpl.rcParams if key != "backend"}


@dataclass(frozen=True)
class Waiting(AbstractMethod):
    """A method that says when it has begun, and ends when it is told to."""

    began: Event
    may_end: Event

    def find(self, trials, structure, progress):
        self.began.set()
        assert self.may_end.wait(60)
        return cl.datasets.truth_of("linear-drag")

    def find_by_file(self, stream, structure, progress):
        raise cl.CommonlawError("stream-unsupported", method="Waiting")


def set_blas_threads(number):
    """Set how many threads linear algebra has, in a thread that then ends and has no claim on it any more."""
    setting = Thread(target=threadpool_limits, args=(number, "blas"))
    setting.start()
    setting.join()


@pytest.fixture
def two_threads():
    """Linear algebra with two threads."""
    before = min(blas_threads())
    set_blas_threads(2)
    yield
    set_blas_threads(before)


@pytest.mark.usefixtures("two_threads")
@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_linear_algebra_has_its_threads_back_when_the_last_of_several_discoveries_ends(order):
    methods = [Waiting(Event(), Event()) for _ in range(2)]
    with ThreadPoolExecutor() as pool:
        found = []
        for method in methods:
            found.append(pool.submit(cl.discover, DROPS, order=2, method=method))
            assert method.began.wait(60)
            assert blas_threads() == {1}
        for i in order:
            methods[i].may_end.set()
            found[i].result()
        assert blas_threads() == {2}


def test_forecasts_at_once_leave_warnings_as_they_were():
    law, times = cl.datasets.truth_of("linear-drag"), np.linspace(0, 3, 50)

    def forecast(_):
        return law.simulate(times, [40.0, 0.0], method="scipy")["Ball 1"].states

    alone = forecast(0)  # which imports packages that add filters of their own
    before = list(warnings.filters)
    with ThreadPoolExecutor(4) as pool:
        assert all(np.array_equal(each, alone) for each in pool.map(forecast, range(8)))
    assert warnings.filters == before


@pytest.mark.slow
def test_figures_drawn_at_once_are_those_drawn_one_after_the_other():
    forecast = cl.datasets.truth_of("linear-drag").predict(cl.datasets.linear_drag(noise=0.01))

    def drawn(number):
        figure = plot_forecast(forecast) if number % 2 else plot_trials(DROPS)
        return render(figure, ".svg")

    before = settings()
    alone = [drawn(0), drawn(1)]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(drawn, np.tile([0, 1], 4)))
    assert together == alone * 4
    assert settings() == before


def test_eight_fits_at_once_are_the_fit_of_one():
    def fitted(_):
        return cl.fit("x'' = -g - c v", DROPS)

    alone = fitted(0)
    with ThreadPoolExecutor(8) as pool:
        for law in pool.map(fitted, range(8)):
            np.testing.assert_array_equal(law.coefficients, alone.coefficients)
            np.testing.assert_array_equal(law.uncertainty.covariance, alone.uncertainty.covariance)
