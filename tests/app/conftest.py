"""What tests of the app share."""

import pytest


@pytest.fixture
def page(browser):
    """A browser with an empty log, and what waits for something in its page."""
    browser.get("about:blank")
    browser.get_log("browser")
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    yield browser
    browser.get("about:blank")  # A page that asks for an app that has ended takes time of other tests
