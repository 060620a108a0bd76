"""The app among strangers, in races, and told to end in the midst of whatever it does."""

import json
import os
import random
import signal
import socket
import stat
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from urllib.parse import urlsplit

import psutil
import pytest

import commonlaw as cl
from tests.served import PATIENCE, Served, gone, processes_of, served

KILLS = int(os.environ.get("KILLS", "1"))
"""How often the app is told to end in each stage."""


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("app") / "drops.csv"
    cl.datasets.linear_drag(noise=0.05).to_csv(path)
    return path


@pytest.fixture(scope="module")
def app(table: Path):
    with served(table) as running:
        yield running


def opened(app: Served) -> object:
    return app.ask("first")[1]["table"]


def test_however_many_searches_begin_at_once_three_run_and_what_is_cancelled_leaves_no_process(app: Served) -> None:
    question = {"table": opened(app), "library": "poly:5"}
    before = processes_of(app.process.pid)
    with ThreadPoolExecutor(10) as pool:
        answers = [*pool.map(lambda _: app.ask("searches", "POST", question), range(10))]
    assert sorted(status for status, _ in answers) == [200] * 3 + [422] * 7
    assert "3 searches are running" in str(next(said for status, said in answers if status == 422)["error"])
    begun = [said["search"] for status, said in answers if status == 200]
    assert app.ask("first")[1]["search"] in begun  # where a new tab goes on
    assert app.ask(f"searches/{begun[0]}/law.json?candidate={'9' * 5000}")[0] == 422
    for each in begun:
        assert app.ask(f"searches/{each}", "DELETE")[0] == 200
    until = time.monotonic() + PATIENCE
    while len(processes_of(app.process.pid)) > len(before) + 1 and time.monotonic() < until:
        time.sleep(0.01)  # what ends is seen off by a thread; what stays is the tracker of resources
    after = processes_of(app.process.pid)
    assert len(after) <= len(before) + 1
    assert psutil.STATUS_ZOMBIE not in after.values()


@pytest.mark.slow
def test_strangers_who_connect_and_stay_neither_stop_the_page_nor_take_its_files(app: Served) -> None:
    host, port = app.host.split(":")
    strangers = [socket.create_connection((host, int(port))) for _ in range(400)]
    for i, stranger in enumerate(strangers):
        if i % 3:
            stranger.send(
                b"GET / HTTP/1.1\r\nHost: " if i % 3 == 1 else b"POST / HTTP/1.1\r\ncontent-length: 9999999\r\n\r\nx"
            )
    assert app.ask("first")[0] == 200
    assert psutil.Process(app.process.pid).num_fds() < 200
    for each in strangers:
        each.close()
    assert app.ask("first")[0] == 200


def test_who_is_not_known_is_told_where_the_address_is(app: Served) -> None:
    stranger = Served.__new__(Served)
    stranger.host, stranger.cookie, stranger.room = app.host, "", app.room
    for path in ("/", app.room):
        status, body, _ = stranger.say("GET", path)
        assert status == 401
        assert b"Open the address that commonlaw app has printed" in body
    assert stranger.say("GET", "/guess/")[0] == 404
    assert app.say("GET", app.room.rstrip("/"))[0] == 308
    assert app.enter(urlsplit(app.address).path + "/") == 200  # again, and with a slash


@pytest.mark.slow
def test_the_browser_is_told_by_a_page_that_is_read_by_its_user_alone_and_opens_once(tmp_path: Path) -> None:
    browser, told, places = tmp_path / "browser", tmp_path / "told", tmp_path / "places"
    places.mkdir()
    browser.write_text(f'#!/bin/sh\necho "$@" > {told}.part\nmv {told}.part {told}\nexec sleep 60\n')
    browser.chmod(0o700)
    app = Served(environment={"BROWSER": str(browser), "TMPDIR": str(places)})
    until = time.monotonic() + PATIENCE
    while not told.exists() and time.monotonic() < until:
        time.sleep(0.01)
    page = Path(urlsplit(told.read_text().strip()).path)
    assert stat.S_IMODE(page.stat().st_mode) == 0o600
    assert stat.S_IMODE(page.parent.stat().st_mode) == 0o700
    path = urlsplit(page.read_text().partition("url=")[2].partition('"')[0]).path
    assert path not in app.address
    assert app.enter(path) == 200  # while the browser stays in the foreground
    assert app.ask("first")[0] == 200
    assert app.enter(path) == 404
    assert app.enter() == 200
    app.end()  # the browser too, as by Ctrl-C in a terminal
    assert [*places.iterdir()] == []
    with served("--port", app.host.split(":")[1]):  # at once again
        pass


def send(app: Served, to_close: ExitStack, path: str, body: bytes, length: int) -> None:
    """Send a request of which no answer is awaited."""
    host, port = app.host.split(":")
    connection = to_close.enter_context(socket.create_connection((host, int(port))))
    lines = (
        f"POST {app.room}{path} HTTP/1.1",
        f"Host: {app.host}",
        f"Origin: http://{app.host}",
        f"Cookie: {app.cookie}",
    )
    connection.send("\r\n".join([*lines, f"Content-Length: {length}", "", ""]).encode() + body)


def upload(app: Served, to_close: ExitStack) -> None:
    """An upload that stands still."""
    send(app, to_close, "tables", b"t,x", 1000)


def search(app: Served, to_close: ExitStack) -> None:
    """A search that takes long."""
    asked = json.dumps({"table": opened(app), "library": "poly:7"}).encode()
    send(app, to_close, "searches", asked, len(asked))


def preview(app: Served, to_close: ExitStack) -> None:
    """Many previews."""
    asked = json.dumps({"table": opened(app)}).encode()
    for _ in range(100):
        send(app, to_close, "previews", asked, len(asked))


STAGES: tuple[Callable[[Served, ExitStack], None], ...] = (upload, search, preview)


@pytest.mark.slow
def test_the_app_ends_when_told_whatever_it_does_and_leaves_nothing(table: Path, tmp_path: Path) -> None:
    longest = 0.0
    for seed in range(KILLS):
        r = random.Random(seed)
        app = Served(table, environment={"BROWSER": "true", "TMPDIR": str(tmp_path)})
        app.enter()
        with ExitStack() as to_close:
            for stage in r.sample(STAGES, r.randint(1, 3)) if seed else STAGES:
                stage(app, to_close)
            time.sleep(r.uniform(0.0, 2.0))
            longest = max(longest, app.end(r.choice([signal.SIGINT, signal.SIGTERM])))
        assert gone(app.process.pid)
        assert [*tmp_path.iterdir()] == []
    print(f"{KILLS} times: ended within {longest:.2f} s")
