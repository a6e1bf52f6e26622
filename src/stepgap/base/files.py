"""Files that are complete at every moment, and errors that name the file they are about."""

import errno
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from stepgap.base.errors import InputError


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Adds the name of a file to operating-system errors that name none, such as that of a full disk.

    Raises:
        OSError: The error raised inside; its `filename` is `path` unless it was set.
    """
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def open_regular(path: Path) -> BinaryIO:
    """Opens a file for reading, but no pipe, for whose other end one would wait, and no device, which has no end.

    Raises:
        InputError: It is no regular file.
        OSError: It cannot be opened.
    """
    return open(path, "rb", opener=_regular)


def open_own(path: Path) -> BinaryIO:
    """Opens a file that the program itself keeps, for reading and for writing at its end; made if there is none.

    A link with this name, which may lead to any file of the user, is not followed.

    Raises:
        InputError: It is a link, or no regular file.
        OSError: It cannot be opened.
    """
    if path.is_symlink():
        raise InputError(f"{path}: a link, through which nothing is written; put the file itself here")
    return open(path, "a+b", opener=_own)


def own_folder(folder: Path, name: str) -> Path:
    """Path of a folder that the program itself keeps within another one; it need not exist.

    A link with this name, which may lead to any folder of the user, is not followed.

    Raises:
        InputError: It is a link.
    """
    path = folder / name
    if path.is_symlink():
        raise InputError(f"{path}: a link, which is not followed; put the folder itself here")
    return path


def _own(name: str, flags: int) -> int:
    return _regular(name, flags | os.O_NOFOLLOW)


def _regular(name: str, flags: int) -> int:
    """Opens a file, or a folder, which `open` refuses itself; raises InputError for a pipe or a device."""
    descriptor = os.open(name, flags | os.O_NONBLOCK, 0o666)
    mode = os.fstat(descriptor).st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        os.close(descriptor)
        raise InputError(f"{name}: a pipe or a device, so it is not read; give a file")
    return descriptor


GIT_LFS = b"version https://git-lfs"
"""Begin of what Git LFS has in the place of a file that was not fetched."""

NOT_FETCHED = "not the file, but what Git LFS has in its place; get it by `git lfs pull`"
"""What is wrong with a file that begins so."""


def read_bounded(path: Path, largest: int) -> bytes:
    """Reads a regular file of at most `largest` bytes.

    Raises:
        InputError: The file is larger, it is a pipe or a device, or Git LFS did not fetch it.
        OSError: It cannot be read.
    """
    content = bytearray()
    with open_regular(path) as file:  # in parts, because read(n) takes memory for n bytes, however short the file is
        while len(content) <= largest and (part := file.read(min(2**16, largest + 1 - len(content)))):
            content += part
    if len(content) > largest:
        raise InputError(f"{path}: larger than {largest} bytes, so it is not read")
    if content.startswith(GIT_LFS):
        raise InputError(f"{path}: {NOT_FETCHED}")
    return bytes(content)


def read_bounded_text(path: Path, largest: int) -> str:
    """Reads a text file in UTF-8, with or without the byte-order mark that some editors and spreadsheets write.

    Raises:
        InputError: The file is larger than `largest` bytes, or it is a pipe or a device.
        UnicodeDecodeError: It is not text in UTF-8.
        OSError: It cannot be read.
    """
    return read_bounded(path, largest).decode("utf-8-sig")


def write_whole(path: Path, content: str | bytes) -> None:
    """Writes a file atomically: a reader finds the old or the new content, never a part, even after a crash.

    Its folder is created if it is missing.

    Raises:
        OSError: It cannot be written; the old file, if there is one, is unchanged.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.partial")
    partial.unlink(missing_ok=True)  # so that nothing is written through a link with this name
    with naming(path):
        try:
            with partial.open("xb") as file:
                file.write(content.encode("utf-8") if isinstance(content, str) else content)
                file.flush()
                os.fsync(file.fileno())
        except OSError:
            partial.unlink(missing_ok=True)  # a part of the content would only fill the disk
            raise
        partial.replace(path)


def create(path: Path, content: str | bytes) -> None:
    """Writes a file that must not exist; also if this fails or is killed, there is never a part of it.

    Raises:
        FileExistsError: It exists already.
        OSError: It cannot be written.
    """
    with new_file(path) as partial, partial.open("xb") as file:
        file.write(content.encode("utf-8") if isinstance(content, str) else content)


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Gives a name beside `path`, under which the file is written within the block; at its end it becomes `path`.

    Raises:
        FileExistsError: `path` exists already.
        OSError: It cannot be written.
    """
    with _becoming(path) as partial:
        yield partial
        try:
            path.hardlink_to(partial)  # unlike a renamed file, it replaces no other one
        except (OSError, NotImplementedError):  # a file system without links, such as FAT
            _check_absent(path)
            partial.rename(path)
        partial.unlink(missing_ok=True)


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Makes a folder beside `path`, which is filled within the block; at its end it becomes `path`.

    Raises:
        FileExistsError: `path` exists already.
        OSError: It cannot be made.
    """
    with _becoming(path) as partial:
        partial.mkdir()
        yield partial
        _check_absent(path)
        partial.rename(path)


@contextmanager
def _becoming(path: Path) -> Iterator[Path]:
    """Gives a name beside `path` for what will be `path`; removed if the block fails, whose error names `path`.

    Raises:
        FileExistsError: `path` exists already.
    """
    _check_absent(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial{path.suffix}")
    try:
        with removed_on_failure(partial):
            yield partial
    except OSError as error:
        error.filename = str(error.filename or path).replace(str(partial), str(path))
        error.filename2 = None
        raise


def _check_absent(path: Path) -> None:
    if os.path.lexists(path):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))


@contextmanager
def removed_on_failure(path: Path) -> Iterator[None]:
    """Removes a file or a folder if the block does not end normally."""
    try:
        yield
    except BaseException:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
        raise
