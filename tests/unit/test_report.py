"""Reports: what is given is what is shown, and the page needs nothing else."""

import re
from base64 import b64decode
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest

from commonlaw import datasets
from commonlaw.law import Law, Provenance
from commonlaw.plots import Figure, plot_trials
from commonlaw.report import Block, Fold, Gallery, Picture, Report, Section, Table, Text, to_page
from commonlaw.report.markup import formula, inline, law_markdown, markdown
from commonlaw.report.page import Page
from tests.refusals import message, refused

FRAME = pd.DataFrame({"ball": ["Golf <Ball>", None], "drag": [-0.123456789, np.nan], "printed": ["-0.120", ""]})


def heights() -> Figure:
    return plot_trials(datasets.linear_drag(noise=0.1, seed=1))


def test_a_page_saves_and_shows_its_text(tmp_path):
    page = Page("<p>a & b</p>")
    page.save(tmp_path / "page.html")
    assert (tmp_path / "page.html").read_text() == page.html
    assert 'srcdoc="&lt;p&gt;a &amp; b' in page._repr_html_()
    assert repr(page).startswith("<Page of 0.0 MB")


def test_each_object_has_its_equations_where_terms_differ():
    law = Law.from_text("height'' = -g - c height", {"g": 9.8, "c": {f"ball {i}": float(i) for i in range(8)}})
    law = replace(law, provenance=Provenance())  # Of a search
    blocks = law_markdown(law).split("**")
    assert blocks[1::2] == [f"ball {i}" for i in range(6)]
    assert ["&= -9.8 \\end" in blocks[2], r"&= -9.8 - 5\, \mathrm{height}" in blocks[12]] == [True, True]
    assert r"\frac{\mathrm{d}^2\, \mathrm{height}}{\mathrm{d}t^2}" in blocks[2]
    assert "2 more objects" in blocks[-1]


def report_of(*blocks: Block) -> Report:
    return Report("Falls <1>", "What *fell*", (Section("fall", "Fall & rise", blocks),))


def page_of(*blocks: Block) -> str:
    return to_page(report_of(*blocks)).decode()


def cells(page: str) -> list[list[tuple[str, str]]]:
    """Every body row of the page: class and text of its cells."""
    rows = re.findall("<tr>(<td.*)</tr>", page)
    return [re.findall('<td class="(.*?)">(.*?)</td>', row) for row in rows]


# Values


def test_cells_show_digits_as_wanted_and_leave_out_what_is_missing() -> None:
    assert cells(page_of(Table("drags", "Drags", FRAME, digits=3))) == [
        [("word", "Golf &lt;Ball&gt;"), ("number", "−0.123"), ("number", "−0.120")],
        [("word", ""), ("number", ""), ("number", "")],
    ]


@pytest.mark.parametrize(
    ("values", "look", "shown"),
    [
        ([True, False], "word", ["yes", "no"]),
        ([1, -20000], "number", ["1", "−20000"]),
        ([1.0, np.inf], "number", ["1", "∞"]),
        ([-1.5e-9, 150000.0], "number", ["−1.5 × 10⁻⁹", "1.5 × 10⁵"]),
        (pd.array([1, None], dtype="Int64"), "number", ["1", ""]),
        (["a-b", "-"], "word", ["a-b", "-"]),
        (["a sentence that goes on for a while", ""], "prose", ["a sentence that goes on for a while", ""]),
    ],
)
def test_columns_are_set_by_what_they_hold(values: list[object], look: str, shown: list[str]) -> None:
    rows = cells(page_of(Table("one", "One", pd.DataFrame({"x": values}))))
    assert rows == [[(look, text)] for text in shown]


# Markup


def test_html_in_text_is_shown_and_not_obeyed() -> None:
    hostile = "<script>alert(1)</script> <img src=x> a < b & c"
    for rendered in (markdown(hostile), inline(hostile), page_of(Text(hostile), Table("t", hostile, FRAME))):
        assert "<script>alert" not in rendered
        assert "<img" not in rendered
        assert "&lt;script&gt;" in rendered


HOSTILE = "<script>alert(1)</script>"


def test_text_within_a_formula_is_shown_and_not_obeyed() -> None:
    latex = rf"$\text{{{HOSTILE}}}$ $\mathrm{{<img src=x>}}$ $\text{{&lt;script&gt;}}$ $\text{{a < b & c}}$"
    page = to_page(Report(HOSTILE, latex, (Section("a", HOSTILE, (Table("t", latex, FRAME),)),)))
    for rendered in (markdown(latex), inline(latex), page.decode()):
        assert "<script>" not in rendered
        assert "<img src=x" not in rendered
        assert "&lt;script&gt;alert(1)&lt;/script&gt;" in rendered


