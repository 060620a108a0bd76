"""A page of the app in a browser: what is in it, what is chosen, and what waits for it."""

import time

from axe_core_python.selenium import Axe


def open_page(page, app, table=None):
    """Open the app by the address that its command prints, which redirects to its page: with a table, or the last."""
    if table is not None:
        assert app.say("POST", f"{app.room}tables?name={table.name}", table.read_bytes())[0] == 200
    page.get(app.address)
    wait(page, "$('file') && document.readyState === 'complete'")


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


def choose(page, name, value):
    page.execute_script(
        f"const each = document.getElementById('{name}'); each.value = arguments[0];"
        "each.dispatchEvent(new Event('change'))",
        value,
    )


def fit_drag(page):
    """Write the law of drops with linear drag, fit it, and wait for the result."""
    page.execute_script("document.getElementById('write').open = true")
    page.find_element("id", "equations").send_keys("x'' = -g - c v")
    wait(page, "$('parameters').children.length === 2")
    choose(page, "setting_errors", "white")
    page.find_element("id", "fit").click()
    wait(page, "!$('result').hidden && $('going').hidden")


def serious(page):
    found = Axe().run(page)["violations"]
    return [(each["id"], each["impact"]) for each in found if each["impact"] in ("serious", "critical")]


def is_fault(logged):
    """Whether the page has a fault: browsers ask for favicon.ico by themselves, though a page names its icon."""
    return logged["level"] == "SEVERE" and "/favicon.ico" not in logged["message"]
