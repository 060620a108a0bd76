"""Sessions on disk: what is saved is opened again, whoever else saves, and is read as a stranger's file."""

import ast
import csv
import io
import json
import threading
from contextlib import suppress
from dataclasses import replace
from html.parser import HTMLParser

import msgspec
import numpy as np
import openpyxl
import pytest

import commonlaw as cl
from commonlaw.app.preview import sample_table
from commonlaw.app.question import Columns, Edit, Equations, HoldOut, Question, Table, named
from commonlaw.app.result import Found, figure_file
from commonlaw.app.routes import _MAKERS
from commonlaw.app.sessions import FOLDER, Named, SavedSessions, Session, Sessions, State, answer
from commonlaw.law import from_json, to_json
from commonlaw.law.script import Source
from commonlaw.report import law_report, to_page
from tests.refusals import refused
from tests.texts import planted, texts


@pytest.fixture
def saved(tmp_path, monkeypatch) -> SavedSessions:
    monkeypatch.setenv(FOLDER, str(tmp_path / "sessions"))
    return SavedSessions()


def saving(table: Table) -> tuple[Sessions, Named]:
    """Return what a page has opened, and its wish to save it."""
    sessions = Sessions()
    return sessions, Named("mine", sessions.open_table(table), {})


@pytest.mark.slow
def test_a_session_of_the_largest_table_that_the_app_takes_is_listed_and_opened(saved: SavedSessions) -> None:
    content = np.random.default_rng(0).bytes(64 * 2**20)
    sessions, asked = saving(named("large.csv", content))
    summary = saved.save(asked, sessions)
    assert SavedSessions().listed() == [summary]
    opened = saved.resume(summary["key"], sessions)
    assert sessions.tables.get(opened["table"]).content == content


def test_tabs_that_save_one_session_keep_all_states(saved: SavedSessions) -> None:
    sessions, asked = saving(named("a.csv", b"t,x\n0,1\n"))
    asked.key = saved.save(asked, sessions)["key"]
    tabs = [
        threading.Thread(
            target=SavedSessions().save, args=(msgspec.structs.replace(asked, columns={"time": f"t{i}"}), sessions)
        )
        for i in range(10)
    ]
    for tab in tabs:
        tab.start()
    for tab in tabs:
        tab.join()
    (summary,) = saved.listed()
    assert summary["states"] == 11
    written = json.loads((saved.folder / f"{asked.key}.json").read_bytes())
    assert {state["columns"].get("time") for state in written["states"]} == {None, *(f"t{i}" for i in range(10))}


def test_what_could_not_be_opened_again_is_not_saved(saved: SavedSessions) -> None:
    sessions, asked = saving(named("a.csv", b"t,x\n0,1\n"))
    summary = saved.save(asked, sessions)
    before = (saved.folder / f"{summary['key']}.json").read_bytes()
    asked.key = summary["key"]
    with refused("session-not-saved"):
        saved.save(msgspec.structs.replace(asked, columns={"edits": (Edit(between=(np.nan, 1.0)),)}), sessions)
    assert [path.read_bytes() for path in saved.folder.glob("*.json")] == [before]


def test_a_damaged_session_is_listed_with_its_reason(saved: SavedSessions) -> None:
    sessions, asked = saving(named("a.csv", b"t,x\n0,1\n"))
    summary = saved.save(asked, sessions)
    (saved.folder / "0123456789abcdef.json").write_text("{}")
    good, damaged = saved.listed()
    assert good == summary
    assert damaged["key"] == "0123456789abcdef"
    assert damaged["problem"]


def test_a_folder_that_is_there_keeps_its_permissions_and_a_new_one_is_private(saved: SavedSessions) -> None:
    sessions, asked = saving(named("a.csv", b"t,x\n0,1\n"))
    saved.folder.mkdir(mode=0o755)
    saved.folder.chmod(0o755)
    saved.save(asked, sessions)
    assert saved.folder.stat().st_mode & 0o777 == 0o755
    assert all(path.stat().st_mode & 0o077 == 0 for path in saved.folder.iterdir())
    for path in saved.folder.iterdir():
        path.unlink()
    saved.folder.rmdir()
    saved.save(asked, sessions)
    assert saved.folder.stat().st_mode & 0o777 == 0o700


SENTINELS = (
    "__import__('os').system('planted')",
    "');planted('",
    "=planted()",
    'a\n"""\'+planted()+\'"""<script>planted()</script><img src=x onerror=planted()>$(planted)`planted`',
)
"""Code of Python, of a sheet, of a page and of a shell."""
WORDS = {"cl", "law", "trials", "measured", "figure", "print", "float"}
"""Names in a program; all other words are attributes of the package or texts."""


def check_program(text: str) -> None:
    tree = [*ast.walk(ast.parse(text))]
    assert {node.id for node in tree if isinstance(node, ast.Name)} <= WORDS
    assert not [node.attr for node in tree if isinstance(node, ast.Attribute) and node.attr in ("planted", "system")]