@pytest.mark.parametrize(
    ("latex", "attribute"),
    [
        (r"\href{javascript:alert(1)}{x}", "href"),
        (r"\href{https://example.org}{x}", "href"),
        (r"\style{background:url(https://example.org)}{x}", "style"),
        (r"\class{verdict}{x}", "class"),
    ],
)
def test_a_formula_that_does_more_than_mathematics_is_refused(latex: str, attribute: str) -> None:
    for render in (markdown, inline):
        with refused("formula-forbidden", command=attribute):
            render(f"so ${latex}$")


def test_signs_stay_what_they_are_in_formulas() -> None:
    signs = {r"a \leq b": "≤", "a < b": "&lt;", r"\sin x": "sin", r"\alpha": "α", r"x \& y": "&amp;"}
    for latex, sign in signs.items():
        assert f">{sign}<" in formula(latex)


def test_characters_that_hide_are_shown() -> None:
    hidden = "\ue0000\ue001 \x1b[2J \u202e"
    page = page_of(Text(hidden), Table("t", hidden, pd.DataFrame({hidden: [hidden]})))
    assert page.count(r"\ue0000\ue001 \u001b[2J \u202e") == 4
    assert inline(hidden) == r"\ue0000\ue001 \u001b[2J \u202e"


def test_dollars_in_code_or_after_a_backslash_stay_dollars() -> None:
    assert inline("`$HOME` and `$x$`") == "<code>$HOME</code> and <code>$x$</code>"
    assert inline(r"\$5, $x$ or \$6").count("<math") == 1


def test_text_cannot_disturb_the_order_of_headings_or_load_pictures() -> None:
    rendered = markdown("# Heading\n\nHeading\n===\n\n![picture](https://example.org/picture.png)")
    assert "<h" not in rendered
    assert "<img" not in rendered


@pytest.mark.parametrize(
    ("latex", "expected"),
    [
        ("x^", message("formula-syntax", latex="x^")),
        (r"\left( x", "formula-syntax"),
        (r"\drag x", message("formula-unread", command="\\drag")),
    ],
)
def test_a_formula_that_cannot_be_read_is_named(latex: str, expected: str) -> None:
    with refused(expected):
        formula(latex)


# The page


class Needs(HTMLParser):
    """What a page would load, and the tags in it."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.tags: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        wanted = {"src", "srcset", "data", "poster"} | ({"href"} if tag == "link" else set())
        self.loaded += [value or "" for name, value in attrs if name in wanted]


def test_the_page_needs_nothing_else() -> None:
    page = page_of(Text("$x$"), Picture("heights", "Heights of $x$", heights), Table("drags", "Drags", FRAME))
    needs = Needs(page)
    assert len(needs.loaded) == 1
    assert all(each.startswith("data:") for each in needs.loaded)
    assert "script" not in needs.tags
    assert set(re.findall(r"https?://[^\s\"'<]*", page)) == {"http://www.w3.org/1998/Math/MathML"}
    assert not re.search(r"@import|url\((?!#)", page)


# Parts


def test_parts_of_the_same_name_are_refused() -> None:
    with refused("report-name-twice", parts="parts", name="drags"):
        to_page(report_of(Table("drags", "Drags", FRAME), Picture("drags", "Drags", heights)))
    with refused("report-name-twice", parts="parts", name="fall"):
        to_page(report_of(Table("fall", "The section has this name too", FRAME)))


@pytest.mark.parametrize("name", ["", "Drags", "two words", "../drags", "drags.csv", "-drags", "under_line", "drägs"])
@pytest.mark.parametrize(
    "make",
    [
        partial(Table, caption="", frame=FRAME),
        partial(Picture, caption="", draw=heights),
        partial(Section, title="", blocks=()),
    ],
)
def test_a_name_that_is_not_of_letters_digits_and_hyphens_is_refused(make: Callable[[str], object], name: str) -> None:
    with refused("report-name"):
        make(name)


# Pages that stand alone


def test_a_page_alone_holds_figures_with_their_text_and_tables_as_data() -> None:
    folded = Fold("the rest", (Table("drags", "Drags", FRAME), Picture("last", "Last", heights)))
    gallery = Gallery((Picture("one", "One", heights), Picture("two", "Two", heights)))
    page = to_page(report_of(gallery, folded)).decode()
    assert page.count("<svg") == 3
    assert "Ball 1</text>" in page
    anchors = re.findall(r' id="([^"]+)"', page)
    assert len(anchors) == len({*anchors})
    assert {*re.findall(r'(?:xlink:href="|url\()#([^")]+)', page)} <= {*anchors}
    assert not re.search(r'(?:href|src)="(?!#|data:)', page)
    assert FRAME.to_csv(index=False) == read_data(page, "text/csv")
    assert "<summary>the rest</summary>" in page


def read_data(page: str, kind: str) -> str:
    return b64decode(re.findall(f'data:{kind};base64,([^"]+)', page)[0]).decode()
