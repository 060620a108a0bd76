"""The pages that `make docs` has built, in a browser; it runs this file, which tests leave out."""

from pathlib import Path

SITE = Path(__file__).parents[2] / "build" / "docs"
WIDTHS = 390, 1200
FIRST_SCREEN = 900
"""Height of a window of 1200 pixels, in pixels."""

PAGES = sorted(SITE.rglob("*.html"))


def resize(browser, width):
    window = {"width": width, "height": FIRST_SCREEN, "deviceScaleFactor": 1, "mobile": width < 600}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", window)


def test_no_page_is_wider_than_a_phone_or_a_screen(browser):
    assert PAGES
    faults = []
    for page in PAGES:
        browser.get(page.as_uri())
        for width in WIDTHS:
            resize(browser, width)
            reach = browser.execute_script("return document.documentElement.scrollWidth")
            faults += [f"{page.relative_to(SITE)}: {reach} pixels in a window of {width}"] * (reach > width)
    assert not faults, "\n".join(faults)


def test_the_first_page_shows_installation_code_equation_and_picture_without_scrolling(browser):
    browser.get((SITE / "index.html").as_uri())
    resize(browser, max(WIDTHS))
    ends = browser.execute_script(
        "return [...document.querySelectorAll('.hero .highlight, img.picture')]"
        ".map(each => each.getBoundingClientRect().bottom)"
    )
    assert len(ends) == 4
    assert max(ends) < FIRST_SCREEN
    shown = browser.execute_script("return document.querySelector('.hero').textContent")
    assert all(each in shown for each in ("pip install", "cl.discover", "x'' = a + b v"))
