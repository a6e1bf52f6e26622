"""The step log `steps.csv`: one row per executed step of a run, on disk before the next step starts."""

import errno
import fcntl
import hashlib
import os
from codecs import BOM_UTF8
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.files import naming, open_own, open_regular, read_bounded
from stepgap.base.names import is_name
from stepgap.learning.steps import AFTER, LoggedStep, Steps, column_names
from stepgap.step import ContextQuantity, Quantity, StepRecord, StepSpace, StepStatus

LARGEST_STEPS_FILE = 256 * 2**20  # Largest `steps.csv` that is read [bytes]

LONGEST_HEADER = 2**18
"""Longest first line of `steps.csv` [bytes]; that of 100 coordinates with names of 60 letters has 40 kB."""

MOST_COORDINATES = 100  # Largest number of state coordinates; each has its own figure


class RecordError(InputError):
    """A step log cannot be used; the message is one line that names the file and its fault."""


_FORMER = "place_after"  # Name of a column of the context in the first versions
RECOVERY = "; `stepgap recover` saves what comes before it"  # End of the message about a damaged row


def check_names(space: StepSpace) -> None:
    """Ensures that a `steps.csv` with the names of a space can be read.

    Raises:
        RecordError: There are too many state coordinates, or a name is that of another column.
    """
    if len(space.state) > MOST_COORDINATES:
        raise RecordError(f"the state has {len(space.state)} coordinates, but it must have at most {MOST_COORDINATES}")
    columns = [*column_names(space), _FORMER]
    for name in (*space.names, *(f"{quantity}{AFTER}" for quantity in space.context_names)):
        if columns.count(name) > 1:
            raise RecordError(
                f"the name {name!r:.80} of a coordinate is that of another column of steps.csv; the names of state and "
                "command must differ from each other, from iteration, step and status, and from the other "
                "names after target_, requested_, applied_, next_, true_next_, predicted_ or std_, or before _after"
            )


def values_of(logged: LoggedStep, space: StepSpace) -> dict[str, int | float | str]:
    """The entries of a row of `steps.csv`, by column."""
    return dict(zip(column_names(space), _values(logged, space.context_names), strict=True))


def row_of(logged: LoggedStep, space: StepSpace) -> str:
    """The line of `steps.csv` without its end; every number can be read back without loss."""
    return ",".join(map(str, _values(logged, space.context_names)))


def _values(logged: LoggedStep, names: Sequence[str]) -> list[int | float | str]:
    record = logged.record
    before = (record.state, logged.target, record.command, record.requested, record.applied)
    after = (record.next_state, record.true_next_state, logged.predicted, logged.std)
    numbers = np.concatenate(before + after).tolist()
    context = (float(record.context.get(name, np.nan)) for name in names)
    return [logged.iteration, logged.step, *numbers, *context, record.status.label]


def _step_of(row: str, space: StepSpace) -> LoggedStep:
    """The step in a line; ValueError if the line does not hold a step."""
    names = column_names(space)
    cells = row.split(",")
    if len(cells) != len(names):
        raise ValueError(f"{len(cells)} columns instead of {len(names)}")
    if cells[-1].upper() not in StepStatus.__members__:
        raise ValueError(f"unknown status {cells[-1]!r:.40}")
    n = len(space.state)
    m = len(space.command)
    numbers = np.array([float(cell) for cell in cells[2:-1]])
    parts = np.split(numbers, np.cumsum([n, n, m, m, m, n, n, n, n]))
    state, target, command, requested, applied, next_state, true_next_state, predicted, std, context = parts
    status = StepStatus[cells[-1].upper()]
    named = space.named_context(context.tolist())
    record = StepRecord(state, command, applied, next_state, status, named, requested, true_next_state)
    logged = LoggedStep(int(cells[0]), int(cells[1]), target, predicted, std, record)
    _check_numbers(logged, space)
    return logged