def check_sheet(content: bytes) -> None:
    cells = [cell for sheet in openpyxl.load_workbook(io.BytesIO(content)) for row in sheet.iter_rows() for cell in row]
    assert "f" not in {cell.data_type for cell in cells}


class Markup(HTMLParser):
    """What a browser would run of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.code, self._inside = list[str](), ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._inside = tag
        self.code += [value or "" for name, value in attrs if name.startswith("on") or name in ("href", "src", "style")]

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        self.code += [data] * (self._inside in ("script", "style"))


TABLE = sample_table("linear-drag")
COLUMNS = Columns(
    object="object", trial="trial", time="t [s]", states=("x [m]",), properties=(), missing=("n/a",), decimal=".",
    edits=(Edit(object="Ball 1", trial="1"), Edit(object="Ball 2", between=(1.0, 2.0)), Edit(blanks=("Ball 3",))),
)  # fmt: skip
EQUATIONS = Equations(
    "x'' = -g - c v", {"g": (9.8,), "c": (0.1,)}, fixed=("g",), bounds={"c": (0.0, None)}, shared={"c": "all"},
    priors={"c": (0.1, 0.1)}, starts={"x": "free"}, doses=(),
)  # fmt: skip


@pytest.fixture(scope="module")
def found() -> Found:
    question = Question("", {}, equations=Equations("x'' = -g - c v"), settings={"errors": ("white",)})
    return next(answer(question, TABLE, None, lambda _: None))


def session_of(found: Found) -> dict:
    """Return a session in which every text is given, with its law as JSON in JSON."""
    asked = Question(
        "", COLUMNS, 2, "poly:1", HoldOut("object", "Ball 1"), {"1": -9.8}, True, {"errors": ("white",)}, EQUATIONS
    )
    document = json.loads(msgspec.json.encode(Session("mine", "2026", TABLE, (State(COLUMNS, asked, "{}"),))))
    document["states"][0]["law"] = json.loads(to_json(found.law))
    return document


@pytest.mark.parametrize("step", [3, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("sentinel", SENTINELS)
def test_no_text_of_a_session_becomes_code(found: Found, saved: SavedSessions, sentinel: str, step: int) -> None:
    """With steps over places, the sentinels together are in all of them."""
    document, opened = session_of(found), 0
    places = [*texts(document)][SENTINELS.index(sentinel) % step :: step]
    saved.folder.mkdir()
    for place in places:
        changed = planted(document, place, sentinel)
        state = changed["states"][0]
        if not isinstance(state, str):
            changed = planted(changed, ("states", 0, "law"), json.dumps(state["law"]))
        (saved.folder / "0123456789abcdef.json").write_text(json.dumps(changed))
        try:
            session = saved._read("0123456789abcdef")
            state = session.states[-1]
            law = from_json(state.law)
        except cl.CommonlawError:
            continue
        opened += 1
        source = state.question.source(session.table)
        with_law = replace(found, findings=replace(found.findings, law=law))
        check_program(_MAKERS["law.py"](with_law, source))
        for name in ("phase-plane.py", "profile.py"):
            check_program(figure_file(name, with_law, source, owner=sentinel, parameter=sentinel).decode())
        if "law" in place:
            with suppress(cl.CommonlawError):  # An unknown unit, say
                check_sheet(_MAKERS["coefficients.xlsx"](with_law, source))
    assert opened > len(places) / 4


@pytest.fixture(scope="module")
def hostile() -> tuple[Found, Source]:
    """A law of a table whose names are the sentinels."""
    times, random = np.linspace(0.0, 4.0, 30), np.random.default_rng(0)
    rows = io.StringIO()
    sheet = csv.writer(rows)
    sheet.writerow([SENTINELS[3], "t", SENTINELS[2], SENTINELS[1]])
    for i, name in enumerate(SENTINELS):
        for t, x in zip(times, np.exp(-0.5 * (i + 1) * times) + 0.01 * random.standard_normal(30), strict=True):
            sheet.writerow([name, t, x, i])
    table = named(f"{SENTINELS[3]}.csv", rows.getvalue().encode())
    columns = Columns(object=SENTINELS[3], time="t", states=(SENTINELS[2],), properties=(SENTINELS[1],))
    question = Question("", columns, 1, "poly:1", settings={"errors": ("white",)})
    return next(answer(question, table, None, lambda _: None)), question.source(table)


def test_no_name_in_a_table_becomes_code(hostile: tuple[Found, Source]) -> None:
    result, source = hostile
    assert result.law.objects == SENTINELS
    check_program(_MAKERS["law.py"](result, source))
    check_program(figure_file("profile.py", result, source, owner=SENTINELS[3], parameter="a").decode())
    check_sheet(_MAKERS["coefficients.xlsx"](result, source))


@pytest.mark.slow
def test_no_name_in_a_table_becomes_code_in_the_page_of_a_report(hostile: tuple[Found, Source]) -> None:
    result, source = hostile
    page = to_page(law_report(result.findings, table=source, title=SENTINELS[3], about=SENTINELS[3])).decode()
    assert "planted" in page
    assert not [code for code in Markup(page).code if "planted" in code]
