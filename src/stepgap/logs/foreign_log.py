"""Steps from any log whose columns are described by `Columns`."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stepgap.base.errors import InputError
from stepgap.learning.steps import Labels, Steps
from stepgap.logs.columns import ROLES, Columns, column_of, read_columns
from stepgap.logs.tables.log_table import LogTable
from stepgap.logs.tables.reading import chosen_table, read_log_tables
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array


class FoundSteps(NamedTuple):
    """Steps found in logs, all of which have a next state.

    Attributes:
        steps: The steps; those of other programs may lack targets and predictions, and have no context.
        phase: Phase at which each step started [rad], NaN where it is unknown; shape (N,).
        origin: Where each step was recorded, for messages; shape (N,).
        left_out: Number of excluded rows by reason, such as "with a number missing"; no zeros.
    """

    steps: Steps
    phase: Array
    origin: NDArray[np.str_]
    left_out: Mapping[str, int]


def read_foreign_logs(paths: Sequence[Path], columns: Columns) -> FoundSteps:
    """Reads the steps of logs that have the same columns, in any format; each file begins a new deployment.

    Rows in which a number is missing are left out, and so are the ends of chained rows.

    Raises:
        RecordError: A file cannot be read, or does not fit; the message names file, line and column.
    """
    parts = []
    deployments = []
    origins = list[str]()
    left_out = Counter[str]()
    deployment_count = 0
    for path in paths:
        roles = columns.numbers | ({columns.deployment: "deployment"} if columns.deployment else {})
        rows = chosen_table(path, read_log_tables(path, columns.format), list(roles), roles)
        part, deployment, missing = _steps_of(rows, columns)
        origins += map(rows.row, part.pop("row")[:, 0].tolist())
        parts.append(part)
        deployments.append(deployment + deployment_count)
        deployment_count += int(deployment.max(initial=-1)) + 1
        left_out.update(missing)
    table = {role: np.concatenate([part[role] for part in parts]) for role in parts[0]}
    command = table["command" if columns.command else "target"]
    if not len(command):
        raise RecordError(f"{paths[0]}: no row holds a complete step; rows left out: {describe_left_out(left_out)}")
    state = table["state"]
    next_state = table["next"]
    deployment = np.concatenate(deployments)
    if columns.step:  # where heights are measured above a ground that changes, the states of two steps differ
        starts = np.diff(table["step"][:, 0]) == 1
    else:
        starts = (state[1:] == next_state[:-1]).all(axis=1)
    starts &= deployment[1:] == deployment[:-1]
    steps = Steps.of_columns(
        columns.space(state, command),
        iteration=deployment,
        number=np.cumsum(np.append(1, np.where(starts, 1, 2))),  # a gap where a step does not follow the one before
        state=state,
        command=command,
        next_state=next_state,
        **{role: table[role] for role in ("target", "predicted") if role in table},
    )
    phase = table["yaw"][:, 0] if columns.yaw else np.full(len(steps), np.nan)
    return FoundSteps(
        steps, phase, np.array(origins, np.str_), {reason: count for reason, count in left_out.items() if count}
    )


def describe_left_out(left_out: Mapping[str, int]) -> str:
    """Formats the numbers of excluded rows and their reasons."""
    return ", ".join(f"{count} {reason}" for reason, count in left_out.items() if count) or "none"


def imported_steps(path: Path, columns: Path | None, names: Mapping[str, str | tuple[str, ...]]) -> Steps:
    """The steps of a log of any origin, for `stepgap new --from`.

    Its columns are those of a TOML file, and `names` by their roles, which override them.

    Raises:
        InputError: No column is the command, or the file of columns is not valid.
        RecordError: As of `read_foreign_logs`.
    """
    meaning = read_columns(columns, names)
    if meaning is None or not meaning.command:
        raise InputError("--command: no column; name the columns of the command")
    return step_log_of(read_foreign_logs([path], meaning))


def step_log_of(log_steps: FoundSteps) -> Steps:
    """The steps of other logs as those of a run, such as for a `steps.csv`.

    The yaw after a step is the one at which the next step of its deployment starts, so that of the last one is unknown.
    """
    follows = log_steps.steps.follows
    yaw_after = np.roll(np.where(follows, log_steps.phase, np.nan), -1)
    context = np.repeat(yaw_after[:, None], len(log_steps.steps.space.context), axis=1)
    return as_deployments(log_steps.steps).with_columns(context=context)


def as_deployments(steps: Steps) -> Steps:
    """Steps with gaps as those of a run, which has none: predictions are not known.

    A new deployment begins where a step does not follow the one before it: by its number or, without numbers, because
    it does not start from the state in which that one ended.
    """
    follows = steps.follows
    iteration = np.cumsum(~follows) - 1
    number = 1 + np.arange(len(steps)) - np.flatnonzero(~follows)[iteration]
    return steps.with_columns(iteration=iteration, number=number, predicted=np.nan, std=0.0)


def _steps_of(rows: LogTable, columns: Columns) -> tuple[dict[str, Array], Labels, dict[str, int]]:
    """Arrays of the complete steps by role, their deployments, and the numbers of rows that are left out.

    A yaw, the step's number, and the index of the row belong to the start of a step; a yaw may be missing.
    """
    numbers = {name: rows.numbers(name, columns.factors.get(name, 1.0)) for name in columns.numbers}
    table = {
        role: np.stack([numbers[column_of(entry)] for entry in getattr(columns, role)], axis=-1)
        for role in ROLES
        if getattr(columns, role)
    }
    deployment = _deployments(rows, columns.deployment)
    ends = 0
    begin: dict[str, Any] = {"row": np.arange(len(deployment))[:, None]}
    named = {"yaw": columns.yaw, "step": columns.step}
    begin |= {role: numbers[column][:, None] for role, column in named.items() if column}
    if not (columns.state and columns.next):
        follows = deployment[1:] == deployment[:-1]
        if columns.step:
            follows &= np.diff(numbers[columns.step]) == 1
        ends = len(deployment) - int(follows.sum())
        earlier = {role: values[:-1][follows] for role, values in table.items()}
        later = {role: values[1:][follows] for role, values in table.items()}
        table = earlier | {"next": later["state"]} if columns.state else later | {"state": earlier["next"]}
        deployment = deployment[1:][follows]
        begin = {role: values[:-1][follows] for role, values in begin.items()}
    complete = np.all([np.isfinite(values).all(axis=1) for values in table.values()], axis=0)
    left_out = {"with a number missing": int((~complete).sum()), "at the end of a chain": ends}
    return {role: values[complete] for role, values in (table | begin).items()}, deployment[complete], left_out


def _deployments(table: LogTable, column: str) -> Labels:
    """Number of the deployment of each row, in the order in which they occur; without a column all rows are of one."""
    if not column:
        return np.zeros(len(table), np.intp)
    labels = table.columns[column]
    if labels.dtype.kind == "f" and (inexact := np.abs(labels) >= 2**53).any():
        row = table.row(int(inexact.argmax()))
        raise RecordError(f"{row}, column {column!r}: too large for the number of a deployment")
    _, first, label = np.unique(labels, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[label].astype(np.intp)