def _check_numbers(logged: LoggedStep, space: StepSpace) -> None:
    """Raises ValueError, which names their source, unless all arrays have their shape and the known numbers are finite.

    Of a failed step, the next state and the applied command may be unknown.
    """
    record = logged.record
    n = len(space.state)
    m = len(space.command)
    completed = record.status == StepStatus.OK
    numbers = (
        ("state of the plant", record.state, n, True),
        ("target of the reference", np.where(np.isnan(logged.target), 0.0, logged.target), n, True),
        ("command of the plant", record.command, m, True),
        ("requested command of the plant", record.requested, m, True),
        ("applied command of the plant", record.applied, m, completed),
        ("next state of the plant", record.next_state, n, completed),
        ("true next state of the plant", record.true_next_state, n, False),
        ("predicted state of nominal map and residual", logged.predicted, n, False),
        ("standard deviation of nominal map and residual", logged.std, n, True),
    )
    for name, values, size, required in numbers:
        if np.shape(values) != (size,):
            raise ValueError(f"the {name} has shape {np.shape(values)} instead of {(size,)}")
        if required and not np.isfinite(values).all():
            raise ValueError(f"the {name} is not finite: {', '.join(map(str, np.asarray(values).tolist()))}")


def _check_order(last: LoggedStep | None, logged: LoggedStep) -> None:
    """Raises ValueError unless a step can follow the previous one.

    Between two runs, which a warm start may have, the number of a deployment is left out.
    """
    here = (logged.iteration, logged.step)
    first = (0, min(1, logged.step))
    begin = int(logged.step != 0)  # 0 is the step with which a plant starts
    following = [first]
    if last is not None:
        if here == (last.iteration + 2, min(1, logged.step)):
            return
        following = [(last.iteration, last.step + 1), (last.iteration + 1, begin)]
    if last is not None and last.record.status != StepStatus.OK:
        del following[0]
    if here not in following:
        places = " or ".join(f"step {step} of deployment {iteration}" for iteration, step in following)
        raise ValueError(f"step {here[1]} of deployment {here[0]} where {places} must be")


def space_of_header(path: Path) -> StepSpace:
    """Step space with the names of state, command and context in the header of `steps.csv`.

    The file contains no units, so they are empty, no bounds, so they are −1 and 1, and no periods.

    Raises:
        ValueError: The first line is not a header of a step log.
        OSError: The file cannot be read.
    """
    with open_regular(path) as file:
        header = file.readline(LONGEST_HEADER).decode("utf-8-sig", "replace").rstrip("\r\n").split(",")
    if header == [""]:
        raise ValueError(f"{path}: no step yet; it must have a header and at least one row below it")
    check_not_older(header, path)
    state = _names_before("target_", header[2:])
    command = _names_before("requested_", header[2 + 2 * len(state) :])
    context = [name.removesuffix(AFTER) for name in header[2 + 6 * len(state) + 3 * len(command) : -1]]
    if 1 <= len(state) <= MOST_COORDINATES and all(map(is_name, (*state, *command, *context))):
        named = tuple(ContextQuantity(name, "") for name in context)
        space = StepSpace(tuple(map(_coordinate, state)), tuple(map(_coordinate, command)), named)
        if column_names(space) == header and len(set(header)) == len(header):
            return space
    raise ValueError(
        f"{path}, line 1: not the header of a step log; it must be iteration, step, the state's names (at most "
        f"{MOST_COORDINATES}), target_…, the command's names, requested_…, applied_…, next_…, true_next_…, "
        "predicted_…, std_…, the context's names with _after, status, and names consist of letters, digits and "
        "underscores"
    )


def _names_before(kind: str, columns: Sequence[str]) -> Sequence[str]:
    """The names at the start of `columns`, which end before the first one is repeated after `kind`; else none."""
    repeated = f"{kind}{columns[0]}" if columns else ""
    return columns[: columns.index(repeated)] if repeated in columns else []


def _coordinate(name: str) -> Quantity:
    return Quantity(name, "", -1.0, 1.0)


