"""Files are written whole or not at all."""

import errno
from pathlib import Path

import pytest

from commonlaw.errors import CommonlawError
from commonlaw.files import write_all, write_whole


def test_content_replaces_what_was_there_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    target = tmp_path / "law.json"
    target.write_bytes(b"a longer text that was there before")
    write_whole(target, b"new")
    assert target.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [target]


def test_a_path_may_be_text(tmp_path: Path) -> None:
    write_whole(str(tmp_path / "law.json"), b"")
    assert (tmp_path / "law.json").read_bytes() == b""


def test_a_missing_folder_is_named_and_no_other_target_is_touched(tmp_path: Path) -> None:
    (tmp_path / "law.json").write_bytes(b"old")
    with pytest.raises(CommonlawError, match=r"no folder '.*absent'; create it or choose another"):
        write_all({tmp_path / "law.json": b"new", tmp_path / "absent" / "law.png": b"new"})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"law.json": b"old"}


def test_a_folder_is_not_written_over(tmp_path: Path) -> None:
    with pytest.raises(CommonlawError, match="it is a folder; name a file in it"):
        write_whole(tmp_path, b"new")


def test_a_full_disk_names_the_target_leaves_the_old_files_and_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "law.json").write_bytes(b"old")
    write_bytes = Path.write_bytes

    def write_some(path: Path, content: bytes) -> int:
        if len(content) > 3:
            write_bytes(path, content[:3])
            raise OSError(errno.ENOSPC, "No space left on device")
        return write_bytes(path, content)

    monkeypatch.setattr(Path, "write_bytes", write_some)
    with pytest.raises(CommonlawError, match=r"cannot write .*law\.png: No space left on device; choose"):
        write_all({tmp_path / "law.json": b"new", tmp_path / "law.png": b"too much"})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"law.json": b"old"}
