"""A report opens in a browser, from disk and without a network; and the check of that sees what is wrong."""

import re
from base64 import b64decode
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from axe_core_python.selenium import Axe
from matplotlib.image import imread
from selenium.webdriver import Chrome

import commonlaw as cl
from commonlaw import datasets
from commonlaw.plots import Figure, plot_trials, render
from commonlaw.report import Picture, Table, Text, law_report, printing, to_page
from commonlaw.report.document import within
from commonlaw.report.page import Page
from commonlaw.verdict import find
from studies.falling_balls.report import KINDS, Report, Section, Verdict, write_report
from tests.refusals import refused

CheckPage = Callable[[Path], None]

EQUATION = " + ".join(f"0.00{i} x^{i} v^{i}" for i in range(1, 10))


def test_a_report_with_every_kind_of_block_is_whole_by_itself(check_page: CheckPage, tmp_path: Path) -> None:
    wide = pd.DataFrame(np.geomspace(-1e-9, -1e9, 60).reshape(3, 20)).assign(note="a remark that has many words " * 3)
    report = Report(
        "Falls",
        "The law is $\\ddot{x} = -g$:\n\n- *first*\n- `second`",
        (
            Section(
                "data",
                "Data",
                (
                    Text(f"A formula wider than a phone, ${EQUATION}$, and one by itself: $$\\frac{{1}}{{2}} v^2$$"),
                    Picture("heights", "**Heights** over time", lambda: plot_trials(datasets.linear_drag())),
                    Table("wide", "More columns than fit, $x_0$", wide),
                ),
                tuple(Verdict(kind, "a word-without-an-end-" * 5) for kind in KINDS),
            ),
            Section("rest", "The rest", ()),
        ),
    )
    page, *_ = write_report(report, tmp_path)
    check_page(page)


def test_drawings_in_a_page_look_the_same_and_have_no_element_for_each_point(browser: Chrome, tmp_path: Path) -> None:
    def drawn(points: int) -> Figure:
        figure = Figure(figsize=(4, 3))
        one, other = figure.subplots(1, 2)
        x, y = np.random.default_rng(0).random((2, points))
        one.plot(x, y, ".", alpha=0.4)
        one.scatter(x[:3], y[:3], c=x[:3], s=[10, 50, 90])
        one.errorbar(x[:4], y[:4], 0.1, fmt="o", capsize=3, label='<a id="b"> url(#c)')
        one.legend()
        one.set(xlim=(0, 1), ylim=(0, 1))
        other.loglog(x, y, "s-", color="C1", markerfacecolor="white")
        other.set(xlim=(0.01, 1), ylim=(0.01, 1))
        return figure

    made = [within(render(drawn(points), ".svg", text=True), "drawing") for points in (40, 400)]
    assert made[0].count("<") == made[1].count("<")
    looks = list[bytes]()
    whole = render(drawn(40), ".svg", text=True).decode().partition("<svg")
    for text in (f"<svg{whole[2]}", made[0]):
        page = tmp_path / "page.html"
        page.write_text(f"<!DOCTYPE html><meta charset='utf-8'><link rel='icon' href='data:,'>{text}")
        browser.get(page.as_uri())
        looks.append(browser.get_screenshot_as_png())
    one, other = (np.asarray(imread(BytesIO(look))) for look in looks)
    assert np.mean(np.abs(one - other) > 0.5) < 1e-5
    assert np.mean(one < 0.8) > 0.003  # Of a window of any size


def test_a_report_of_three_objects_prints_on_at_most_six_pages_the_first_of_which_has_the_numbers(
    browser: Chrome, tmp_path: Path
) -> None:
    carts = datasets.linear_drag(drag=(-0.1, -0.3, -0.5), trials=2, noise=0.02)
    page, report = tmp_path / "report.html", law_report(find(cl.discover(carts, order=2, library="poly:2"), carts))
    page.write_bytes(to_page(report))
    assert [block.name for block in report.named_blocks()][:2] == ["fit-objects", "values"]
    assert report.title.endswith("of 3 objects")
    browser.get(page.as_uri())
    assert 3 <= _pages(b64decode(browser.print_page())) <= 6


def _pages(pdf: bytes) -> int:
    return len(re.findall(rb"/Type */Page\b", pdf))


@pytest.mark.usefixtures("browser")
def test_a_report_is_printed_from_python(tmp_path: Path) -> None:
    drop = datasets.linear_drag(drag=(-0.1,), trials=1, noise=0.02)
    cl.fit("x'' = -g - c v", drop, errors="white").report(drop).save(tmp_path / "page.pdf")
    assert _pages((tmp_path / "page.pdf").read_bytes()) in range(2, 8)


def test_without_a_browser_a_report_is_not_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(printing, "_BROWSERS", ())
    with refused("report-without-browser"):
        Page("<p>law").save(tmp_path / "report.pdf")
    monkeypatch.setattr(printing, "_BROWSERS", ("/bin/false",))
    with refused("report-not-printed"):
        Page("<p>law").save(tmp_path / "report.pdf")
    assert not [*tmp_path.iterdir()]


@pytest.mark.slow
def test_a_report_of_forty_objects_is_accessible(browser: Chrome, tmp_path: Path) -> None:
    drops = cl.datasets.linear_drag(drag=tuple(np.linspace(-0.1, -0.5, 40)), noise=0.05)
    page = tmp_path / "report.html"
    page.write_bytes(to_page(law_report(find(cl.fit("x'' = -g - c v", drops, errors="white"), drops, drops))))
    browser.get(page.as_uri())
    assert browser.execute_script("return document.querySelectorAll('*').length") < 12_000
    browser.set_script_timeout(100)
    assert Axe().run(browser)["violations"] == []


@pytest.mark.parametrize(
    ("body", "fault"),
    [
        ("<img src='absent.png' alt='none'>", "image not drawn: .*absent.png"),
        ("<img src='data:image/svg+xml,<svg' alt='none'>", "image not drawn: data:"),
        ("<img src='data:image/svg+xml,<svg xmlns=\"http://www.w3.org/2000/svg\"/>'>", "image without words"),
        ("<script src='http://127.0.0.1:9/script.js'></script>", "request: http://127.0.0.1:9/script.js"),
        ("<style>@import url(http://127.0.0.1:9/font.css)</style>", "request: http://127.0.0.1:9/font.css"),
        ("<script>absent()</script>", "console: .*absent is not defined"),
        ("<a href='#nowhere'>there</a>", "no target for the link #nowhere"),
        ("<a href='absent.csv'>there</a>", "no file for the link absent.csv"),
        ("<p id='one'></p><p id='one'></p>", "anchor one is there twice"),
        ("<table id='bare'><thead><tr><th>x</th></tr></thead></table>", "table without rows: bare"),
        ("<table id='thin'><tbody><tr><td>1</td></tr><tr><td> </td></tr></tbody></table>", "an empty row: thin"),
        ("<math></math>", "formula not drawn"),
        ("<h3>Deep</h3>", "heading out of order: Deep"),
        ("<p style='width: 500px'>wide</p>", "pixels wide in a window of 390"),
    ],
)
def test_the_check_sees_what_is_wrong(check_page: CheckPage, tmp_path: Path, body: str, fault: str) -> None:
    page = tmp_path / "page.html"
    page.write_text(
        "<!DOCTYPE html><meta name='viewport' content='width=device-width'><link rel='icon' href='data:,'>"
        f"<h1>Page</h1>{body}"
    )
    with pytest.raises(AssertionError, match=fault):
        check_page(page)
