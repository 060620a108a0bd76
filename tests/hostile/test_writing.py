"""Whatever is at a target, and whenever a writer is killed, files are whole, old or new, and nothing else changes."""

import os
import random
import stat
import subprocess
import sys
import time
from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory

from hypothesis import given, strategies as st

from commonlaw.errors import CommonlawError
from commonlaw.runtime.files import write_all, write_whole

NAMES = ("a", "b", "c")
WRITABLE = ("nothing", "file", "private", "link", "dangling")
KINDS = (*WRITABLE, "read-only", "folder", "circle", "hard link", "pipe")


def place(name: str, kind: str) -> None:
    """Put something of a kind into the working folder under this name."""
    path = Path(name)
    match kind:
        case "file" | "private" | "read-only":
            path.write_bytes(b"old")
            path.chmod({"file": 0o644, "private": 0o600, "read-only": 0o444}[kind])
        case "folder":
            path.mkdir()
        case "link" | "dangling":
            Path("store").mkdir(exist_ok=True)
            path.symlink_to(f"store/{name}")
            if kind == "link":
                path.write_bytes(b"old")
        case "circle":
            path.symlink_to(name)
        case "hard link":
            path.write_bytes(b"old")
            Path(f"{name}.twin").hardlink_to(path)
        case "pipe":
            os.mkfifo(path)


def look() -> dict[str, tuple[int, object]]:
    """Return kind, permissions and content of all that is in the working folder."""
    seen: dict[str, tuple[int, object]] = {}
    for path in sorted(Path().rglob("*")):
        mode = path.lstat().st_mode
        content = path.readlink() if path.is_symlink() else path.read_bytes() if stat.S_ISREG(mode) else None
        seen[str(path)] = (mode, content)
    return seen


@given(
    st.lists(st.tuples(st.sampled_from(NAMES), st.sampled_from(KINDS)), unique_by=lambda each: each[0], min_size=1),
    st.lists(st.tuples(st.sampled_from(NAMES), st.sampled_from(["", "./", "here/"])), min_size=1, max_size=4),
)
def test_all_targets_are_written_and_keep_what_they_are_or_nothing_changes(
    there: list[tuple[str, str]], named: list[tuple[str, str]]
) -> None:
    with TemporaryDirectory() as folder, chdir(folder):
        Path("here").symlink_to(".")
        for name, kind in there:
            place(name, kind)
        before = look()
        contents = {prefix + name: f"new {name}".encode() for name, prefix in named}
        if refusal := refusal_of(contents):
            assert any(refusal.startswith(f"cannot write {path}: ") for path in contents)
            assert look() == before
            return
        after = look()
        assert {dict(there).get(name, "nothing") for name, _ in named} <= set(WRITABLE)
        assert {path: Path(path).read_bytes() for path in contents} == contents
        assert {path: mode for path, (mode, _) in after.items() if path in before} == {
            path: mode for path, (mode, _) in before.items()
        }
        assert {path for path in before if after[path] != before[path]} <= written(contents)
        assert set(after) == set(before) | written(contents)


def refusal_of(contents: dict[str, bytes]) -> str:
    """Write, and return what is said if it is refused."""
    try:
        write_all(contents)
    except CommonlawError as error:
        return str(error)
    return ""


def written(contents: dict[str, bytes]) -> set[str]:
    """Return the files that paths mean once links are followed."""
    return {str(Path(path).resolve().relative_to(Path.cwd())) for path in contents}


SIZE = 1_000_000
WRITE_FOR_EVER = f"""
import sys
from commonlaw.runtime.files import write_all
for letter in map(str.encode, sys.argv[1] * 1000):
    write_all({{"law.json": letter * {SIZE}, "law.png": letter * {SIZE}}})
    print(letter, flush=True)
"""


def start_writing(folder: Path, letters: str) -> "subprocess.Popen[bytes]":
    """Start a process that writes two files again and again; return when it has done so once."""
    command = [sys.executable, "-c", WRITE_FOR_EVER, letters]
    writer = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE)
    assert writer.stdout is not None
    assert writer.stdout.readline()
    return writer


def stop(writer: "subprocess.Popen[bytes]", how: str = "kill") -> None:
    getattr(writer, how)()
    writer.communicate()


def is_whole(path: Path) -> bool:
    content = path.read_bytes()
    return len(content) == SIZE and len(set(content)) == 1


def test_a_writer_that_is_killed_leaves_whole_files_and_nothing_that_the_next_one_does_not_remove(
    tmp_path: Path,
) -> None:
    writer = start_writing(tmp_path, "ab")
    time.sleep(random.Random(0).uniform(0, 0.1))
    stop(writer)
    assert is_whole(tmp_path / "law.json")
    assert is_whole(tmp_path / "law.png")
    write_whole(tmp_path / "law.json", b"new")
    assert {each.name for each in tmp_path.iterdir()} == {"law.json", "law.png"}


def test_processes_that_write_to_one_target_do_not_disturb_each_other(tmp_path: Path) -> None:
    writers, began = [start_writing(tmp_path, letter) for letter in "ab"], time.monotonic()
    seen: set[bytes] = set()
    while len(seen) < 2 and time.monotonic() < began + 60:
        content = (tmp_path / "law.json").read_bytes()
        assert len(content) == SIZE
        seen |= {content[:1], content[-1:]}
        write_whole(tmp_path / "law.txt", b"new")
    assert seen == {b"a", b"b"}
    assert is_whole(tmp_path / "law.json")
    assert [writer.poll() for writer in writers] == [None, None]
    for writer in writers:
        stop(writer)
