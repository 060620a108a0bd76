"""What tests of the app share."""

import pytest

from tests.in_browser import Page
from tests.served import served


@pytest.fixture
def page(browser):
    """A page in a browser with an empty log."""
    browser.get("about:blank")
    browser.get_log("browser")
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    yield Page(browser)
    browser.get("about:blank")  # A page that asks for an app that has ended takes time of other tests


@pytest.fixture(scope="session")
def sessions_folder(tmp_path_factory):
    """The folder in which the app keeps its sessions."""
    return tmp_path_factory.mktemp("app") / "sessions"


@pytest.fixture(scope="session")
def app(sessions_folder):
    """One app for all pages, each with a table of its own."""
    with served(environment={"COMMONLAW_SESSIONS": str(sessions_folder)}) as running:
        yield running
