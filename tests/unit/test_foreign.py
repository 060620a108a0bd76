"""Bytes of strangers: read within limits, or refused with the place and the remedy."""

import os
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from commonlaw.diagnostics import Diagnostic
from commonlaw.errors import CommonlawError
from commonlaw.runtime import reading
from commonlaw.runtime.reading import check_size, check_text, checked_file, read_file, read_json
from commonlaw.trials.files import read_table
from tests.refusals import refused

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**60), 2**60) | st.floats(allow_nan=False, allow_infinity=False),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
)


@given(VALUES)
def test_json_comes_back(value):
    import msgspec

    assert read_json(msgspec.json.encode(value), object) == value


@given(st.binary(max_size=200) | st.text(alphabet='{}[]",:\\01e.n\u20ac', max_size=200).map(str.encode))
def test_anything_else_than_json_is_refused(content):
    with suppress(CommonlawError):
        read_json(content, object)


@pytest.mark.parametrize("opening", ["[", '{"a":'])
def test_json_may_be_nested_as_deep_as_is_said(opening):
    closing = {"[": "]"}.get(opening, "}")
    deep = opening * reading.DEEPEST + "0" + closing * reading.DEEPEST
    read_json(deep.encode(), object)
    with refused("json-too-deep", depth=33, limit=32):
        read_json((opening + deep + closing).encode(), object)
    with refused("json-too-deep", depth=1000000):
        read_json(opening.encode() * 1_000_000, object)


def test_json_has_a_largest_size(monkeypatch):
    monkeypatch.setattr(reading, "LARGEST_JSON", 10)
    assert read_json(b"[1, 2, 3] ", list) == [1, 2, 3]
    with refused("json-too-large", bytes=11, limit=10):
        read_json(b"[1, 2, 3]  ", list)


def test_brackets_in_texts_do_not_nest():
    assert read_json(b'"\\"' + b"[" * 100 + b'"', str) == '"' + "[" * 100


def test_text_that_is_not_utf_8_is_refused_with_its_line():
    check_text("a", "é\n".encode())
    with refused("not-utf-8", source="a", line=2):
        check_text("a", b"\n\xe9")


def test_what_is_no_file_is_refused(tmp_path):
    for path, message in (
        (tmp_path, "file-is-folder"),
        (tmp_path / "gone", Diagnostic("file-missing", {"file": "gone", "hint": "check the name"})),
        (tmp_path / "gone" / "gone", "folder-missing"),
        (tmp_path / ("a" * 300), Diagnostic("file-unreadable", {"reason": "File name too long"})),
        (Path("a\0b"), "file-unreadable"),
    ):
        with refused(message):
            read_file(path)


def test_a_file_in_a_folder_that_is_gone_or_may_not_be_searched(tmp_path, monkeypatch):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    with refused("file-missing", file="drops.csv"):
        read_file("drops.csv")

    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "stat", refuse)
    with refused("file-unreadable", file="drops.csv", reason="Permission denied"):
        read_file("drops.csv")


def test_files_and_tables_have_a_largest_size(tmp_path, monkeypatch):
    (tmp_path / "drops.csv").write_text("t,x\n0,1\n1,2\n")
    monkeypatch.setattr(reading, "MOST_CELLS", 8)
    assert len(read_table(tmp_path / "drops.csv")) == 2
    monkeypatch.setattr(reading, "MOST_CELLS", 7)
    with refused("table-too-large", source="drops.csv", count=8, cells="cells, 4 rows of 2", limit=7):
        read_table(tmp_path / "drops.csv")
    with refused("table-too-large", count=10001, cells="columns", limit=10000):
        check_size("drops.csv", 1, 10_001)
    (tmp_path / "large.csv").touch()
    os.truncate(tmp_path / "large.csv", reading.LARGEST_FILE + 1)
    with refused("file-too-large", bytes=1073741825, limit=1073741824):
        read_file(tmp_path / "large.csv")


@settings(deadline=None)
@given(st.binary(max_size=300) | st.text(alphabet='t,x;\t"\r\n 01.e-', max_size=80).map(str.encode))
def test_any_bytes_are_a_table_or_refused(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "drops.csv"
    path.write_bytes(content)
    with suppress(CommonlawError):
        assert len(read_table(path))


@settings(deadline=None)
@given(
    st.lists(st.tuples(*[st.text(alphabet="ab \"'é", max_size=4)] * 2), min_size=1, max_size=6),
    st.lists(st.sampled_from(["\n", "\r\n", "\r"]), min_size=7, max_size=7),
    st.sampled_from([",", ";", "\t"]),
)
def test_no_row_is_lost_whatever_ends_the_lines(tmp_path_factory, rows, ends, separator):
    def quoted(cell):
        return '"' + cell.replace('"', '""') + '"'

    lines = [separator.join(map(quoted, row)) for row in [("name", "note\nof it"), *rows]]
    path = tmp_path_factory.getbasetemp() / "drops.csv"
    path.write_bytes("".join(line + end for line, end in zip(lines, ends, strict=False)).encode())
    full = [tuple(cell.strip() for cell in row) for row in rows if any(row)]
    if not full:
        with refused("table-without-rows"):
            read_table(path)
        return
    table = read_table(path)
    read = zip(*(table.columns[name].tolist() for name in table.columns), strict=True)
    assert [tuple(cell.strip() if isinstance(cell, str) else "" for cell in row) for row in read] == full


def test_a_link_that_leads_nowhere_is_told_from_a_wrong_name(tmp_path):
    (tmp_path / "d.csv").symlink_to(tmp_path / "gone.csv")
    with refused("link-broken"):
        checked_file(tmp_path / "d.csv")
