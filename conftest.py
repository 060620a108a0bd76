"""Fixtures of the tests of the package, the benchmarks and the studies."""

import gc
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pooch
import pytest
from hypothesis import HealthCheck, settings
from matplotlib.figure import Figure
from selenium.webdriver import Chrome, ChromeOptions, ChromeService
from xdist.scheduler import LoadGroupScheduling

import commonlaw as cl
from commonlaw.cli import main
from commonlaw.estimation import search
from commonlaw.report import document
from commonlaw.runtime.cluster import connected

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
DRIVERS = ("chromedriver", "chromium.chromedriver")
QUIET = (
    "headless=new", "no-sandbox", "disable-gpu", "disable-dev-shm-usage", "disable-quic", "no-first-run",
    "disable-background-networking", "disable-component-update", "disable-sync",
)  # fmt: skip
PHONE, SCREEN = 390, 1200
"""Widths of a window, in pixels."""

# Of permissions, links, pipes, signals and limits as POSIX has them, and of names of files that macOS refuses
collect_ignore = {
    "win32": ["tests/hostile", "tests/unit/test_files.py", "tests/unit/test_forking.py", "tests/cli/test_interrupt.py"],
    "darwin": ["tests/hostile/test_environment.py"],
}.get(sys.platform, [])

os.environ["COMMONLAW_CACHE"] = "off"  # What is tested is found, not remembered
# Each worker, and each process that tests start, would compile all modules in each run
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# No time limits, as the machine may be busy
settings.register_profile(
    "suite", settings.default, deadline=None, max_examples=50, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("suite")

NEEDS_DROPS = "needs the measured drops"


@pytest.fixture(scope="session")
def workers():
    """A client of two worker processes, for all tests of the group `cluster`, as they take seconds to start."""
    with connected("local:2") as client:
        yield client


@pytest.fixture(scope="module")
def few_starts() -> Iterator[None]:
    """Few first values, for likelihoods of one maximum that is found from most of them."""
    with pytest.MonkeyPatch.context() as patch:
        for name, count in {"DRAWS": 16, "IMPROVED": 4, "FINISHED": 2}.items():
            patch.setattr(search, name, count)
        yield


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Empty figures in pages of reports, of which other things are tested: to draw them takes most of the time."""

    def figures(report: document.Report) -> Iterator[tuple[str, Figure]]:
        for block in report.named_blocks():
            if isinstance(block, document.Picture):
                yield block.name, Figure((1.0, 1.0))

    monkeypatch.setattr(document, "figures", figures)


FAULTS = """
const faults = [], ids = [...document.querySelectorAll("[id]")].map(each => each.id);
for (const id of new Set(ids.filter((id, i) => ids.indexOf(id) !== i))) faults.push(`anchor ${id} is there twice`);
for (const link of document.querySelectorAll("a[href^='#']"))
  if (!ids.includes(link.hash.slice(1))) faults.push(`no target for the link ${link.hash}`);
for (const image of document.images) {
  if (!image.complete || !image.naturalWidth) faults.push(`image not drawn: ${image.src.slice(0, 80)}`);
  if (!image.alt) faults.push(`image without words: ${image.src.slice(0, 80)}`);
}
for (const formula of document.querySelectorAll("math"))
  if (!formula.getBoundingClientRect().width) faults.push(`formula not drawn: ${formula.textContent}`);
for (const table of document.querySelectorAll("table")) {
  const rows = [...table.querySelectorAll("tbody tr")], name = table.closest("[id]")?.id;
  if (!rows.length) faults.push(`table without rows: ${name}`);
  if (rows.some(row => !row.textContent.trim())) faults.push(`table with an empty row: ${name}`);
}
let depth = 0;
for (const heading of document.querySelectorAll("h1, h2, h3, h4, h5, h6")) {
  const level = Number(heading.tagName[1]);
  if (level > depth + 1) faults.push(`heading out of order: ${heading.textContent}`);
  depth = level;
}
return faults;
"""


@pytest.fixture
def run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Callable[..., tuple[object, str, str]]:
    """Run the command in an empty folder; return exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> tuple[object, str, str]:
        monkeypatch.setattr("sys.argv", ["commonlaw", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        return ended.value.code, captured.out, captured.err

    return call


@cache
def _measured_drops() -> tuple[str, str]:
    """Return the folder of the measured drops, or why there is none.

    It is what COMMONLAW_DATA names, shared/data/ball_drops next to the checkout, or the cache, after a download.
    """
    adjacent = Path(__file__).resolve().parents[1] / "shared" / "data" / "ball_drops"
    named = os.environ.get("COMMONLAW_DATA") or (adjacent if adjacent.is_dir() else None)
    try:
        cl.datasets.ball_drops(named)
    except cl.CommonlawError as error:
        return "", str(error)
    return str(named or pooch.os_cache("commonlaw")), ""


class _LoadTestScheduling(LoadGroupScheduling):
    """Schedules the cases of one test together: this takes time in proportion to the square of the number of pieces."""

    def _split_scope(self, nodeid):
        return super()._split_scope(nodeid).partition("[")[0]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log) -> LoadGroupScheduling | None:
    """Schedule by groups and tests, in place of groups and cases."""
    return _LoadTestScheduling(config, log) if config.getoption("dist") == "loadgroup" else None


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node) -> None:
    """Look for the measured drops once for all workers: each would wait for a server that cannot be reached."""
    node.workerinput["measured drops"] = _measured_drops()


@pytest.fixture(scope="session")
def ball_drops_folder(pytestconfig: pytest.Config) -> Path:
    """The folder of the measured drops; without it tests are skipped, or fail where it is named or CI is set."""
    by_controller: dict[str, tuple[str, str]] = getattr(pytestconfig, "workerinput", {})
    folder, reason = by_controller.get("measured drops") or _measured_drops()
    if reason and (os.environ.get("CI") or os.environ.get("COMMONLAW_DATA")):
        pytest.fail(reason, pytrace=False)
    if reason:
        pytest.skip(f"{NEEDS_DROPS}: {reason}")
    return Path(folder)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items) -> None:
    """Mark tests of the whole study as slow; keep in one worker those that share the browser or a fixture of a module.

    Each worker would make that for itself.
    """
    for item in items:
        definitions = item._fixtureinfo.name2fixturedefs.values()
        if "finished_study" in item._fixtureinfo.name2fixturedefs:
            item.add_marker(pytest.mark.slow)
        if "browser" in item._fixtureinfo.name2fixturedefs and not item.get_closest_marker("xdist_group"):
            item.add_marker(pytest.mark.xdist_group("app"))
        if any(each.scope == "module" for each, *_ in definitions) and not item.get_closest_marker("xdist_group"):
            item.add_marker(pytest.mark.xdist_group(item.path.name))


