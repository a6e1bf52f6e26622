"""The append-only record of every step executed: in memory, and as `steps.csv` a row at a time."""

import csv
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import TextIO

import numpy as np

from stepgap.step import Array, Reason, StepRecord, StepSpace

LARGEST_FILE = 256 * 2**20
"""Largest `steps.csv` that is read [bytes]."""


@dataclass(frozen=True, eq=False)
class LoggedStep:
    """One executed step with what was wanted and predicted of it; one row of `steps.csv`.

    Attributes:
        iteration: Deployment it belongs to, from 0.
        step: Its number within the deployment, from 1.
        target: State wanted at its end; shape (n,).
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
        "status",
    ]


def _to_row(logged: LoggedStep) -> list[str]:
    record = logged.record
    groups = (
        record.state,
        logged.target,
        record.command,
        record.applied,
        record.next_state,
        logged.predicted,
        logged.std,
    )
    numbers = [repr(float(number)) for group in groups for number in group]
    return [str(logged.iteration), str(logged.step), *numbers, record.reason.status]


def _from_row(row: list[str], space: StepSpace) -> LoggedStep:
    n, m = len(space.state), len(space.command)
    numbers = np.array([float(cell) for cell in row[2:-1]])
    state, target, command, applied, next_state, predicted, std = np.split(numbers, np.cumsum([n, n, m, m, n, n]))
    reason = Reason[row[-1].upper()]
    known = np.concatenate([state, target, command, applied, std])
    if not np.isfinite(known).all() or np.isfinite(next_state).all() != (reason == Reason.OK):
        raise ValueError("a number is not finite")
    return LoggedStep(
        int(row[0]), int(row[1]), target, predicted, std, StepRecord(state, command, applied, next_state, reason)
    )


class StepLog:
    """Steps in the order in which they were executed.

    Args:
        space: Names of their state and command.
        steps: What is known already.
    """

    def __init__(self, space: StepSpace, steps: Iterable[LoggedStep] = ()):
        self.space = space
        self._steps = list(steps)

    def __len__(self) -> int:
        return len(self._steps)

    def __iter__(self) -> Iterator[LoggedStep]:
        return iter(self._steps)

    def append(self, logged: LoggedStep) -> None:
        """Adds a step."""
        self._steps.append(logged)

    def of_iteration(self, iteration: int) -> "StepLog":
        """The steps of one deployment."""
        return StepLog(self.space, (logged for logged in self._steps if logged.iteration == iteration))

    def completed(self) -> "StepLog":
        """The steps that ended with an apex: those that can be learnt from."""
        return StepLog(self.space, (logged for logged in self._steps if logged.record.reason == Reason.OK))

    @property
    def iterations(self) -> list[int]:
        """Numbers of the deployments in it, rising."""
        return sorted({logged.iteration for logged in self._steps})

    @property
    def falls(self) -> int:
        """How many steps did not end with an apex."""
        return sum(logged.record.reason != Reason.OK for logged in self._steps)

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


def read_step_log(path: Path, space: StepSpace) -> StepLog:
    """Reads `steps.csv`; a last line cut off in the middle of writing is left out.

    Raises:
        ValueError: The file is not a step log of this space; the message names file and line.
    """
    if path.stat().st_size > LARGEST_FILE:
        raise ValueError(f"{path}: larger than {LARGEST_FILE} bytes, so it is not read")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not a text file ({error.reason})") from None
    whole = text[: text.rfind("\n") + 1]
    rows = list(csv.reader(StringIO(whole)))
    names = column_names(space)
    if not rows or rows[0] != names:
        raise ValueError(f"{path}, line 1: the columns must be {','.join(names)}")
    steps = []
    for number, row in enumerate(rows[1:], start=2):
        try:
            if len(row) != len(names):
                raise ValueError(f"{len(row)} columns instead of {len(names)}")
            steps.append(_from_row(row, space))
        except (ValueError, KeyError) as error:
            raise ValueError(f"{path}, line {number}: not a step ({error})") from None
    return StepLog(space, steps)


class StepWriter:
    """Writes steps to a file, each on disk before the next one starts.

    Args:
        path: The file; it is made with its header if there is none, cut after its last whole row if
            it was left in the middle of one.
        space: Names of state and command.
    """

    def __init__(self, path: Path, space: StepSpace):
        if path.exists():
            text = path.read_bytes()
            whole = text.rfind(b"\n") + 1
            if whole != len(text):
                os.truncate(path, whole)
        self._file: TextIO = path.open("a", encoding="utf-8", newline="")
        self._rows = csv.writer(self._file, lineterminator="\n")
        if self._file.tell() == 0:
            self._rows.writerow(column_names(space))
            self._sync()

    def append(self, logged: LoggedStep) -> None:
        """Writes one row and waits until the disk has it."""
        self._rows.writerow(_to_row(logged))
        self._sync()

    def _sync(self) -> None:
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Closes the file."""
        self._file.close()

    def __enter__(self) -> "StepWriter":
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()
