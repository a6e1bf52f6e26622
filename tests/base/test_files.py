"""A file is the old one or the new one, and an error of writing names it."""

import errno
from pathlib import Path

import pytest

from stepgap.base.files import append_text, naming, write_whole
from tests.full_disk import FILE_TOO_LARGE, largest_file


def test_a_full_disk_leaves_the_old_file_and_is_said_with_its_name(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    write_whole(path, "old")
    with largest_file(1000), pytest.raises(OSError, match=FILE_TOO_LARGE) as caught:
        write_whole(path, b"x" * 1001)
    assert caught.value.filename == str(path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["model.json"]
    assert path.read_text() == "old"


def test_a_text_that_cannot_be_added_is_said_with_its_name(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    append_text(path, "one\n")
    append_text(path, "two\n")
    assert path.read_text() == "one\ntwo\n"
    with largest_file(10), pytest.raises(OSError, match=FILE_TOO_LARGE) as caught:
        append_text(path, "three\n")
    assert caught.value.filename == str(path)


def test_only_what_the_system_says_without_a_name_gets_one(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"No space left on device: 'here'"), naming(Path("here")):
        raise OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(OSError, match="nowhere") as caught, naming(Path("here")):
        (tmp_path / "nowhere").read_bytes()
    assert caught.value.filename == str(tmp_path / "nowhere")
    with pytest.raises(ValueError, match="no file"), naming(Path("here")):
        raise ValueError("no file")
