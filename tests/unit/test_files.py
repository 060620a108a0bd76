"""Files are written whole or not at all, and files of strangers are read within limits."""

import os
import re
import socket
import stat
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd
import pytest
from hypothesis import given, strategies as st

from commonlaw.diagnostics import Diagnostic
from commonlaw.errors import CommonlawError
from commonlaw.runtime import files
from commonlaw.runtime.files import (
    check_size,
    check_targets,
    check_text,
    checked_file,
    make_folder,
    read_file,
    read_json,
    write_all,
    write_whole,
)
from commonlaw.trials import Trials
from commonlaw.trials.files import read_table
from tests.refusals import refused


def mode_of(path):
    return stat.S_IMODE(path.stat().st_mode)


def test_a_missing_folder_is_named_and_no_other_target_is_touched(tmp_path):
    (tmp_path / "law.json").write_bytes(b"old")
    with refused("output-refused"):
        write_all({tmp_path / "law.json": b"new", tmp_path / "absent" / "law.png": b"new"})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"law.json": b"old"}


FULL = """
import resource, sys
from commonlaw.errors import CommonlawError
from commonlaw.runtime.files import write_all
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    write_all({"law.json": b"new", "law.png": bytes(2000)})
except CommonlawError as error:
    sys.exit(str(error))
"""


def test_a_full_disk_names_the_target_leaves_the_old_files_and_nothing_half_written(tmp_path):
    (tmp_path / "law.json").write_bytes(b"old")
    ended = subprocess.run([sys.executable, "-c", FULL], cwd=tmp_path, capture_output=True, text=True)
    assert ended.stderr == (
        "cannot write law.png: File too large; choose a folder that you may write to and that has space"
        " [output-failed]\n"
    )
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"law.json": b"old"}


# What is there already


def test_a_new_file_has_the_permissions_that_any_program_would_give_it(tmp_path):
    (tmp_path / "other").touch()
    write_whole(tmp_path / "law.json", b"new")
    assert mode_of(tmp_path / "law.json") == mode_of(tmp_path / "other")


def test_a_file_that_is_replaced_keeps_its_owner(tmp_path, monkeypatch):
    given = []
    target = tmp_path / "law.json"
    target.write_bytes(b"old")
    monkeypatch.setattr(os, "chown", lambda _, *owner: given.append(owner))
    write_whole(target, b"new")
    assert given == [(os.getuid(), os.getgid())]


