"""Reports: what is given is what is shown, the page needs nothing else, and files come whole or not at all."""

import json
import re
from base64 import b64decode
from collections.abc import Callable
from functools import partial
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from commonlaw import datasets
from commonlaw.diagnostics import Diagnostic
from commonlaw.errors import CommonlawError
from commonlaw.plots import Figure, plot_trials
from commonlaw.report import (
    Block,
    Fold,
    Gallery,
    Picture,
    Report,
    Section,
    Table,
    Text,
    Verdict,
    contents,
    to_page,
    write_report,
)
from commonlaw.report.document import to_json
from commonlaw.report.markup import formula, inline, markdown, plain
from tests.refusals import refused

FRAME = pd.DataFrame({"ball": ["Golf <Ball>", None], "drag": [-0.123456789, np.nan], "printed": ["-0.120", ""]})


def heights() -> Figure:
    return plot_trials(datasets.linear_drag(noise=0.1, seed=1))


def report_of(*blocks: Block, **results: object) -> Report:
    section = Section("fall", "Fall & rise", blocks, (Verdict("differs", "by $2 \\sigma$"),), results)
    return Report("Falls <1>", "What *fell*", (section,))


def page_of(*blocks: Block) -> str:
    return contents(report_of(*blocks))["report.html"].decode()


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


def test_json_holds_plain_numbers_and_null_for_those_that_are_not_finite() -> None:
    document = {"a": np.array([1.0, np.nan]), 2: (np.float64(0.1), np.int64(3), np.bool_(True)), "c": {"d": np.inf}}
    assert json.loads(to_json(document)) == {"a": [1.0, None], "2": [0.1, 3, True], "c": {"d": None}}


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
    verdict = Verdict("differs", latex)
    page = contents(Report(HOSTILE, latex, (Section("a", HOSTILE, (Table("t", latex, FRAME),), (verdict,)),)))
    for rendered in (markdown(latex), inline(latex), page["report.html"].decode()):
        assert "<script>" not in rendered
        assert "<img src=x" not in rendered
        assert "&lt;script&gt;alert(1)&lt;/script&gt;" in rendered
    assert plain(latex).startswith(HOSTILE)


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
    for render in (markdown, inline, plain):
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
    assert plain(hidden) == r"\ue0000\ue001 \u001b[2J \u202e"


def test_dollars_in_code_or_after_a_backslash_stay_dollars() -> None:
    assert inline("`$HOME` and `$x$`") == "<code>$HOME</code> and <code>$x$</code>"
    assert inline(r"\$5, $x$ or \$6").count("<math") == 1
    assert plain(r"from \$5 to \$6") == "from $5 to $6"


def test_what_is_heard_has_no_marks_of_markup() -> None:
    assert plain("**Drag** `C` < $C_D \\frac{1}{2} v^2$ & *so* [on](there)") == "Drag C < C_D1/2v^2 & so on"


def test_text_cannot_disturb_the_order_of_headings_or_load_pictures() -> None:
    rendered = markdown("# Heading\n\nHeading\n===\n\n![picture](https://example.org/picture.png)")
    assert "<h" not in rendered
    assert "<img" not in rendered


@pytest.mark.parametrize(
    ("latex", "message"),
    [
        ("x^", Diagnostic("formula-syntax", {"latex": "x^"})),
        (r"\left( x", "formula-syntax"),
        (r"\drag x", Diagnostic("formula-unread", {"command": "\\drag"})),
    ],
)
def test_a_formula_that_cannot_be_read_is_named(latex: str, message: str) -> None:
    with refused(message):
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
    assert len(needs.loaded) == 2
    assert all(each.startswith("data:") for each in needs.loaded)
    assert "script" not in needs.tags
    assert set(re.findall(r"https?://[^\s\"'<]*", page)) == {"http://www.w3.org/1998/Math/MathML"}
    assert not re.search(r"@import|url\(", page)