def check_not_older(header: Sequence[str], path: Path) -> None:
    """Raises RecordError if a header has a column name of an earlier version of StepGap."""
    if _FORMER in header:
        raise RecordError(
            f"{path}, line 1: recorded by an older version of StepGap, in which the column yaw_after was called "
            f"{_FORMER}; run its experiment.toml again, or read the steps alone after renaming the column"
        )
    kinds = {name.partition("_")[0] for name in header}
    if "applied" in kinds and "requested" not in kinds:
        raise RecordError(
            f"{path}, line 1: recorded by an older version of StepGap, without the columns requested_… and "
            "true_next_…; run its experiment.toml again, or read it as the log of another program with the options of "
            "`stepgap fit` that name its columns"
        )


def text_of(log: Steps) -> str:
    """Content of the `steps.csv` with these steps."""
    lines = [",".join(column_names(log.space)), *(row_of(logged, log.space) for logged in log)]
    return "".join(f"{line}\n" for line in lines)


def digest(log: Steps) -> str:
    """SHA-256 of the `steps.csv` with these steps."""
    return hashlib.sha256(text_of(log).encode()).hexdigest()


def read_step_log(path: Path, space: StepSpace) -> Steps:
    """Reads `steps.csv`; a last line that was not completely written is left out.

    The space of the steps is the given one with the context that the file has: an older file may have less or more.

    Raises:
        RecordError: The file is not a step log of this space; the message names file and line.
        OSError: The file cannot be read.
    """
    return _read_steps(_read_content(path), path, space)


def ends_with_whole_row(path: Path) -> bool:
    """Whether the last row of a file was written completely.

    Raises:
        OSError: The file cannot be read.
    """
    with open_regular(path) as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - 1))
        return file.read() == b"\n"


def recover_steps(path: Path, space: StepSpace) -> tuple[Steps, str]:
    """Reads a damaged `steps.csv` up to the first row that is not intact.

    Returns:
        The steps, and a message about the fault; empty if there is none.

    Raises:
        RecordError: The file is not a step log of this space at all.
        OSError: The file cannot be read.
    """
    content = _read_content(path)
    readable = _readable(content)
    lines = _lines_in(content[:readable], path)
    of_file = _space_in(lines, path, space)
    steps = list[LoggedStep]()
    try:
        for logged in _steps_in(lines, path, of_file):
            steps.append(logged)
    except RecordError as error:
        if not steps:
            raise
        return Steps(of_file, steps), str(error).removesuffix(RECOVERY)
    if readable < len(content):
        return Steps(of_file, steps), f"{path}: not text from byte {readable} on"
    cut = content[content.rfind(b"\n") + 1 :]
    return Steps(of_file, steps), f"{path}: the last line is cut off after {len(cut)} bytes" if cut else ""


def _read_content(path: Path) -> bytes:
    try:
        return read_bounded(path, LARGEST_STEPS_FILE)
    except InputError as error:
        raise RecordError(str(error)) from None


def _readable(content: bytes) -> int:
    """Number of bytes at the start that are text."""
    try:
        content.decode()
    except UnicodeDecodeError as error:
        return error.start
    return len(content)


def _read_steps(content: bytes, path: Path, space: StepSpace) -> Steps:
    lines = _lines_in(content, path)
    space = _space_in(lines, path, space)
    return Steps(space, _steps_in(lines, path, space))


def _lines_in(content: bytes, path: Path) -> list[str]:
    """The complete lines of a file, then an empty one; without a complete line, the beginning of the first one.

    Spreadsheets write a byte-order mark, which is left out.
    """
    content = content.removeprefix(BOM_UTF8)
    try:
        return content[: content.rfind(b"\n") + 1 or None].decode().replace("\r\n", "\n").split("\n")
    except UnicodeDecodeError as error:
        raise RecordError(f"{path}: not a text file in UTF-8 ({error.reason})") from None