def test_permissions_of_a_group_that_cannot_be_kept_are_given_to_no_other(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    target = tmp_path / "law.json"
    target.write_bytes(b"old")
    target.chmod(0o664)
    monkeypatch.setattr(os, "chown", refuse)
    write_whole(target, b"new")
    assert mode_of(target) == 0o604


def test_a_device_is_written_to_and_stays_one():
    reader, device = os.openpty()
    name = os.ttyname(device)
    write_whole(name, b"new")
    assert os.read(reader, 10) == b"new"
    assert stat.S_ISCHR(Path(name).stat().st_mode)
    os.close(reader)
    os.close(device)


def test_a_pipe_takes_content_of_any_length_if_something_reads_from_it(tmp_path):
    pipe, content = tmp_path / "pipe", bytes(range(256)) * 2000
    os.mkfifo(pipe)
    with refused("output-failed", reason="No such device or address"):
        write_whole(pipe, b"new")
    read = []
    opened = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    os.set_blocking(opened, True)
    with os.fdopen(opened, "rb") as file:
        reader = threading.Thread(target=lambda: read.append(file.read()))
        # As nothing writes yet, a reader would find the end at once
        holder = os.open(pipe, os.O_WRONLY)
        reader.start()
        write_whole(pipe, content)
        os.close(holder)
        reader.join()
    assert read == [content]
    assert stat.S_ISFIFO(pipe.stat().st_mode)


@pytest.mark.parametrize(
    ("path", "code", "reason"),
    [
        ("", "output-refused", "it is a folder; name a file in it"),
        ("folder", "output-refused", "it is a folder; name a file in it"),
        ("read-only", "output-refused", "it is read-only; make it writable, or choose another name"),
        ("circle", "output-failed", "Too many levels of symbolic links"),
        (
            "hard",
            "output-refused",
            "it is one file under several names (hard links); remove this name first, or choose another",
        ),
        ("socket", "output-refused", "it is neither a file nor a pipe; choose another name"),
        ("a" * 300, "output-failed", "File name too long"),
        ("a" * 300 + "/law.json", "output-failed", "File name too long"),
        ("file/law.json", "output-refused", "there is no folder 'file'; create it or choose another"),
        ("law\0.json", "output-failed", "embedded null"),
        ("\ud800.json", "output-failed", "surrogates not allowed"),
    ],
)
def test_a_path_that_cannot_be_written_to_is_refused(tmp_path, monkeypatch, path, code, reason):
    monkeypatch.chdir(tmp_path)
    for name in ("file", "read-only", "hard"):
        Path(name).touch()
    Path("read-only").chmod(0o444)
    Path("twin").hardlink_to("hard")
    Path("folder").mkdir()
    Path("circle").symlink_to("circle")
    with socket.socket(socket.AF_UNIX) as opened:
        opened.bind("socket")
        with refused(code) as caught:
            write_whole(path, b"new")
    assert reason in caught.value.parameters["reason"]


SHUT = """
import os
from commonlaw.diagnostics import sentences
from commonlaw.errors import CommonlawError
from commonlaw.runtime.files import write_whole
sentences()  # While the package may be read
if os.getuid() == 0:
    os.setgid(65534), os.setuid(65534)  # root may write everywhere
for path in ("hidden/law.json", "shown/law.json", "shown/old.json"):
    try:
        write_whole(path, b"new")
    except CommonlawError as error:
        print(error)
"""


def test_folders_that_may_not_be_searched_or_written_to_are_refused():
    with TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        for folder, mode in (("hidden", 0o600), ("shown", 0o555)):
            (Path(name) / folder).mkdir()
            (Path(name) / folder / "old.json").touch()
            (Path(name) / folder / "old.json").chmod(0o666)
            (Path(name) / folder).chmod(mode)
        ended = subprocess.run([sys.executable, "-c", SHUT], cwd=name, capture_output=True, text=True, check=True)
        (Path(name) / "hidden").chmod(0o700)
        (Path(name) / "shown").chmod(0o700)
    said = [re.sub(r"'.*'", "FOLDER", line) for line in ended.stdout.splitlines()]
    assert said == [
        "cannot write hidden/law.json: Permission denied; choose a folder that you may write to and that has space"
        " [output-failed]",
        "cannot write shown/law.json: you may not write to the folder FOLDER; choose one that you may write to"
        " [output-refused]",
        "cannot write shown/old.json: you may not write to the folder FOLDER; choose one that you may write to"
        " [output-refused]",
    ]


def test_a_working_folder_that_is_gone_is_refused(tmp_path, monkeypatch):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    with refused("output-failed", path="law.json", reason="No such file or directory"):
        write_whole("law.json", b"new")
    with refused("folder-not-made", folder="report", reason="No such file or directory"):
        make_folder("report")


# Several targets


@pytest.mark.parametrize("other", ["./law.json", "link.json", "here/law.json"])
@pytest.mark.parametrize("old", [True, False])
def test_two_contents_for_one_file_are_refused(tmp_path, monkeypatch, other, old):
    monkeypatch.chdir(tmp_path)
    Path("here").symlink_to(".")
    Path("link.json").symlink_to("law.json")
    if old:
        Path("law.json").write_bytes(b"old")
    with refused("output-twice", path=other):
        write_all({"law.json": b"a", other: b"b"})
    assert Path("law.json").exists() == old


def test_an_input_is_not_written_over(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("in.csv").touch()
    Path("link.csv").symlink_to("in.csv")
    check_targets(["out.csv"], ["in.csv", "absent.csv"])
    for path in ("in.csv", "./in.csv", "link.csv"):
        with refused("output-twice", path=path, reason="it is read here too"):
            check_targets([path], ["in.csv"])


def test_the_file_that_standard_output_goes_to_is_not_replaced(tmp_path):
    script = (
        "from commonlaw.runtime.files import write_whole; print('shown', flush=True); write_whole('out.txt', b'new')"
    )
    with (tmp_path / "out.txt").open("w") as output:
        ended = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, stdout=output, stderr=subprocess.PIPE)
    assert (
        b"cannot write out.txt: standard output or standard error goes there too; choose another name" in ended.stderr
    )
    assert (tmp_path / "out.txt").read_text() == "shown\n"


def test_a_pipe_that_breaks_leaves_the_files_of_the_same_call_as_they_were(tmp_path):
    (tmp_path / "law.json").write_bytes(b"old")
    os.mkfifo(tmp_path / "pipe")
    with refused("output-failed", reason="No such device or address"):
        write_all({tmp_path / "law.json": b"new", tmp_path / "pipe": b"new"})
    assert (tmp_path / "law.json").read_bytes() == b"old"


# What killed processes leave


def test_what_a_killed_process_left_is_removed_and_nothing_else(tmp_path):
    left = f".commonlaw-{'0123456789abcdef' * 2}"
    kept = {".commonlaw-notes", f"{left}x", "a-0", f".commonlaw-{'f' * 32}-0"}
    for name in (left, f"{left}-0", f"{left}-17", *kept):
        (tmp_path / name).write_bytes(b"half")
    write_whole(tmp_path / "law.json", b"new")
    assert {each.name for each in tmp_path.iterdir()} == {"law.json", *kept}


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
    deep = opening * files.DEEPEST + "0" + closing * files.DEEPEST
    read_json(deep.encode(), object)
    with refused("json-too-deep", depth=33, limit=32):
        read_json((opening + deep + closing).encode(), object)
    with refused("json-too-deep", depth=1000000):
        read_json(opening.encode() * 1_000_000, object)


def test_json_has_a_largest_size():
    assert read_json(b"[1, 2, 3] ", list, 10) == [1, 2, 3]
    with refused("json-too-large", bytes=11, limit=10):
        read_json(b"[1, 2, 3]  ", list, 10)
    with refused("json-too-large", limit=files.LARGEST_JSON):
        read_json(b" " * (files.LARGEST_JSON + 1), list)


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


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["golf_1", "golf_2", "tennis_1"], [("golf", "1"), ("golf", "2"), ("tennis", "1")]),
        (["run 2", "run 10"], [("run", "2"), ("run", "10")]),
        (["ball_1", "ball_2"], [("ball_1", "1"), ("ball_2", "1")]),
        (["ball1", "cup"], [("ball1", "1"), ("cup", "1")]),
        (["golf/a", "golf/b", "tennis/a"], [("golf", "a"), ("golf", "b"), ("tennis", "a")]),
    ],
)
def test_names_of_files_are_those_of_objects_and_trials(tmp_path, names, expected):
    for i, name in enumerate(names):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.csv").write_text(f"t [s],x [m]\n0,{i}\n1,2\n2,3\n")
    (tmp_path / "law.json").write_text("{}")
    trials = Trials.read(tmp_path)
    assert [(trial.object, trial.name) for trial in trials] == expected
    assert [trial.states[0, 0] for trial in trials] == list(range(len(names)))
    assert trials.schema.units == {"t": "s", "x": "m"}
    pattern = str(tmp_path / ("*/*.csv" if "/" in names[0] else "*.csv"))
    assert Trials.read(pattern).objects == Trials.read([tmp_path / f"{name}.csv" for name in names]).objects
    assert trials.objects == Trials.read(pattern).objects