def test_every_part_has_its_verdicts_its_caption_and_its_files() -> None:
    page = page_of(Picture("heights", "**Heights** of $x$", heights), Table("drags", "Drags", FRAME))
    assert "<title>Falls &lt;1&gt;</title>" in page
    assert page.count('<b class="differs">differs</b> by <math') == 2
    assert 'alt="Heights of x"' in page
    assert '<th scope="col" class="number">drag</th>' in page
    for path in ("figures/heights.svg", "figures/heights.png", "tables/drags.csv", "results.json"):
        assert f'href="{path}"' in page


# Files


def test_files_are_the_same_to_the_byte_every_time() -> None:
    report = report_of(
        Picture("heights", "Heights", heights), Table("drags", "Drags", FRAME), drag=FRAME["drag"].to_numpy()
    )
    assert contents(report) == contents(report)


def test_a_report_comes_with_its_pictures_tables_and_numbers(tmp_path: Path) -> None:
    drawn: list[str] = []
    report = report_of(Picture("heights", "Heights", heights), Table("drags", "Drags", FRAME), drag=0.1 + 0.2)
    written = write_report(report, tmp_path / "new" / "report", drawn.append)
    assert {str(path.relative_to(tmp_path / "new" / "report")) for path in written} == {
        "report.html", "results.json", "figures/heights.svg", "figures/heights.png", "tables/drags.csv",
    }  # fmt: skip
    assert drawn == ["heights"]
    assert written[0].name == "report.html"
    assert written[0].read_bytes() == contents(report)["report.html"]
    assert json.loads((written[0].parent / "results.json").read_bytes()) == {"drag": 0.1 + 0.2}
    table = pd.read_csv(BytesIO((written[0].parent / "tables" / "drags.csv").read_bytes()))
    assert table["drag"][0] == -0.123456789


def test_a_report_whose_picture_fails_leaves_the_old_one_as_it_was(tmp_path: Path) -> None:
    def fails() -> Figure:
        raise CommonlawError("other", text="cannot be drawn")

    write_report(report_of(Table("drags", "Drags", FRAME)), tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with refused("other", text="cannot be drawn"):
        write_report(report_of(Table("drags", "Other", FRAME.head(1)), Picture("heights", "Heights", fails)), tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_folder_that_cannot_be_made_is_named_before_anything_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    report = report_of(Picture("heights", "Heights", lambda: pytest.fail("drawn")))
    (tmp_path / "file").write_bytes(b"")
    for folder in (tmp_path / "file", tmp_path / "file" / "report"):
        with refused("folder-not-made"):
            write_report(report, folder)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refuse)
    with refused("folder-not-made", reason="Permission denied"):
        write_report(report, tmp_path / "report")


# Parts


def test_parts_of_the_same_name_are_refused() -> None:
    with refused("report-name-twice", parts="parts", name="drags"):
        contents(report_of(Table("drags", "Drags", FRAME), Picture("drags", "Drags", heights)))
    with refused("report-name-twice", parts="parts", name="fall"):
        contents(report_of(Table("fall", "The section has this name too", FRAME)))
    twins = (Section("one", "One", (), (), {"drag": 1}), Section("two", "Two", (), (), {"drag": 2}))
    with refused("report-name-twice", parts="results", name="drag"):
        contents(Report("Falls", "", twins))


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


def test_a_kind_of_verdict_is_one_of_five() -> None:
    with refused("unknown-name"):
        Verdict("reproducd", "")


def test_a_report_keeps_the_kinds_of_blocks_that_are_wanted_and_all_results() -> None:
    report = report_of(Text("text"), Picture("heights", "Heights", heights), Table("drags", "Drags", FRAME), drag=1)
    kept = report.keep(Text, Table)
    assert [type(block) for block in kept.sections[0].blocks] == [Text, Table]
    assert kept.sections[0].verdicts == report.sections[0].verdicts
    assert kept.results == {"drag": 1}
    assert set(contents(kept)) == {"report.html", "results.json", "tables/drags.csv"}


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


def test_folds_and_galleries_get_their_files_in_a_folder_too() -> None:
    gallery = Gallery((Picture("one", "One", heights),))
    files = contents(report_of(Fold("rest", (gallery, Table("drags", "Drags", FRAME)))))
    assert {"figures/one.svg", "figures/one.png", "tables/drags.csv"} <= {*files}
