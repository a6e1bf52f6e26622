"""The folder of a plan, with the results of the finished cases.

The files hold the whole state, so that any process may end at any time: a result is a file that is renamed when it is
complete. A case that two processes compute at the same time has the same result twice.
"""

import fcntl
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path, PurePosixPath

from stepgap.base.errors import InputError
from stepgap.base.files import open_own, read_bounded, write_whole
from stepgap.sweep.cases.plan import CaseResult, Plan

LARGEST_PLAN_FILE = 2**28  # Largest file of a plan that is read [bytes]
LARGEST_RESULT = 2**26  # Largest result of a case that is read [bytes]
LOCK = "lock"  # Empty file that a process locks while it writes files that all share
_IN_A_FOLDER = 1000  # Number of results in one folder, since file systems become slow with many more


class CaseFolder:
    """The cases of a plan in a folder, which several processes may use at the same time.

    Args:
        path: The folder; it is created if it does not exist.
        plan: The plan, whose files are written into a new folder.
        join: Whether the folder may hold results of this plan already.

    Raises:
        InputError: The folder holds the cases of another plan, or other files.
        OSError: A file cannot be read or written.
    """

    def __init__(self, path: Path, plan: Plan, join: bool):
        self.path = path
        self._count = len(plan)
        self._files = dict(plan.files)
        self._digest = sha256(json.dumps(self._files).encode()).hexdigest()
        self._missing(join)  # before anything is written
        path.mkdir(parents=True, exist_ok=True)
        with self.alone():
            for name in self._missing(join):
                write_whole(path / name, self._files[name])

    def _missing(self, join: bool) -> list[str]:
        """Files of the plan that are not in the folder yet."""
        texts = {name: _text_of(self.path / name) for name in self._files}
        for name, text in self._files.items():
            if texts[name] not in (None, text):
                file = self.path / name
                raise InputError(f"{file}: already there, but of other cases than these; choose another folder")
        if not any(texts.values()) and self.path.is_dir():
            ours = {LOCK, *(f"{name}.partial" for name in texts)}
            if others := sorted(entry.name for entry in self.path.iterdir() if entry.name not in ours):
                raise InputError(f"{self.path}: holds other files, such as {others[0]}; choose another folder")
        if not join and self.finished():
            raise InputError(f"{self.path}: already holds results of these cases; continue by --resume")
        return [name for name, text in texts.items() if text is None]

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Excludes the other processes that use the folder, for changes of files that all share."""
        with open_own(self.path / LOCK) as file:  # closing it unlocks, so a killed process leaves no lock behind
            with suppress(OSError):  # a file system without locks
                fcntl.flock(file, fcntl.LOCK_EX)
            yield

    def finished(self) -> set[int]:
        """Numbers of the cases that have a result."""
        groups = (self.path / "cases").iterdir() if (self.path / "cases").is_dir() else ()
        names = (entry.name for group in groups if group.is_dir() for entry in os.scandir(group))
        numbers = (name.removesuffix(".json") for name in names if name.endswith(".json"))
        return {int(number) for number in numbers if number.isdecimal() and int(number) < self._count}

    def store(self, number: int, result: CaseResult) -> None:
        """Stores the result of a case, after the files to keep.

        Raises:
            OSError: A file cannot be written; the case has no result then.
        """
        for name, text in result.files.items():
            write_whole(self.kept(number) / checked_name(name), text)
        content = {"failed": result.failed, "seconds": round(result.seconds, 3), "result": result.result}
        write_whole(self.result_path(number), json.dumps({"plan": self._digest, **content}))

    def read(self, number: int) -> CaseResult:
        """Reads the result of a finished case.

        Raises:
            InputError: The file is not a result.
            OSError: It cannot be read.
        """
        path = self.result_path(number)
        try:
            content = json.loads(read_bounded(path, LARGEST_RESULT))
            failed = content.get("failed") if isinstance(content, Mapping) else None
            if not isinstance(failed, str) or "result" not in content:
                raise ValueError("it must hold failed and result")
        except (ValueError, RecursionError) as error:
            raise InputError(
                f"{path}: not the result of a case ({error!s:.100}); remove this file and continue with --resume"
            ) from None
        if content.get("plan") != self._digest:
            names = ", ".join(self._files)
            raise InputError(f"{path}: computed before {names} in {self.path} were changed; use a new folder")
        return CaseResult(content["result"], content["failed"])

    def results(self) -> Iterator[tuple[int, CaseResult]]:
        """Yields numbers and results of the finished cases in ascending order."""
        for number in sorted(self.finished()):
            yield number, self.read(number)

    def kept(self, number: int) -> Path:
        """Folder of the files that are kept of a case."""
        return self.path / "runs" / f"{number:08d}"

    def result_path(self, number: int) -> Path:
        """File of the result of a case."""
        return self.path / "cases" / f"{number // _IN_A_FOLDER:05d}" / f"{number:08d}.json"


def checked_name(name: str) -> str:
    """The path of a file below its folder.

    Raises:
        InputError: It leads out of the folder.
    """
    path = PurePosixPath(name)
    if path.is_absolute() or not path.parts or ".." in path.parts or "\0" in name:
        raise InputError(f"{name!r:.60}: must be the name of a file below the folder of its case")
    return name


def _text_of(path: Path) -> str | None:
    """Text of a file; None if it does not exist, and a text that is not in any plan if it is not UTF-8."""
    try:
        return read_bounded(path, LARGEST_PLAN_FILE).decode()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except UnicodeDecodeError:
        return "\0"
