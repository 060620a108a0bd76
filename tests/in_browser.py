"""A page of the app in a browser: what is in it, what is chosen, and what waits for it."""

import time

from axe_core_python.selenium import Axe

PHONE, SCREEN = 390, 1440
"""Widths of a window, in pixels."""


def open_page(page, app, table=None, counts=""):
    """Open the app by the address that its command prints, which redirects to its page: with a table, or the last."""
    if table is not None:
        assert app.say("POST", f"{app.room}tables?name={table.name}", table.read_bytes())[0] == 200
    page.get(app.address)
    wait(page, "$('file') && document.readyState === 'complete'")
    wait(page, f"$('counts')?.textContent.includes('{counts}')")


def text(page, name):
    return page.find_element("id", name).get_attribute("textContent")


def wait(page, what, seconds=60):
    """Wait until an expression of the page is true, and return it."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        found = page.execute_script(f"const $ = id => document.getElementById(id); return {what}")
        if found:
            return found
        time.sleep(0.1)
    raise AssertionError(f"not within {seconds} s: {what}; {text(page, 'failure')} {text(page, 'failed')}")


def offered(page):
    """Return the links to files, by name."""
    return {each.text: each for each in page.find_elements("css selector", "#files a")}


def download(app, link, more=""):
    """Return what a link leads to, with more after its address."""
    return app.say("GET", link.get_attribute("href").partition(app.host)[2] + more, patience=120)[1]


def choose(page, name, value):
    page.execute_script(
        f"const each = document.getElementById('{name}'); each.value = arguments[0];"
        "each.dispatchEvent(new Event('change'))",
        value,
    )


def write(page, equations, parameters):
    """Write equations, and wait for the sliders of so many parameters."""
    page.execute_script("document.getElementById('write').open = true")
    page.find_element("id", "equations").send_keys(equations)
    wait(page, f"$('parameters').children.length === {parameters} && !$('equations_problem').textContent")


def fit(page):
    """Fit what is written, and wait for the result."""
    page.find_element("id", "fit").click()
    wait(page, "!$('result').hidden && $('going').hidden")


def fit_drag(page):
    """Fit the law of drops with linear drag."""
    write(page, "x'' = -g - c v", 2)
    choose(page, "setting_errors", "white")
    fit(page)


def resize(page, width):
    """Give the page the window of a phone, which is dark, or of a screen, which is light; it must fit."""
    is_phone = width == PHONE
    window = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": is_phone}
    page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", window)
    look = [{"name": "prefers-color-scheme", "value": "dark" if is_phone else "light"}]
    page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": look})
    assert page.execute_script("return document.documentElement.scrollWidth") <= width


def violations(page):
    """Return the rules of accessibility that the page violates, each with how bad that is."""
    found = Axe().run(page, options={"resultTypes": ["violations"]})  # Without all that passes
    return {each["id"]: each["impact"] for each in found["violations"]}


def serious(page):
    return {name: impact for name, impact in violations(page).items() if impact in ("serious", "critical")}


def faults(page):
    """Return the errors of the page since the last call; for favicon.ico browsers ask by themselves."""
    logged = page.get_log("browser")
    return [each for each in logged if each["level"] == "SEVERE" and "/favicon.ico" not in each["message"]]
