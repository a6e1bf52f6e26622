"""The append-only record of every step executed: in memory, and as `steps.csv` a row at a time."""

import errno
import fcntl
import hashlib
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stepgap.base.errors import InputError
from stepgap.base.files import naming
from stepgap.step import Array, StepRecord, StepSpace, StepStatus

LARGEST_FILE = 256 * 2**20
"""Largest `steps.csv` that is read [bytes]."""


class RecordError(InputError):
    """A step log cannot be used; the message is one line that names the file and what is wrong with it."""


@dataclass(frozen=True, eq=False)
class LoggedStep:
    """One executed step with what was wanted and predicted of it; one row of `steps.csv`.

    Attributes:
        iteration: Deployment it belongs to, from 0.
        step: Its number within the deployment, from 1; calibrating steps come before, up to number 0.
        target: State wanted at its end; of a calibrating step the one predicted; shape (n,).
        predicted: State that the controller's map predicted for the command asked; NaN where it knew no
            command that makes a step; shape (n,).
        std: Standard deviation of that prediction, zero for a map without one; shape (n,).
        record: What happened.
    """

    iteration: int
    step: int
    target: Array
    predicted: Array
    std: Array
    record: StepRecord


def column_names(space: StepSpace) -> list[str]:
    """Columns of `steps.csv`."""
    state, command = space.state_names, space.command_names
    return [
        "iteration",
        "step",
        *state,
        *(f"target_{name}" for name in state),
        *command,
        *(f"applied_{name}" for name in command),
        *(f"{kind}_{name}" for kind in ("next", "predicted", "std") for name in state),
        "yaw_after",
        "status",
    ]


def values_of(logged: LoggedStep, space: StepSpace) -> dict[str, int | float | str]:
    """What a row of `steps.csv` holds, by column."""
    return dict(zip(column_names(space), _values(logged), strict=True))


def row_of(logged: LoggedStep) -> str:
    """The line of `steps.csv`, without its end; every number is written so that it is read back to the last bit."""
    return ",".join(map(str, _values(logged)))


def _values(logged: LoggedStep) -> list[int | float | str]:
    record = logged.record
    before = (record.state, logged.target, record.command, record.applied)
    after = (record.next_state, logged.predicted, logged.std)
    numbers = np.concatenate(before + after).tolist()
    return [logged.iteration, logged.step, *numbers, float(record.yaw_after), record.status.label]


def _step_of(row: str, space: StepSpace) -> LoggedStep:
    """The step that a line holds; ValueError if it holds none."""
    names, cells = column_names(space), row.split(",")
    if len(cells) != len(names):
        raise ValueError(f"{len(cells)} columns instead of {len(names)}")
    if cells[-1].upper() not in StepStatus.__members__:
        raise ValueError(f"unknown status {cells[-1]!r:.40}")
    n, m = len(space.state), len(space.command)
    numbers = np.array([float(cell) for cell in cells[2:-1]])
    parts = np.split(numbers, np.cumsum([n, n, m, m, n, n, n]))
    state, target, command, applied, next_state, predicted, std, (yaw,) = parts
    status = StepStatus[cells[-1].upper()]
    known = [state, target, command, applied, std]
    if status == StepStatus.OK:
        known.append(next_state)
    if not np.isfinite(np.concatenate(known)).all():
        raise ValueError("a number is not finite")
    record = StepRecord(state, command, applied, next_state, status, float(yaw))
    return LoggedStep(int(cells[0]), int(cells[1]), target, predicted, std, record)


def _check_order(last: LoggedStep | None, logged: LoggedStep) -> None:
    """Raises ValueError unless a step can follow the one before it."""
    here = (logged.iteration, logged.step)
    first = (0, min(1, logged.step))
    following = [first] if last is None else [(last.iteration, last.step + 1), (last.iteration + 1, 1)]
    if last is not None and last.record.status != StepStatus.OK:
        del following[0]
    if here not in following:
        wanted = " or ".join(f"step {step} of deployment {iteration}" for iteration, step in following)
        raise ValueError(f"step {here[1]} of deployment {here[0]} where {wanted} must be")


