"""The folder of a plan: which cases are claimed, and the results of the finished ones.

The files hold the whole state, so that any process may end at any time. A result is stored by atomic rename. A claim is
a lock of the operating system on the byte of the file `claims` whose position is the case's number: the lock ends with
its process, so that a killed process leaves no claim behind, and 10⁵ cases need no further files.
"""

import errno
import fcntl
import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path, PurePosixPath
from typing import Self

from stepgap.base.errors import InputError
from stepgap.base.files import write_whole
from stepgap.sweep.cases.plan import CaseResult, Plan

LARGEST_RESULT = 2**26
"""Largest result of a case that is read [bytes]."""

CLAIMS = "claims"
"""File on whose bytes the claims are locks; it is empty."""

_IN_A_FOLDER = 1000
"""Number of results in one folder, since file systems become slow with many more."""


class CaseFolder:
    """The cases of a plan in a folder, which several processes may use at the same time. Use it as a context manager.

    Args:
        path: The folder; it is created if it does not exist.
        plan: The plan, whose files are written into a new folder.
        join: Whether the folder may hold results of this plan already.

    Raises:
        InputError: The folder holds the cases of another plan, or other files.
        OSError: A file cannot be read or written.
    """

    def __init__(self, path: Path, plan: Plan, join: bool):
        self.path, self._count, self._files = path, len(plan), dict(plan.files)
        self._digest = sha256(json.dumps(self._files).encode()).hexdigest()
        self._missing(join)  # before anything is written
        path.mkdir(parents=True, exist_ok=True)
        self._claims = os.open(path / CLAIMS, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            with self.alone():
                for name in self._missing(join):
                    write_whole(path / name, self._files[name])
        except BaseException:
            os.close(self._claims)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        os.close(self._claims)

    def _missing(self, join: bool) -> list[str]:
        """Files of the plan that are not in the folder yet, in the order in which they are written.

        The first file of the plan is written last: it says that all are there.
        """
        texts = {name: _text_of(self.path / name) for name in self._files}
        complete = next(iter(texts.values())) is not None
        for name, text in self._files.items():
            if texts[name] != text and (complete or texts[name] is not None):
                raise InputError(
                    f"{self.path / name}: already there, but of other cases than these; choose another folder"
                )
        if not any(texts.values()) and self.path.is_dir():
            ours = {CLAIMS, *(f"{name}.partial" for name in texts)}
            if others := sorted(entry.name for entry in self.path.iterdir() if entry.name not in ours):
                raise InputError(f"{self.path}: holds other files, such as {others[0]}; choose another folder")
        if complete and not join and self.finished():
            raise InputError(f"{self.path}: already holds results of these cases; continue by --resume")
        return [name for name in reversed(list(texts)) if texts[name] is None]

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Excludes the other processes that use the folder, for changes of files that all share."""
        self._lock(fcntl.LOCK_EX, self._count)
        try:
            yield
        finally:
            self._lock(fcntl.LOCK_UN, self._count)

    def finished(self) -> set[int]:
        """Numbers of the cases that have a result."""
        groups = (self.path / "cases").iterdir() if (self.path / "cases").is_dir() else ()
        names = (entry.name for group in groups if group.is_dir() for entry in os.scandir(group))
        numbers = (name.removesuffix(".json") for name in names if name.endswith(".json"))
        return {int(number) for number in numbers if number.isdecimal() and int(number) < self._count}

    def claim(self, number: int) -> bool:
        """Claims a case for this process; False if another process has it, or it has a result."""
        if self.result_path(number).exists() or not self._lock(fcntl.LOCK_EX | fcntl.LOCK_NB, number):
            return False
        if self.result_path(number).exists():  # stored between the two lines above
            self._lock(fcntl.LOCK_UN, number)
            return False
        return True

    def forget_failure(self, number: int) -> bool:
        """Removes the result of a case that failed, so that it can be computed again; returns whether it did."""
        if not self._lock(fcntl.LOCK_EX | fcntl.LOCK_NB, number):
            return False
        failed = self.result_path(number).exists() and bool(self.read(number).failed)
        if failed:
            self.result_path(number).unlink()
        self._lock(fcntl.LOCK_UN, number)
        return failed

    def store(self, number: int, result: CaseResult) -> None:
        """Stores the result of a claimed case, after the files to keep, and gives up the claim.

        Raises:
            OSError: A file cannot be written; the case has no result then.
        """
        for name, text in result.files.items():
            write_whole(self.kept(number) / checked_name(name), text)
        write_whole(self.result_path(number), json.dumps({"plan": self._digest, **result.content()}))
        self._lock(fcntl.LOCK_UN, number)

    def read(self, number: int) -> CaseResult:
        """Reads the result of a finished case.

        Raises:
            InputError: The file is not a result.
            OSError: It cannot be read.
        """
        path = self.result_path(number)
        with path.open("rb") as file:
            content = file.read(LARGEST_RESULT + 1)
        try:
            if len(content) > LARGEST_RESULT:
                raise ValueError("it is too large")
            found = json.loads(content)
            if not isinstance(found, Mapping) or not isinstance(found.get("failed"), str) or "result" not in found:
                raise ValueError("it must hold failed and result")
        except (ValueError, RecursionError) as error:
            raise InputError(
                f"{path}: not the result of a case ({error!s:.100}); remove this file and continue with --resume"
            ) from None
        if found.get("plan") != self._digest:
            names = ", ".join(self._files)
            raise InputError(f"{path}: computed before {names} in {self.path} were changed; use a new folder")
        seconds = found.get("seconds")
        return CaseResult(found["result"], found["failed"], float(seconds) if isinstance(seconds, int | float) else 0.0)

    def results(
        self, progress: Callable[[int, int], None] = lambda done, total: None
    ) -> Iterator[tuple[int, CaseResult]]:
        """Yields numbers and results of the finished cases in ascending order."""
        numbers = sorted(self.finished())
        for done, number in enumerate(numbers, start=1):
            yield number, self.read(number)
            progress(done, len(numbers))

    def add_results(self, other: Self) -> None:
        """Copies the results that only another folder of the same plan has, with the kept files.

        Raises:
            InputError: A result is not valid.
            OSError: A file cannot be read or written.
        """
        for number in sorted(other.finished() - self.finished()):
            if self.claim(number):
                result = other.read(number)
                for file in filter(_is_regular, other.kept(number).rglob("*")):
                    write_whole(self.kept(number) / file.relative_to(other.kept(number)), file.read_bytes())
                self.store(number, result)

    def kept(self, number: int) -> Path:
        """Folder of the files that are kept of a case."""
        return self.path / "runs" / f"{number:08d}"

    def result_path(self, number: int) -> Path:
        """File of the result of a case."""
        return self.path / "cases" / f"{number // _IN_A_FOLDER:05d}" / f"{number:08d}.json"

    def _lock(self, operation: int, position: int) -> bool:
        """Locks or unlocks a byte of `claims`; False if another process has it."""
        try:
            fcntl.lockf(self._claims, operation, 1, position)
        except OSError as error:
            if error.errno in (errno.EACCES, errno.EAGAIN):
                return False
            if error.errno not in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP):  # a file system without locks
                raise
        return True


def checked_name(name: str) -> str:
    """The path of a file below its folder.

    Raises:
        InputError: It leads out of the folder.
    """
    path = PurePosixPath(name)
    if path.is_absolute() or not path.parts or ".." in path.parts or "\0" in name:
        raise InputError(f"{name!r:.60}: must be the name of a file below the folder of its case")
    return name


def _is_regular(path: Path) -> bool:
    """Whether a path is a file, and not a link to one."""
    return path.is_file() and not path.is_symlink()


def _text_of(path: Path) -> str | None:
    """Text of a file; None if it does not exist, and a text that is not in any plan if it is not UTF-8."""
    try:
        return path.read_text(encoding="utf-8")
    except (FileNotFoundError, NotADirectoryError):
        return None
    except UnicodeDecodeError:
        return "\0"
