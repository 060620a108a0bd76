"""The pages that `make docs` has built, in a browser; it runs this file, which tests leave out."""

from pathlib import Path
from urllib.parse import urlencode

from selenium.webdriver.support.ui import WebDriverWait as Wait

SITE = Path(__file__).parents[2] / "build" / "docs"
WIDTHS = 390, 1200
FIRST_SCREEN = 900
"""Height of a window of 1200 pixels, in pixels."""

PAGES = sorted(SITE.rglob("*.html"))

SEARCHES = {
    "my own CSV": "howto/own-csv",
    "replicates": "howto/replicates",
    "heteroscedastic": "howto/noise",
    "autocorrelation": "howto/noise",
    "collinear": "pitfalls",
    "carrying capacity": "howto/carrying-capacity",
    "fix a coefficient": "howto/fix-coefficient",
    "custom term": "howto/custom-term",
    "latent state": "howto/latent-states",
    "multi-start": "method/likelihood",
    "confidence interval": "howto/confidence-interval",
    "lack of fit": "howto/lack-of-fit",
    "export": "howto/export",
    "warning": "messages",
}
"""What users look for, and the page that answers it."""
FIRST_RESULTS = 5


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


def links_of(browser, selector):
    return browser.execute_script(f"return [...document.querySelectorAll('{selector}')].map(each => each.href)")


def test_the_search_shows_the_page_that_answers_among_its_first_results(browser):
    faults = []
    for words, page in SEARCHES.items():
        browser.get(f"{(SITE / 'search.html').as_uri()}?{urlencode({'q': words})}")
        Wait(browser, 10).until(lambda shown: "found" in shown.find_element("id", "search-results").text)
        shown = [link.partition("?")[0] for link in links_of(browser, "#search-results li > a")[:FIRST_RESULTS]]
        if not any(link.partition("#")[0].endswith(f"/{page}.html") for link in shown):
            faults.append(f"{words}: {shown}")
    assert not faults, "\n".join(faults)


def test_every_question_is_two_clicks_from_the_first_page(browser):
    reached = {(SITE / "index.html").as_uri()}
    for _ in range(2):
        pages = [*reached]
        for page in pages:
            browser.get(page)
            reached |= {link.partition("#")[0] for link in links_of(browser, "article a")}
    missing = {(SITE / f"{page}.html").as_uri() for page in SEARCHES.values()} - reached
    assert not missing
