"""Work on a dask cluster: a real scheduler and two worker processes on this machine."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import closing, suppress
from functools import partial
from threading import Thread, Timer

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.runtime.cluster import Cluster, connected, on_cluster
from commonlaw.selection.cross_validation import stability
from tests.refusals import refused

pytestmark = [
    pytest.mark.xdist_group("cluster"),
    pytest.mark.filterwarnings("default::ResourceWarning", "default::pytest.PytestUnraisableExceptionWarning"),
]

METHOD = cl.DerivativeRegression(differentiation="finite:6")


@pytest.fixture(scope="module")
def client(workers):
    return workers


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Twelve files of drops, in folders named after their objects."""
    folder = tmp_path_factory.mktemp("runs")
    drops = cl.datasets.linear_drag(drag=(-0.1, -0.3, -0.5), trials=12, noise=0.001).to_frame()
    for (name, part), own in drops.groupby(["object", drops["trial"].astype(int) % 4]):
        (folder / f"object={name}").mkdir(exist_ok=True)
        own.drop(columns="object").to_parquet(folder / f"object={name}" / f"{part}.parquet")
    return folder


def streamed(folder):
    return cl.TrialStream.from_parquet(folder, object="object", trial="trial", time="t", states=["x"])


def found(folder, **settings):
    return cl.discover(streamed(folder), order=2, library="poly:2", method=METHOD, **settings)


def slow_square(seconds, number):
    time.sleep(seconds)
    return number**2


def fails(_):
    raise cl.CommonlawError("other", text="nothing can be done with it")


def ends(_):
    os._exit(1)


def tasks_left(client):
    return client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks))


@pytest.fixture(scope="module")
def told():
    return []


@pytest.fixture(scope="module")
def law(client, runs, told):
    return found(runs, client=client, progress=told.append)


def test_workers_find_the_law_that_is_found_here(law, runs, told):
    here = found(runs)
    assert law.objects == here.objects == ("Ball 1", "Ball 2", "Ball 3")
    np.testing.assert_array_equal(law.support, here.support)
    np.testing.assert_allclose(law.coefficients, here.coefficients, rtol=1e-9)
    assert any("12 of 12, on 2 workers" in each and "/status" in each for each in told)


def path_elsewhere(process, problems):
    assert os.getpid() != process
    return cl.solvers.STLSQ(normalize=True).path(problems, 0, np.ones(3, dtype=bool))


def test_resamples_are_drawn_by_workers_as_they_are_here(client):
    rows = np.random.default_rng(0).normal(size=(2, 6, 50, 4))
    groups = [[[cl.formulation.LeastSquaresProblem.of(each[:, :3], each[:, 3:]) for each in row]] for row in rows]
    here = stability(groups, partial(path_elsewhere, 0), n_resamples=12)
    with on_cluster(client):
        there = stability(groups, partial(path_elsewhere, os.getpid()), n_resamples=12)
    assert len(there.supports) == 12
    for support, other in zip(here.supports, there.supports, strict=True):
        np.testing.assert_array_equal(support, other)


def test_what_is_broken_off_leaves_the_cluster_clean(client):
    with closing(Cluster(client).each(partial(slow_square, 0.05), range(200))) as done:
        next(done)
    for _ in range(50):
        if not tasks_left(client):
            break
        time.sleep(0.1)
    assert tasks_left(client) == 0


def test_workers_that_are_started_here_keep_no_profile():
    with connected("local:1") as client:
        (profiled,) = client.run(lambda dask_worker: "profile" in dask_worker.periodic_callbacks).values()
    assert not profiled


def test_other_versions_are_refused_by_name(client, monkeypatch):
    monkeypatch.setattr(cl, "__version__", "99.1")
    with refused("cluster-worker-versions"), on_cluster(client):
        pass


