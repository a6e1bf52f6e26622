"""Steps from any CSV file whose columns are described by `Columns`."""

import csv
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np

from stepgap.learning.step_log import LoggedStep, StepLog
from stepgap.learning.step_table import Labels, StepTable, describe_left_out
from stepgap.records.columns import LARGEST_VALUE, ROLES, Columns, column_of, unknown_column
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array, StepRecord, StepStatus

LARGEST_LOG = 64 * 2**20
"""Largest log that is read [bytes]."""

MISSING = {"", "na", "n/a", "nan", "null", "none", "inf", "-inf"}
"""Contents of a cell, in lower case, that mean a missing number."""


def read_foreign_logs(paths: Sequence[Path], columns: Columns) -> StepTable:
    """Reads the steps of CSV files that have the same columns; each file begins a new deployment.

    Rows in which a number is missing are left out, and so are the ends of chained rows.

    Raises:
        RecordError: A file cannot be read, or does not fit; the message names file, line and column.
    """
    parts, deployments, left_out, found = [], [], Counter[str](), 0
    for path in paths:
        part, deployment, missing = _steps_of(_read(path, columns), columns)
        parts.append(part)
        deployments.append(deployment + found)
        found += int(deployment.max(initial=-1)) + 1
        left_out.update(missing)
    table = {role: np.concatenate([part[role] for part in parts]) for role in parts[0]}
    command = table["command" if columns.command else "target"]
    if not len(command):
        raise RecordError(f"{paths[0]}: no row holds a complete step ({describe_left_out(left_out)})")
    return StepTable(
        space=columns.space(table["state"], command),
        state=table["state"],
        command=command,
        next_state=table["next"],
        target=table.get("target"),
        predicted=table.get("predicted"),
        deployment=np.concatenate(deployments),
        left_out={reason: count for reason, count in left_out.items() if count},
        yaw=table["yaw"][:, 0] if columns.yaw else None,
    )


def step_log_of(table: StepTable) -> StepLog:
    """The steps of a table as a log, such as for a `steps.csv`; what the table does not contain is unknown.

    A new deployment begins where a step does not start from the state in which the one before it ended. A target that
    is not known is the next state; predictions are not known.
    """
    logged: list[LoggedStep] = []
    nowhere, exact = np.full(len(table.space.state), np.nan), np.zeros(len(table.space.state))
    for row, (state, command, next_state) in enumerate(zip(table.state, table.command, table.next_state, strict=True)):
        last = logged[-1] if logged else None
        iteration, step = (last.iteration, last.step + 1) if last else (0, 1)
        if last and not (
            table.deployment[row] == table.deployment[row - 1] and np.array_equal(last.record.next_state, state)
        ):
            iteration, step = iteration + 1, 1
        target = next_state if table.target is None else table.target[row]
        record = StepRecord(state, command, command, next_state, StepStatus.OK)
        logged.append(LoggedStep(iteration, step, target, nowhere, exact, record))
    return StepLog(table.space, logged)


def _steps_of(rows: "_Rows", columns: Columns) -> tuple[dict[str, Array], Labels, dict[str, int]]:
    """Arrays of the complete steps by role, their deployments, and the numbers of rows that are left out.

    A yaw belongs to the start of a step, and may be missing.
    """
    table = {
        role: np.stack([rows.numbers[column_of(entry)] for entry in getattr(columns, role)], axis=-1)
        for role in ROLES
        if getattr(columns, role)
    }
    deployment, ends = rows.deployment, 0
    yaw = {"yaw": rows.numbers[columns.yaw][:, None]} if columns.yaw else {}
    if not (columns.state and columns.next):
        follows = deployment[1:] == deployment[:-1]
        if columns.step:
            follows &= np.diff(rows.numbers[columns.step]) == 1
        ends = len(deployment) - int(follows.sum())
        earlier = {role: values[:-1][follows] for role, values in table.items()}
        later = {role: values[1:][follows] for role, values in table.items()}
        table = earlier | {"next": later["state"]} if columns.state else later | {"state": earlier["next"]}
        deployment = deployment[1:][follows]
        yaw = {role: values[:-1][follows] for role, values in yaw.items()}
    complete = np.all([np.isfinite(values).all(axis=1) for values in table.values()], axis=0)
    left_out = {"with a number missing": int((~complete).sum()), "at the end of a chain": ends}
    return {role: values[complete] for role, values in (table | yaw).items()}, deployment[complete], left_out


@dataclass(frozen=True, eq=False)
class _Rows:
    """The needed columns of a file's R rows.

    Attributes:
        numbers: Columns of numbers by name, NaN where one is missing; each of shape (R,).
        deployment: Number of the deployment of each row; shape (R,).
    """

    numbers: Mapping[str, Array]
    deployment: Labels


def _read(path: Path, columns: Columns) -> _Rows:
    """Reads the needed columns of a file."""
    lines = _cells(path)
    _, header = next(lines, (1, []))
    if not header:
        raise RecordError(f"{path}: empty; it must have a line of column names and rows below it")
    indices = {column: _index(header, column, role, path) for column, role in columns.numbers.items()}
    deployment = _index(header, columns.deployment, "deployment", path) if columns.deployment else None
    labels: dict[str, int] = {}
    numbers: list[list[float]] = []
    deployments: list[int] = []
    for line, cells in lines:
        if len(cells) != len(header):
            raise RecordError(f"{path}, line {line}: {len(cells)} values; it must have {len(header)}, as the header")
        numbers.append([_number(cells[at], f"{path}, line {line}, column {name!r}") for name, at in indices.items()])
        deployments.append(labels.setdefault(cells[deployment] if deployment is not None else "", len(labels)))
    table = np.array(numbers, float).reshape(len(numbers), len(indices))
    scaled = {name: table[:, i] * columns.factors.get(name, 1.0) for i, name in enumerate(indices)}
    return _Rows(scaled, np.array(deployments, np.intp))


def _cells(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yields the rows that are not empty, with line numbers; the separator is the commonest one in the first line."""
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_LOG + 1)
        if len(content) > LARGEST_LOG:
            raise RecordError(f"{path}: larger than {LARGEST_LOG} bytes, so it is not read")
        text = content.decode("utf-8-sig")
    except OSError as error:
        raise RecordError(f"{path}: {error.strerror}; give an existing CSV file, or the folder of a run") from None
    except UnicodeDecodeError:
        raise RecordError(f"{path}: not a text file; a log is a CSV file in UTF-8") from None
    first = text.partition("\n")[0]
    rows = csv.reader(StringIO(text, newline=""), delimiter=max(",;\t", key=first.count), strict=True)
    try:
        for row in rows:
            if len(row) > 1 or any(cell.strip() for cell in row):
                yield rows.line_num, [cell.strip() for cell in row]
    except csv.Error as error:
        raise RecordError(f"{path}, line {rows.line_num}: {error}; it must be a CSV file") from None


def _index(header: Sequence[str], column: str, role: str, path: Path) -> int:
    """Index of a column in the header."""
    if header.count(column) != 1:
        found = "more than one such column" if column in header else unknown_column(column, header)
        raise RecordError(f"{path}, line 1: {role} {column!r}: {found}")
    return list(header).index(column)


def _number(cell: str, source: str) -> float:
    """The number in a cell, NaN if it is missing."""
    if cell.lower() in MISSING:
        return np.nan
    try:
        value = float(cell)
    except ValueError:
        value = np.inf
    if not abs(value) <= LARGEST_VALUE:
        right = f"a number within ±{LARGEST_VALUE:g}, such as 0.5, or empty"
        raise RecordError(f"{source}: {cell!r:.40}; it must be {right}")
    return value