def pytest_collection_finish() -> None:
    """Leave all that was imported out of garbage collections, which would take a tenth of the time, and make few."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000)


def pytest_terminal_summary(terminalreporter) -> None:
    """Have all tests without the measured drops summed up in one line, as of one place."""
    for report in terminalreporter.stats.get("skipped", ()):
        *_, reason = report.longrepr
        if NEEDS_DROPS in reason:
            report.longrepr = (__file__, None, reason)


@pytest.fixture(scope="session")
def run_study() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs the study of the falling balls, as `make study` does, with these options."""

    def run(out: Path, *options: object, check: bool = True) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "studies.falling_balls", "--out", out, *options]
        return subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parent, check=check)

    return run


@pytest.fixture(scope="session")
def finished_study(tmp_path_factory, ball_drops_folder, run_study) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """The folder of the whole study, and how it ran: what tests it shares a worker, so that it runs once."""
    folder = tmp_path_factory.mktemp("study")
    return folder, run_study(folder / "report", "--data", ball_drops_folder, "--json", folder / "all.json")


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    """A browser without a window that keeps a log of its console and of what it asks the network for."""
    program, driver = (next(filter(None, map(shutil.which, names)), None) for names in (BROWSERS, DRIVERS))
    if program is None or driver is None:
        reason = "needs Chromium or Chrome with its driver; on Debian: apt-get install chromium chromium-driver"
        # Who has no browser can still run all other tests, but no change is accepted without this one
        (pytest.fail if os.environ.get("CI") else pytest.skip)(reason)
    options = ChromeOptions()
    options.binary_location = program
    for argument in (*QUIET, f"user-data-dir={tmp_path_factory.mktemp('browser')}"):
        options.add_argument(f"--{argument}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    with Chrome(options, ChromeService(driver)) as opened:
        yield opened


@pytest.fixture
def check_page(browser: Chrome) -> Callable[[Path], None]:
    """A function that opens a page from disk and fails, with all that is wrong, unless it is whole by itself."""

    def check(page: Path) -> None:
        for log in ("browser", "performance"):
            browser.get_log(log)
        browser.get(page.as_uri())
        faults: list[str] = browser.execute_script(FAULTS)
        for width in (PHONE, SCREEN):
            window = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width == PHONE}
            browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", window)
            reach = browser.execute_script("return document.documentElement.scrollWidth")
            faults += [f"{reach} pixels wide in a window of {width}"] * (reach > width)
        links: list[str] = browser.execute_script("return [...document.links].map(each => each.getAttribute('href'))")
        files = [link for link in links if not re.match("#|[a-z]+:", link)]
        faults += [f"no file for the link {file}" for file in files if not (page.parent / file).is_file()]
        faults += [f"console: {entry['message']}" for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
        events = (json.loads(entry["message"])["message"] for entry in browser.get_log("performance"))
        sent = [each["params"] for each in events if each["method"] == "Network.requestWillBeSent"]
        # The page that a browser opens with may still be loading
        asked = [each["request"]["url"] for each in sent if not each["documentURL"].startswith("chrome:")]
        assert page.as_uri() in asked
        faults += [f"request: {url}" for url in asked if not url.startswith(("file:", "data:"))]
        assert not faults, "\n".join([f"{page.name}:", *faults])

    return check