def test_a_stream_is_what_a_cluster_takes(client):
    with refused("cluster-client-without-files"):
        cl.discover(cl.datasets.linear_drag(), order=2, client=client, library="poly:3")


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "local:0", "nowhere:at:all"])
def test_a_cluster_that_is_not_there_is_an_error_in_words(address, monkeypatch):
    monkeypatch.setattr("commonlaw.runtime.cluster._ANSWER", 0.3)
    with refused("cluster-not-found"), connected(address):
        pass


@pytest.mark.parametrize(
    ("greeting", "reason"),
    [
        (b"", Diagnostic("cluster-not-found", {"reason": "no scheduler answers in 0.5 s"})),
        (
            b"HTTP/1.1 400 Bad Request\r\n",
            Diagnostic("cluster-not-found", {"reason": "what answers there is no scheduler"}),
        ),
    ],
)
def test_a_server_that_is_no_scheduler_is_refused_as_soon_as_it_fails_to_answer(greeting, reason, monkeypatch):
    monkeypatch.setattr("commonlaw.runtime.cluster._ANSWER", 0.5)
    accepted = []

    def accept(server):
        with suppress(OSError):  # The server is closed
            while True:
                accepted.append(server.accept()[0])
                accepted[-1].sendall(greeting)

    with socket.create_server(("127.0.0.1", 0)) as server:
        Thread(target=accept, args=(server,), daemon=True).start()
        began = time.monotonic()
        with refused(reason), connected("tcp://127.0.0.1:{1}".format(*server.getsockname())):
            pass
        assert time.monotonic() - began < 10 * 0.5
        server.shutdown(socket.SHUT_RDWR)
    assert accepted
    for each in accepted:
        each.close()


@pytest.mark.parametrize("count", ["9", "99999999999999999999"])
def test_more_workers_than_this_machine_has_use_for_are_refused_before_any_starts(count, monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    monkeypatch.setattr("distributed.LocalCluster", None)
    with refused("cluster-too-many-processes", count=count, limit=8, cores=2), connected(f"local:{count}"):
        pass


def test_a_worker_that_is_killed_costs_time_only(client, runs, law):
    victim = next(iter(client.run(os.getpid).values()))
    killed = []

    def kill(step):
        if not killed and ", 1 of 12" in step:
            os.kill(victim, signal.SIGKILL)
            killed.append(step)

    again = found(runs, client=client, progress=kill)
    assert killed
    np.testing.assert_array_equal(again.coefficients, law.coefficients)


def test_each_item_gives_its_result_or_why_there_is_none(client):
    client.run_on_scheduler(lambda dask_scheduler: setattr(dask_scheduler, "allowed_failures", 0))
    assert [result for _, result, _ in sorted(Cluster(client).each(partial(slow_square, 0), range(3)))] == [0, 1, 4]
    ((_, _, failure),) = Cluster(client).each(ends, [1])
    assert "workers died repeatedly" in str(failure)
    ((_, nothing, failure),) = Cluster(client).each(fails, [0])
    assert (nothing, str(failure)) == (None, "nothing can be done with it")
    with refused("other", text="nothing can be done with it"):
        Cluster(client).merged(fails, [0, 1], max)


def test_a_scheduler_that_stops_is_an_error_in_words(tmp_path):
    words = ["-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    file = tmp_path / "scheduler.json"
    with subprocess.Popen([sys.executable, *words, "--scheduler-file", file], stderr=subprocess.DEVNULL) as scheduler:
        try:
            while not (file.exists() and file.read_text()):
                time.sleep(0.05)
            with connected(json.loads(file.read_text())["address"]) as client:
                work = Cluster(client).each(partial(slow_square, 0), range(5))
                killing = Timer(0.5, scheduler.kill)
                killing.start()
                with refused("cluster-lost"):
                    next(work)
                lost = time.monotonic()
            with refused("cluster-client", status="closed"), on_cluster(client):
                pass
        finally:
            scheduler.kill()
    assert time.monotonic() - lost < 10
