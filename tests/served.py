"""An app that runs in a process of its own, what asks it as its page does, and the processes that it leaves."""

import http.client
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from urllib.parse import urlsplit

import psutil

PATIENCE = 20.0
"""Seconds within which what is told to end has ended: far less than what it is in would take, on any machine."""


class Served:
    """An app that runs.

    Parameters
    ----------
    *arguments
        Of the command.
    environment
        Variables beside those of the tests.
    """

    def __init__(self, *arguments: object, environment: Mapping[str, str] | None = None) -> None:
        command = [sys.executable, "-m", "commonlaw", "app", *map(str, arguments)]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
            env=os.environ | dict(environment or {}),
        )  # fmt: skip
        assert self.process.stdout is not None
        self.address = self.process.stdout.readline().split()[-1]
        self.host = urlsplit(self.address).netloc
        self.cookie = self.room = ""

    def enter(self, path: str = "") -> int:
        """Visit a path, by default that of the address, as a browser does; return the status."""
        status, body, headers = self.say("GET", path or urlsplit(self.address).path)
        if status == 200:
            self.cookie = headers["set-cookie"].partition(";")[0]
            (self.room,) = re.findall("url=(/[0-9a-f]+/)", body.decode())
        return status

    def ask(self, path: str, method: str = "GET", document: object = None) -> tuple[int, dict[str, object]]:
        """Ask as the page does; return status and answer."""
        status, body, _ = self.say(
            method, self.room + path, None if document is None else json.dumps(document).encode()
        )
        return status, json.loads(body or b"{}")

    def say(
        self, method: str, path: str, body: bytes | None = None, patience: float = PATIENCE
    ) -> tuple[int, bytes, http.client.HTTPMessage]:
        """Send a request from the page; return status, body and headers of the answer."""
        connection = http.client.HTTPConnection(self.host, timeout=patience)
        headers = {"Cookie": self.cookie} | ({"Origin": f"http://{self.host}"} if method != "GET" else {})
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        read = answer.read()
        connection.close()
        return answer.status, read, answer.headers

    def end(self, how: signal.Signals = signal.SIGINT) -> float:
        """Tell it to end as a terminal does, by Ctrl-C in all its processes; return the seconds that it took."""
        began = time.monotonic()
        (os.killpg if how == signal.SIGINT else os.kill)(self.process.pid, how)
        assert self.process.wait(PATIENCE) == -how
        took = time.monotonic() - began
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        with self.process.stdout, self.process.stderr:
            said = self.process.stderr.read()
            assert not said, said
        return took


@contextmanager
def served(*arguments: object, environment: Mapping[str, str] | None = None) -> Iterator[Served]:
    """Have an app without a browser that is known already."""
    app = Served("--no-browser", *arguments, environment=environment)
    try:
        app.enter()
        yield app
    finally:
        app.end()


def processes_of(session: int) -> dict[int, str]:
    """Return the states of the processes of a session, as `psutil` names them, by number."""
    found = dict[int, str]()
    for each in psutil.process_iter():
        with suppress(psutil.NoSuchProcess, ProcessLookupError, PermissionError):  # Ended meanwhile, or somebody else's
            if os.getsid(each.pid) == session:
                found[each.pid] = each.status()
    return found


def gone(session: int) -> bool:
    """Return whether all processes of a session end, waiting a while for them."""
    until = time.monotonic() + PATIENCE
    while processes_of(session) and time.monotonic() < until:
        time.sleep(0.01)
    return not processes_of(session)