class StepLog:
    """Steps in the order in which they were executed; immutable, `log + steps` is a longer one.

    Args:
        space: Names of their state and command.
        steps: Those in it.
    """

    def __init__(self, space: StepSpace, steps: Iterable[LoggedStep] = ()):
        self.space = space
        self._steps = tuple(steps)

    def __len__(self) -> int:
        return len(self._steps)

    def __iter__(self) -> Iterator[LoggedStep]:
        return iter(self._steps)

    def __add__(self, steps: Iterable[LoggedStep]) -> "StepLog":
        """These steps, then others."""
        return StepLog(self.space, (*self._steps, *steps))

    @property
    def last(self) -> LoggedStep | None:
        """The latest step; None if there is none."""
        return self._steps[-1] if self._steps else None

    def of_iteration(self, iteration: int) -> "StepLog":
        """The steps of one deployment."""
        return StepLog(self.space, (logged for logged in self._steps if logged.iteration == iteration))

    def tracking(self) -> "StepLog":
        """The steps that tracked the reference; calibrating ones, up to number 0, had targets of their own."""
        return StepLog(self.space, (logged for logged in self._steps if logged.step > 0))

    def completed(self) -> "StepLog":
        """The steps that ended with an apex: those that can be learnt from."""
        return StepLog(self.space, (logged for logged in self._steps if logged.record.status == StepStatus.OK))

    @property
    def iterations(self) -> list[int]:
        """Numbers of the deployments in it, rising."""
        return sorted({logged.iteration for logged in self._steps})

    @property
    def falls(self) -> int:
        """How many steps did not end with an apex."""
        return sum(logged.record.status != StepStatus.OK for logged in self._steps)

    @property
    def yaw(self) -> Array:
        """Yaw at the start of each step [rad], NaN where it is not known; shape (N,)."""
        before = np.roll([logged.record.yaw_after for logged in self._steps], 1)
        return np.where(self.follows, before, np.nan)

    @property
    def follows(self) -> NDArray[np.bool_]:
        """Whether each step came right after the one before it here; shape (N,)."""
        numbers = self.deployment, np.array([logged.step for logged in self._steps], int)
        same, next_one = (np.diff(number, prepend=number[:1]) for number in numbers)
        return (same == 0) & (next_one == 1)

    @property
    def deployment(self) -> NDArray[np.intp]:
        """Number of the deployment that each step belongs to; shape (N,)."""
        return np.array([logged.iteration for logged in self._steps], np.intp)

    @property
    def state(self) -> Array:
        """States at the start of each step; shape (N, n)."""
        return self._column([logged.record.state for logged in self._steps], len(self.space.state))

    @property
    def applied(self) -> Array:
        """Commands applied; shape (N, m)."""
        return self._column([logged.record.applied for logged in self._steps], len(self.space.command))

    @property
    def next_state(self) -> Array:
        """States at the end of each step, NaN after a fall; shape (N, n)."""
        return self._column([logged.record.next_state for logged in self._steps], len(self.space.state))

    @property
    def target(self) -> Array:
        """Targets; shape (N, n)."""
        return self._column([logged.target for logged in self._steps], len(self.space.state))

    @property
    def predicted(self) -> Array:
        """Predictions of the controller's map; shape (N, n)."""
        return self._column([logged.predicted for logged in self._steps], len(self.space.state))

    @property
    def std(self) -> Array:
        """Standard deviations of the predictions; shape (N, n)."""
        return self._column([logged.std for logged in self._steps], len(self.space.state))

    @staticmethod
    def _column(rows: list[Array], width: int) -> Array:
        return np.array(rows, float).reshape(len(rows), width)


def joined(logs: Sequence[StepLog]) -> StepLog:
    """The steps of one or more logs, one after the other, their deployments numbered through."""
    whole = StepLog(logs[0].space)
    for log in logs:
        first = max(whole.iterations, default=-1) + 1
        whole += [replace(logged, iteration=logged.iteration + first) for logged in log]
    return whole


def check_not_older(header: Sequence[str], path: Path) -> None:
    """Raises RecordError if a header names a column as only earlier versions of StepGap did."""
    if "place_after" in header:
        raise RecordError(
            f"{path}, line 1: recorded by an older version of StepGap, in which the column yaw_after was called "
            "place_after; run its experiment.toml again, or read the steps alone after renaming the column"
        )


def text_of(log: StepLog) -> str:
    """The content of the `steps.csv` that holds these steps."""
    lines = [",".join(column_names(log.space)), *map(row_of, log)]
    return "".join(f"{line}\n" for line in lines)


def digest(log: StepLog) -> str:
    """SHA-256 of the `steps.csv` that holds these steps."""
    return hashlib.sha256(text_of(log).encode()).hexdigest()


