"""Without the measured drops, and without a network, their tests are skipped, or fail where drops are promised."""

import os
import re
import shutil
import socketserver
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from threading import Thread

import pytest

ROOT = Path(__file__).parents[2]
FILES = ("tests/unit/test_trials_tables.py", "tests/unit/test_trial_checks.py")
"""With tests on the measured drops, among others."""

NEEDED = ("pyproject.toml", "conftest.py", "tests/refusals.py", "tests/unit/tables.py")


class Refusing(socketserver.TCPServer):
    """A proxy that hangs up on everybody, and counts."""

    asked = 0

    def finish_request(self, request, client_address) -> None:
        self.asked += 1


@pytest.fixture
def proxy() -> Iterator[Refusing]:
    with Refusing(("127.0.0.1", 0), socketserver.BaseRequestHandler) as server:
        Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05}).start()
        yield server
        server.shutdown()


@pytest.fixture
def run_tests(tmp_path, proxy):
    """Runs pytest in a checkout of these files alone, as far from data as can be."""
    checkout = tmp_path / "checkout"
    for name in (*NEEDED, *FILES):
        (checkout / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, checkout / name)
    address = "http://{}:{}".format(*proxy.server_address)
    kept = {k: v for k, v in os.environ.items() if k not in ("CI", "COMMONLAW_DATA") and "proxy" not in k.lower()}
    away = {"XDG_CACHE_HOME": str(tmp_path), "HOME": str(tmp_path), "https_proxy": address}
    paths = {"PYTHONPATH": os.pathsep.join([str(ROOT / "src"), str(ROOT)])}
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider"]

    def run(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*command, *arguments],
            cwd=checkout,
            env=kept | away | paths | variables,
            capture_output=True,
            text=True,
            check=False,
        )

    return run


@pytest.mark.slow
def test_without_them_tests_are_skipped_after_one_try_and_one_line_says_how_to_get_them(run_tests, proxy):
    done = run_tests("-n", "2", *FILES, "-k", "measured")
    counts = re.search(r"=+ (?:\d+ passed, )?(\d+) skipped in ", done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
    (line,) = (each for each in done.stdout.splitlines() if "needs the measured drops" in each)
    assert line.startswith(f"SKIPPED [{counts[1]}] ")
    assert "no connection to raw.githubusercontent.com. Download Ball_drops_data.xls and balls.txt" in line
    assert "COMMONLAW_DATA" in line
    assert proxy.asked == 1


def test_where_they_are_promised_tests_fail_without_them(run_tests, tmp_path):
    (tmp_path / "checkout" / "test_measured.py").write_text("def test_measured(ball_drops_folder): pass")
    done = run_tests("test_measured.py", COMMONLAW_DATA=str(tmp_path))
    assert done.returncode == pytest.ExitCode.TESTS_FAILED
    assert re.search(r"=+ 1 error in ", done.stdout), done.stdout + done.stderr
    assert len(done.stdout.splitlines()) < 40
