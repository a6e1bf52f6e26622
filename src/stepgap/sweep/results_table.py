"""The table `results.csv` of a sweep: one row per deployment of each case, in the order of the cases."""

import csv
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import StringIO, TextIOWrapper
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepgap.base.files import open_regular
from stepgap.records.step_columns import Column
from stepgap.records.summary import MEASURES, parse_deployment
from stepgap.step import StepSpace

RESULTS = "results.csv"  # Name of the table in the folder of a sweep
LARGEST_RESULTS = 2**31  # Largest table that is read [bytes]

_CASE = "case"
_SEED = "seed"
_AFTER_SEED = ("iteration", "residual", "steps", "falls")
_LAST = ("hops_to_band", "failed")

_AT_ONCE = 20_000
"""Number of rows that are converted at the same time, so that a large table needs little memory."""


def columns_of(settings: Sequence[str], space: StepSpace) -> list[str]:
    """Columns of the table of a sweep with these settings on its axes, of which `seed` is the last."""
    errors = [f"{measure}_{name}" for measure in MEASURES for name in space.state_names]
    return [_CASE, *settings, *_AFTER_SEED, *errors, *_LAST]


def rows_of_results(
    number: int, settings: Mapping[str, Any], result: Any, failed: str, space: StepSpace
) -> list[list[str]]:
    """Rows of one case as cells; a case that failed has one row with the reason.

    Args:
        settings: Values of the settings on the axes.
        result: Entries of the deployments.
        failed: Reason why there are none; empty if there are.

    Raises:
        ValueError: The result is not that of an experiment.
    """
    before = [str(number), *map(_cell, settings.values())]
    if failed:
        return [[*before, *[""] * (len(_AFTER_SEED) + len(MEASURES) * len(space.state) + 1), failed]]
    if not isinstance(result, list) or not result:
        raise ValueError(f"case {number}: its result must be a list of deployments")
    rows = []
    for entry in result:
        deployment = parse_deployment(entry, space.state_names, "deployment", f"case {number}")
        hops = entry.get("hops_to_band")
        if hops is not None and (type(hops) is not int or hops < 1):
            raise ValueError(f"case {number}: hops_to_band must be a positive integer or null")
        errors = np.concatenate([deployment.errors[measure] for measure in MEASURES]).tolist()
        values = [deployment.iteration, deployment.residual, deployment.steps, deployment.failed_steps]
        rows.append([*before, *map(_cell, [*values, *errors, hops, ""])])
    return rows


def table_text(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Content of `results.csv`."""
    stream = StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return stream.getvalue()


def _cell(value: Any) -> str:
    """Text of a value, from which it can be read back without loss; empty for a number that is not known."""
    if value is None or (isinstance(value, float) and np.isnan(value)):
        return ""
    return str(value).lower() if isinstance(value, bool) else str(value)


@dataclass(frozen=True, eq=False)
class ResultsTable:
    """The content of a `results.csv`: its N rows as columns.

    Attributes:
        settings: Names of the settings on the axes, with `seed` as the last one.
        columns: Settings, `residual` and `failed` as texts, all others as numbers, NaN where unknown; shape (N,).
    """

    settings: tuple[str, ...]
    columns: Mapping[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.columns[_CASE])

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the state coordinates."""
        prefix = f"{MEASURES[0]}_"
        return tuple(name.removeprefix(prefix) for name in self.columns if name.startswith(prefix))

    def as_columns(self) -> list[Column]:
        """All columns for data frames; a setting whose values are numbers becomes numbers."""
        return [Column(name, "", "", as_numbers(values)) for name, values in self.columns.items()]


def as_numbers(values: NDArray[Any]) -> NDArray[Any]:
    """Texts as integers or numbers if all of them are, otherwise as they are."""
    for kind in (np.int64, np.float64):
        with suppress(ValueError, OverflowError):
            return values.astype(kind) if values.dtype.kind == "O" else values
    return values


def read_results(path: Path) -> ResultsTable:
    """Reads `results.csv`.

    Raises:
        ValueError: The file is not such a table; the message names file and line.
        OSError: It cannot be read.
    """
    try:
        with TextIOWrapper(open_regular(path), encoding="utf-8", newline="") as file:
            if os.fstat(file.fileno()).st_size > LARGEST_RESULTS:
                raise ValueError(f"{path}: larger than {LARGEST_RESULTS} bytes, so it is not read")
            reader = csv.reader(file)
            header = next(reader, [])
            settings = _settings_of(header, path)
            texts = {*settings, "residual", "failed"}
            parts = []
            line = 2
            while rows := list(islice(reader, _AT_ONCE)):
                columns = _by_column(rows, header, line, path)
                parts.append([_column(cells, name, name in texts) for name, cells in columns])
                line += len(rows)
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not a table in UTF-8 ({error})") from None
    except ValueError as error:
        raise ValueError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
    if not parts:
        raise ValueError(f"{path}: no row below the header; no case is finished yet")
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return ResultsTable(settings, dict(zip(header, columns, strict=True)))


def _settings_of(header: Sequence[str], path: Path) -> tuple[str, ...]:
    """Settings on the axes; ValueError unless these are the columns of a table of results."""
    ends = header[:1] == [_CASE] and tuple(header[-len(_LAST) :]) == _LAST
    if not ends or not {_SEED, *_AFTER_SEED} <= set(header) or len(set(header)) < len(header):
        raise ValueError(f"{path}, line 1: not the header of a sweep's results; it must be case, …, seed, iteration, …")
    return tuple(header[1 : header.index(_AFTER_SEED[0])])


def _by_column(
    rows: Sequence[Sequence[str]], header: Sequence[str], line: int, path: Path
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Names and cells of the columns of some rows, of which the first is at this line."""
    for number, row in enumerate(rows, start=line):
        if len(row) != len(header):
            raise ValueError(f"{path}, line {number}: {len(row)} columns instead of {len(header)}")
    yield from zip(header, zip(*rows, strict=True), strict=True)


def _column(cells: Sequence[str], name: str, text: bool) -> NDArray[Any]:
    if text:
        shared: dict[str, str] = {}
        return np.array([shared.setdefault(cell, cell) for cell in cells], dtype=object)  # few texts, many rows
    try:
        return np.array([float(cell) if cell else np.nan for cell in cells])
    except ValueError:
        raise ValueError(f"column {name} must contain numbers") from None
