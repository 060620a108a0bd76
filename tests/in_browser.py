"""A page of the app in a browser: what is in it, what is chosen, and what waits for it."""

import time
from typing import Any

from axe_core_python.selenium import Axe
from selenium.webdriver import Chrome

PHONE, SCREEN = 390, 1440
"""Widths of a window, in pixels."""


class Page:
    """A page in a browser, whose other methods it has too."""

    def __init__(self, browser: Chrome) -> None:
        self.browser = browser

    def __getattr__(self, name: str) -> Any:
        return getattr(self.browser, name)

    def open(self, app, table=None, counts=""):
        """Open the app by the address that its command prints, which leads to its page: with a table, or the last."""
        if table is not None:
            assert app.say("POST", f"{app.room}tables?name={table.name}", table.read_bytes())[0] == 200
        self.get(app.address)
        self.wait("$('file') && document.readyState === 'complete'")
        self.wait(f"$('counts')?.textContent.includes('{counts}')")

    def text(self, name):
        return self.find_element("id", name).get_attribute("textContent")

    def value(self, name):
        return self.find_element("id", name).get_attribute("value")

    def click(self, name):
        self.find_element("id", name).click()

    def type(self, name, *keys):
        self.find_element("id", name).send_keys(*keys)

    def wait(self, what, seconds=60):
        """Wait until an expression of the page is true, and return it."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            found = self.execute_script(f"const $ = id => document.getElementById(id); return {what}")
            if found:
                return found
            time.sleep(0.1)
        raise AssertionError(f"not within {seconds} s: {what}; {self.text('failure')} {self.text('failed')}")

    def choose(self, name, value):
        self.choose_in(f"#{name}", value)

    def choose_in(self, selector, value):
        """Change the first element of a CSS selector."""
        self.execute_script(
            "const [selector, value] = arguments, each = document.querySelector(selector); each.value = value;"
            "each.dispatchEvent(new Event('change'))",
            selector,
            value,
        )

    def write(self, equations, parameters):
        """Write equations, and wait for the sliders of so many parameters."""
        self.execute_script("document.getElementById('write').open = true")
        self.type("equations", equations)
        self.wait(f"$('parameters').children.length === {parameters} && !$('equations_problem').textContent")

    def fit(self):
        """Fit what is written, and wait for the result."""
        self.click("fit")
        self.wait("!$('result').hidden && $('going').hidden")

    def fit_drag(self):
        """Fit the law of drops with linear drag."""
        self.write("x'' = -g - c v", 2)
        self.choose("setting_errors", "white")
        self.fit()

    def files(self):
        """Return the links to files, by name."""
        return {each.text: each for each in self.find_elements("css selector", "#files a")}

    def resize(self, width):
        """Give the page the window of a phone, which is dark, or of a screen, which is light; it must fit."""
        is_phone = width == PHONE
        window = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": is_phone}
        self.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", window)
        look = [{"name": "prefers-color-scheme", "value": "dark" if is_phone else "light"}]
        self.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": look})
        assert self.execute_script("return document.documentElement.scrollWidth") <= width

    def violations(self):
        """Return the rules of accessibility that the page violates, each with how bad that is."""
        found = Axe().run(self.browser, options={"resultTypes": ["violations"]})  # Without all that passes
        return {each["id"]: each["impact"] for each in found["violations"]}

    def serious(self):
        return {name: impact for name, impact in self.violations().items() if impact in ("serious", "critical")}

    def faults(self):
        """Return the errors of the page since the last call; for favicon.ico browsers ask by themselves."""
        logged = self.get_log("browser")
        return [each for each in logged if each["level"] == "SEVERE" and "/favicon.ico" not in each["message"]]


def download(app, link, more=""):
    """Return what a link leads to, with more after its address."""
    return app.say("GET", link.get_attribute("href").partition(app.host)[2] + more, patience=120)[1]
