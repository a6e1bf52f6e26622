"""A file has the old or the new content, and an error of writing names it."""

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from stepgap.base.errors import InputError
from stepgap.base.files import (
    create,
    naming,
    new_file,
    new_folder,
    open_own,
    own_folder,
    read_bounded_text,
    write_whole,
)
from stepgap.base.output_files import free_name, write_together
from stepgap.records.model_files import model_path
from stepgap.records.motion_file import motion_path
from tests.full_disk import FILE_TOO_LARGE, largest_file


def test_a_full_disk_leaves_the_old_file_and_the_error_names_it(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    write_whole(path, "old")
    with largest_file(1000), pytest.raises(OSError, match=FILE_TOO_LARGE) as caught:
        write_whole(path, b"x" * 1001)
    assert caught.value.filename == str(path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["model.json"]
    assert path.read_text() == "old"


def test_a_new_file_or_folder_that_cannot_be_written_is_not_left_behind(tmp_path: Path) -> None:
    with largest_file(1000):
        with pytest.raises(OSError, match=FILE_TOO_LARGE) as caught:
            create(tmp_path / "run.mat", b"x" * 1001)
        with pytest.raises(OSError, match=FILE_TOO_LARGE), new_folder(tmp_path / "robot") as robot:
            create(robot / "robot.py", "x" * 1001)
    assert caught.value.filename == str(tmp_path / "run.mat")
    assert not list(tmp_path.iterdir())


def test_files_that_belong_together_are_all_written_or_none(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    contents: dict[Path, str | bytes] = {tmp_path / "steps.csv": "1,2\n", tmp_path / "columns.csv": "x" * 1001}
    with largest_file(1000), pytest.raises(InputError, match=rf"columns\.csv: cannot be written: {FILE_TOO_LARGE}"):
        write_together(contents, "--out")
    assert not list(tmp_path.iterdir())
    assert capsys.readouterr().out == ""
    write_together(contents, "--out")
    assert {path.name for path in tmp_path.iterdir()} == {"steps.csv", "columns.csv"}
    assert capsys.readouterr().out == f"{tmp_path}/steps.csv\n{tmp_path}/columns.csv\n"


def test_what_exists_already_is_kept(tmp_path: Path) -> None:
    create(tmp_path / "run.mat", "old")
    with pytest.raises(FileExistsError):
        create(tmp_path / "run.mat", "new")
    with pytest.raises(FileExistsError), new_folder(tmp_path / "run.mat"):
        pass
    assert (tmp_path / "run.mat").read_text() == "old"


@pytest.mark.parametrize("writing", [new_file, new_folder])
def test_an_output_gets_its_name_when_it_is_complete(tmp_path: Path, writing: Callable) -> None:
    """So that one that exists is complete, even if its process was killed."""
    target = tmp_path / "run.mcap"
    with writing(target) as partial:
        assert not target.exists()
        assert (partial.parent, partial.suffix) == (tmp_path, ".mcap")
        file = partial / "ticks" if writing is new_folder else partial
        file.parent.mkdir(exist_ok=True)
        file.write_text("all")
    assert list(tmp_path.iterdir()) == [target]
    assert (target / "ticks" if writing is new_folder else target).read_text() == "all"


@pytest.mark.parametrize("writing", [new_file, new_folder])
def test_a_name_that_another_process_took_meanwhile_keeps_its_file(tmp_path: Path, writing: Callable) -> None:
    target = tmp_path / "model"

    def write() -> None:
        with writing(target) as partial:
            (partial / "model.xml" if writing is new_folder else partial).write_text("ours")
            target.write_text("theirs")

    with pytest.raises(FileExistsError):
        write()
    assert list(tmp_path.iterdir()) == [target]
    assert target.read_text() == "theirs"


@pytest.mark.parametrize("number", [errno.EPERM, errno.EACCES, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL])
def test_a_file_system_without_links_has_new_files_too(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(path: Path, target: Path) -> None:
        raise OSError(number, f"no links from {path} to {target}")

    monkeypatch.setattr(Path, "hardlink_to", refused)
    create(tmp_path / "run.mat", "all")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("run.mat", "all")]
    with pytest.raises(FileExistsError):
        create(tmp_path / "run.mat", "other")


def test_only_errors_without_a_file_name_get_one(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"No space left on device: 'here'"), naming(Path("here")):
        raise OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(OSError, match="nowhere") as caught, naming(Path("here")):
        (tmp_path / "nowhere").read_bytes()
    assert caught.value.filename == str(tmp_path / "nowhere")
    with pytest.raises(ValueError, match="no file"), naming(Path("here")):
        raise ValueError("no file")


def test_neither_a_pipe_nor_a_device_is_read(tmp_path: Path) -> None:
    """Opening a pipe waits for its other end, and /dev/zero has no end."""
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(InputError, match=f"{path}: a pipe or a device, so it is not read"):
            read_bounded_text(path, 1000)
    with pytest.raises(IsADirectoryError):
        read_bounded_text(tmp_path, 1000)
    (tmp_path / "short.csv").write_text("height\r\n", encoding="utf-8-sig", newline="")
    assert read_bounded_text(tmp_path / "short.csv", 11) == "height\r\n"
    with pytest.raises(InputError, match=r"short\.csv: larger than 10 bytes, so it is not read"):
        read_bounded_text(tmp_path / "short.csv", 10)


def test_a_file_that_git_lfs_did_not_fetch(tmp_path: Path) -> None:
    """Network, model or settings: the reason is not that their content is wrong."""
    (tmp_path / "policy.onnx").write_text("version https://git-lfs.example/spec/v1\noid sha256:0\nsize 7\n")
    with pytest.raises(InputError, match=r"policy\.onnx: not the file, but what Git LFS has in its place; .* lfs pull"):
        read_bounded_text(tmp_path / "policy.onnx", 1000)


def test_a_folder_of_a_run_that_is_a_link_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    (tmp_path / "run").mkdir()
    (tmp_path / "latest").symlink_to("run")
    assert own_folder(tmp_path / "latest", "models") == tmp_path / "latest" / "models"  # the run itself may be one
    for name, path_in in (("models", model_path), ("replay", motion_path)):
        (tmp_path / "run" / name).symlink_to(tmp_path / "home")
        with pytest.raises(InputError, match=rf"{name}: a link, which is not followed; put the folder itself here"):
            path_in(tmp_path / "run", 1)


def test_nothing_is_written_through_a_link(tmp_path: Path) -> None:
    """A folder from somebody else may have one that leads to a file of the user."""
    precious = tmp_path / "precious"
    precious.write_text("mine")
    for name in ("model.json", "steps.csv", "lost"):
        (tmp_path / name).symlink_to(precious if name != "lost" else tmp_path / "nowhere")
    write_whole(tmp_path / "model.json", "new")
    assert not (tmp_path / "model.json").is_symlink()
    for name in ("steps.csv", "lost"):
        with pytest.raises(InputError, match=rf"{name}: a link, through which nothing is written"):
            open_own(tmp_path / name)
        with pytest.raises(FileExistsError):
            create(tmp_path / name, "new")
    assert free_name(tmp_path / "lost") == tmp_path / "lost_2"
    assert precious.read_text() == "mine"
    assert not (tmp_path / "nowhere").exists()
