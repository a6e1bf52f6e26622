"""The file `times.json` of a run folder: how long fits and the choice of commands took, apart from the run's record.

Times differ from run to run, so they are in no other file: the same seed gives the same bytes of all the others.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from stepgap.base.errors import message_of
from stepgap.base.files import write_whole
from stepgap.base.json_data import as_object, integer, is_measurement, objects, parse_json
from stepgap.records.missing import Missing
from stepgap.records.summary import read_text

TIMES_FILE: Final = "times.json"  # Name of the file

TIMED_PARTS: Final = ("fit", "planning", "learning")
"""What is timed: the fit before a deployment, the choice of each command, and learning from each step afterwards."""

STATISTICS: Final = ("count", "total", "median", "p95", "largest")
"""Numbers of each part in the file: how many times were measured, and their statistics [s]."""

LARGEST_TIMES: Final = 2**24  # Largest `times.json` that is read [bytes]

Times = dict[int, dict[str, dict[str, float]]]
"""Statistics by the number of the deployment and by part."""


def statistics_of(seconds: Sequence[float]) -> dict[str, float]:
    """`STATISTICS` of some durations [s]."""
    middle, high = np.percentile(seconds, [50, 95])
    values = len(seconds), sum(seconds), middle, high, max(seconds)
    return dict(zip(STATISTICS, map(float, values), strict=True))


def write_times(folder: Path, times: Times) -> None:
    """Writes the times of the deployments of a run."""
    entries = [{"iteration": iteration, **parts} for iteration, parts in sorted(times.items())]
    write_whole(folder / TIMES_FILE, json.dumps({"schema": 1, "deployments": entries}, indent=1))


def read_times(folder: Path) -> Times | Missing:
    """Times of the deployments of a run; missing if its folder has none, or a damaged file."""
    path = folder / TIMES_FILE
    try:
        text = read_text(path, LARGEST_TIMES)
        if text is None:
            return Missing("the folder contains no times.json")
        entries = objects(as_object(parse_json(text), f"{path}: it"), "deployments", "deployments", f"{path}: ")
        return dict(_entry(entry, str(path)) for entry in entries)
    except (OSError, ValueError) as error:
        reason = message_of(error)
        return Missing(reason if reason.startswith(str(path)) else f"{path}: {reason}")


def _entry(fields: Mapping[str, Any], source: str) -> tuple[int, dict[str, dict[str, float]]]:
    parts = {part: as_object(fields[part], f"{source}: {part}") for part in TIMED_PARTS if part in fields}
    for part, numbers in parts.items():
        if set(numbers) != set(STATISTICS) or not all(map(is_measurement, numbers.values())):
            raise ValueError(f"{source}: {part} must have the numbers {', '.join(STATISTICS)}")
    statistics = {part: {name: float(numbers[name]) for name in STATISTICS} for part, numbers in parts.items()}
    return integer(fields, "iteration", 0, f"{source}: "), statistics