def test_files_of_one_table_have_the_same_columns_and_a_fault_is_located_in_its_file(tmp_path):
    (tmp_path / "a.csv").write_text("t,x\n0,1\n1,2\n2,3\n")
    (tmp_path / "b.csv").write_text("x,t\n1,0\n2,1\nthree,2\n")
    with refused("cell-unreadable", where="a.csv and 1 other file: column 'x', row 3 (line 4) of b.csv, b, trial 1"):
        Trials.read(tmp_path)
    (tmp_path / "b.csv").write_text("t,y\n0,1\n")
    with refused("files-differ", first="a.csv"):
        Trials.read(tmp_path)


def test_a_row_of_units_below_the_header_of_a_sheet_is_read(tmp_path):
    rows = pd.DataFrame({"Time": ["s", 0.0, 1.0, 2.0], "Angle": ["rad", 0.1, 0.3, 0.2]})
    rows.to_excel(tmp_path / "a.xlsx", index=False)
    trials = Trials.read(tmp_path / "a.xlsx")
    assert trials.schema.units == {"Time": "s", "Angle": "rad"}
    assert trials[0].states[:, 0].tolist() == [0.1, 0.3, 0.2]


def test_files_and_tables_have_a_largest_size(tmp_path, monkeypatch):
    (tmp_path / "drops.csv").write_text("t,x\n0,1\n1,2\n")
    monkeypatch.setattr(files, "MOST_CELLS", 4)
    assert len(read_table(tmp_path / "drops.csv")) == 2
    monkeypatch.setattr(files, "MOST_CELLS", 3)
    with refused("table-too-large", source="drops.csv", count=4, cells="cells, 2 rows of 2", limit=3):
        read_table(tmp_path / "drops.csv")
    with refused("table-too-large", count=10001, cells="columns", limit=10000):
        check_size("drops.csv", 1, 10_001)
    (tmp_path / "large.csv").touch()
    os.truncate(tmp_path / "large.csv", files.LARGEST_FILE + 1)
    with refused("file-too-large", bytes=1073741825, limit=1073741824):
        read_file(tmp_path / "large.csv")


@given(st.binary(max_size=300) | st.text(alphabet='t,x;\t"\r\n 01.e-', max_size=80).map(str.encode))
def test_any_bytes_are_a_table_or_refused(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "drops.csv"
    path.write_bytes(content)
    with suppress(CommonlawError):
        assert len(read_table(path))


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


LONG = {
    "escapes": b'{"law": "' + b'"\\' * 2_000_000,
    "quotes": b'"' * 4_000_000,
    "texts": b"[" + b'"a",' * 1_000_000 + b'"a"]',
    "brackets": b"[" * 4_000_000,
}


@pytest.mark.parametrize("name", LONG)
def test_json_of_any_texts_is_read_or_refused_at_once(name):
    began = time.monotonic()
    with suppress(CommonlawError):
        read_json(LONG[name], object)
    assert time.monotonic() - began < 5


def test_brackets_in_texts_are_not_nested():
    assert read_json(b'["' + b"[" * 100 + b'", "\\\\", "\\"' + b"{" * 100 + b'"]', object)[1] == "\\"