def _space_in(lines: Sequence[str], path: Path, space: StepSpace) -> StepSpace:
    """A space with the context that the header of a file has; raises RecordError if the other columns are not right."""
    columns = lines[0].split(",")
    expected = column_names(space)
    if len(lines) == 1 and ",".join(expected).startswith(lines[0]):
        return space  # cut off before the first line was complete
    check_not_older(columns, path)
    fixed = len(expected) - 1 - len(space.context)
    names = [name.removesuffix(AFTER) for name in columns[fixed:-1]]
    of_file = with_context(space, names if all(map(is_name, names)) else ())
    if columns != column_names(of_file) or len(set(columns)) < len(columns):
        raise RecordError(f"{path}, line 1: the columns must be {','.join(expected)}")
    return of_file


def with_context(space: StepSpace, names: Sequence[str]) -> StepSpace:
    """A space with the context that was recorded, whose `names` may be more or fewer than those that it declares.

    What would be measured above a context that was not recorded was measured from zero.
    """
    declared = {quantity.name: quantity for quantity in space.context}
    context = tuple(declared.get(name) or ContextQuantity(name, "") for name in names)
    state = tuple(each if each.above in ("", *names) else replace(each, above="") for each in space.state)
    return replace(space, state=state, context=context)


def _steps_in(lines: Sequence[str], path: Path, space: StepSpace) -> Iterator[LoggedStep]:
    """Yields the steps in the lines after the header; raises RecordError at the first line that holds none."""
    last = None
    for number, line in enumerate(lines[1:-1], start=2):
        try:
            logged = _step_of(line, space)
            _check_order(last, logged)
        except ValueError as error:
            raise RecordError(f"{path}, line {number}: not the next step ({error!s:.200}){RECOVERY}") from None
        yield logged
        last = logged


class StepWriter:
    """Writes steps to a file, each on disk before the next one starts; only one writer at a time can open the file.

    Args:
        path: The file; created if there is none. It is not changed before the first step is added or removed.
        space: Names of state, command and context.

    Attributes:
        recorded: Steps that were already in the file.
        space: The space of the file, as `read_step_log` finds it.

    Raises:
        RecordError: Another process is writing the file, it is not a step log of this space, or `check_names` refuses
            the space.
        OSError: The file cannot be read or written.
    """

    def __init__(self, path: Path, space: StepSpace):
        check_names(space)
        self._declared = space.context_names
        self._path = path
        self._file = open_own(path)
        try:
            self._lock(path)
            content = _read_content(path)
            self.recorded = _read_steps(content, path, space)
        except BaseException:
            self._file.close()
            raise
        self.space = self.recorded.space
        self._whole = content.rfind(b"\n") + 1

    def _lock(self, path: Path) -> None:
        """Locks the file for this process; the kernel releases the lock when the process ends for any reason."""
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RecordError(f"{path}: another process is writing this run; wait for it, or stop it") from None
        except OSError as error:
            if error.errno not in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP):  # a file system without locks
                raise

    def cut(self, rows: int) -> None:
        """Removes all rows but the first ones of those that were recorded.

        Raises:
            OSError: The file cannot be changed.
        """
        if rows == len(self.recorded):
            return
        with naming(self._path):
            self._file.seek(0)
            self._whole = sum(len(self._file.readline()) for _ in range(1 + rows))
            self._file.truncate(self._whole)

    def append(self, logged: LoggedStep) -> None:
        """Writes one row after the last complete one, and waits until it is on disk.

        Raises:
            RecordError: A plant, map or residual gave what no row can hold; the message names it.
            OSError: The row cannot be written; the rows before it stay as they are.
        """
        unknown = set(logged.record.context) - {*self._declared, *self.space.context_names}
        try:
            if unknown:
                raise ValueError(
                    f"the robot does not declare the context {min(unknown)} of the plant, in StepSpace.context"
                )
            _check_numbers(logged, self.space)
        except ValueError as error:
            place = f"step {logged.step} of deployment {logged.iteration}"
            raise RecordError(f"{self._path}: {place} cannot be recorded: {error!s:.200}") from None
        header = "" if self._whole else ",".join(column_names(self.space)) + "\n"
        row = f"{header}{row_of(logged, self.space)}\n".encode()
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
