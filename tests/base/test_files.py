"""A file has the old or the new content, and an error of writing names it."""

import errno
from pathlib import Path

import pytest

from stepgap.base.files import naming, write_whole
from tests.full_disk import FILE_TOO_LARGE, largest_file


def test_a_full_disk_leaves_the_old_file_and_the_error_names_it(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    write_whole(path, "old")
    with largest_file(1000), pytest.raises(OSError, match=FILE_TOO_LARGE) as caught:
        write_whole(path, b"x" * 1001)
    assert caught.value.filename == str(path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["model.json"]
    assert path.read_text() == "old"


def test_only_errors_without_a_file_name_get_one(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"No space left on device: 'here'"), naming(Path("here")):
        raise OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(OSError, match="nowhere") as caught, naming(Path("here")):
        (tmp_path / "nowhere").read_bytes()
    assert caught.value.filename == str(tmp_path / "nowhere")
    with pytest.raises(ValueError, match="no file"), naming(Path("here")):
        raise ValueError("no file")