def read_step_log(path: Path, space: StepSpace) -> StepLog:
    """Reads `steps.csv`; a last line cut off in the middle of writing is left out.

    Raises:
        RecordError: The file is not a step log of this space; the message names file and line.
        OSError: The file cannot be read.
    """
    with path.open("rb") as file:
        content = file.read(LARGEST_FILE + 1)
    return _parse(content, path, space)


def recover_steps(path: Path, space: StepSpace) -> tuple[StepLog, str]:
    """The steps of a broken `steps.csv` up to the first that is not whole, and what is wrong there; empty: nothing.

    Raises:
        RecordError: It is not a step log of this space at all.
        OSError: The file cannot be read.
    """
    with path.open("rb") as file:
        content = file.read(LARGEST_FILE + 1)
    steps: list[LoggedStep] = []
    readable = _readable(content)
    try:
        for logged in _steps_in(content[:readable], path, space):
            steps.append(logged)
    except RecordError as error:
        if not steps:
            raise
        return StepLog(space, steps), str(error)
    if readable < len(content):
        return StepLog(space, steps), f"{path}: no text from byte {readable} on"
    cut = content[content.rfind(b"\n") + 1 :]
    return StepLog(space, steps), f"{path}: the last line breaks off after {len(cut)} bytes" if cut else ""


def _readable(content: bytes) -> int:
    """Number of bytes that are text."""
    try:
        content.decode()
    except UnicodeDecodeError as error:
        return error.start
    return len(content)


def _parse(content: bytes, path: Path, space: StepSpace) -> StepLog:
    return StepLog(space, _steps_in(content, path, space))


def _steps_in(content: bytes, path: Path, space: StepSpace) -> Iterator[LoggedStep]:
    """The steps of the whole lines, up to the first that holds none, which raises RecordError."""
    if len(content) > LARGEST_FILE:
        raise RecordError(f"{path}: larger than {LARGEST_FILE} bytes, so it is not read")
    header = ",".join(column_names(space))
    if header.encode().startswith(content):
        return  # broken off before the first line was whole
    try:
        lines = content[: content.rfind(b"\n") + 1].decode().replace("\r\n", "\n").split("\n")[:-1]
    except UnicodeDecodeError as error:
        raise RecordError(f"{path}: not a text file in UTF-8 ({error.reason})") from None
    if lines[:1] != [header]:
        check_not_older(lines[0].split(",") if lines else [], path)
        raise RecordError(f"{path}, line 1: the columns must be {header}")
    last = None
    for number, line in enumerate(lines[1:], start=2):
        try:
            logged = _step_of(line, space)
            _check_order(last, logged)
        except ValueError as error:
            raise RecordError(f"{path}, line {number}: not the next step ({error!s:.200})") from None
        yield logged
        last = logged


class StepWriter:
    """Writes steps to a file, each on disk before the next one starts; one writer at a time has the file.

    Args:
        path: The file; made if there is none. Nothing in it is changed before the first step is added.
        space: Names of state and command.

    Attributes:
        recorded: Steps that were in the file.

    Raises:
        RecordError: Another process has the file, or it is not a step log of this space.
        OSError: The file cannot be read or written.
    """

    def __init__(self, path: Path, space: StepSpace):
        self._header = ",".join(column_names(space))
        self._path, self._file = path, path.open("a+b")
        try:
            self._lock(path)
            self._file.seek(0)
            content = self._file.read(LARGEST_FILE + 1)
            self.recorded = _parse(content, path, space)
        except BaseException:
            self._file.close()
            raise
        self._whole = content.rfind(b"\n") + 1

    def _lock(self, path: Path) -> None:
        """Takes the file for this process; the kernel frees it whatever happens to the process."""
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RecordError(f"{path}: another process is writing this run; wait for it, or stop it") from None
        except OSError as error:
            if error.errno not in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP):  # a file system without locks
                raise

    def append(self, logged: LoggedStep) -> None:
        """Writes one row, after the last whole one, and waits until the disk has it.

        Raises:
            OSError: The row cannot be written; the rows before it stay as they are.
        """
        text = row_of(logged) if self._whole else f"{self._header}\n{row_of(logged)}"
        row = f"{text}\n".encode()
        with naming(self._path):
            self._file.truncate(self._whole)
            self._file.write(row)
            self._file.flush()
            os.fsync(self._file.fileno())
        self._whole += len(row)

    def close(self) -> None:
        """Closes the file."""
        with naming(self._path):
            self._file.close()

    def __enter__(self) -> "StepWriter":
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()
