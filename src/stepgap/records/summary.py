"""`summary.json` of a run folder, read strictly."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from stepgap.step import Array

SCHEMA = 1
"""Version of `summary.json` that is read."""

MEASURES = ("rmse", "mae", "bias", "steady_rmse", "transient_rmse")
"""Tracking errors in `summary.json`, each one number per state coordinate."""

LARGEST_FILE = 2**24
"""Largest `summary.json` that is read [bytes]."""

LONGEST_NAME = 100
"""Longest name of a residual model [characters]."""

LARGEST_NUMBER = 1e9
"""Largest number that is taken for a measurement [SI units]."""


@dataclass(frozen=True, eq=False)
class FinishedDeployment:
    """One entry of `iterations`.

    Attributes:
        iteration: Its number, from 0.
        residual: Name of the residual model that the controller used.
        steps: Steps executed.
        falls: Steps that ended without an apex.
        errors: For each of `MEASURES` the error of every state coordinate, NaN where unknown; shape (n,).
    """

    iteration: int
    residual: str
    steps: int
    falls: int
    errors: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Summary:
    """The content of `summary.json`; without arguments, that of a run of which no deployment is finished.

    Attributes:
        seed: Of all randomness.
        deployments: Those that are finished, rising.
        repeatability: Spread of the next state at equal state and command, NaN where unknown; shape (n,).
        measured: Whether the repeatability was measured by repeating steps, not estimated from steady ones.
        versions: Of the software, as far as recorded.
        steps_sha256: Digest of the steps that the deployments are made of; empty if not recorded.
    """

    seed: int | None = None
    deployments: tuple[FinishedDeployment, ...] = ()
    repeatability: Array | None = None
    measured: bool = False
    versions: tuple[tuple[str, str], ...] = ()
    steps_sha256: str = ""


def parse_summary(text: str, names: tuple[str, ...], source: str = "summary.json") -> Summary:
    """The content of `summary.json`.

    Args:
        text: The file's text.
        names: State coordinates of the run.
        source: What to call the text in messages, usually its file name.

    Raises:
        ValueError: Naming the source, the key, and what would be right.
    """
    try:
        content = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{source}: not JSON ({error}); it must be the file that the run wrote") from None
    fields = _fields(content, "it", source)
    if (schema := fields.get("schema")) != SCHEMA or isinstance(schema, bool):
        raise ValueError(f"{source}: schema is {_short(schema)}, but it must be {SCHEMA}, the one this StepGap knows")
    entries = fields.get("iterations")
    if not isinstance(entries, list) or not entries:
        raise ValueError(f"{source}: iterations is {_short(entries)}, but it must be a list of deployments")
    deployments = [_deployment(entry, names, f"iterations[{row}]", source) for row, entry in enumerate(entries)]
    numbers = [deployment.iteration for deployment in deployments]
    if numbers != sorted(set(numbers)):
        raise ValueError(f"{source}: iterations are numbered {_short(numbers)}, but their numbers must rise")
    versions = _fields(fields.get("versions", {}), "versions", source)
    return Summary(
        _whole(fields, "seed", 0, source),
        tuple(deployments),
        _errors(fields, "repeatability", names, source),
        fields.get("repeatability_measured") is True,
        tuple((name, str(version)) for name, version in versions.items()),
        str(fields.get("steps_sha256", "")),
    )


def read_summary(path: Path, names: tuple[str, ...]) -> Summary:
    """Reads `summary.json`; an empty `Summary` if there is none yet.

    Raises:
        ValueError: The file is not a summary of a run with these state coordinates.
        OSError: It cannot be read.
    """
    text = read_text(path, LARGEST_FILE)
    return Summary() if text is None else parse_summary(text, names, str(path))


def read_text(path: Path, largest: int) -> str | None:
    """Text of a regular file; None if there is nothing of that name.

    Raises:
        ValueError: It is larger than `largest` bytes, or no text.
        OSError: It cannot be read.
    """
    if not path.exists():
        return None
    if not path.is_file():
        raise ValueError(f"{path}: not a file; it must be a text file that the run wrote")
    if path.stat().st_size > largest:
        raise ValueError(
            f"{path}: larger than {largest} bytes, so it is not read; it must be the one that the run wrote"
        )
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not a text file ({error.reason}); it must be the one that the run wrote") from None


def _deployment(entry: Any, names: tuple[str, ...], place: str, source: str) -> FinishedDeployment:
    fields, place = _fields(entry, place, source), f"{source}: {place}"
    residual = fields.get("residual")
    if not isinstance(residual, str) or len(residual) > LONGEST_NAME:
        raise ValueError(f"{place}: residual is {_short(residual)}, but it must be a short text such as 'gp'")
    return FinishedDeployment(
        iteration=_whole(fields, "iteration", 0, place),
        residual=residual,
        steps=_whole(fields, "steps", 1, place),
        falls=_whole(fields, "falls", 0, place),
        errors={measure: _errors(fields, measure, names, place) for measure in MEASURES},
    )


def _fields(value: Any, what: str, place: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{place}: {what} is {_short(value)}, but it must be an object, {{…}}")
    return value


def _whole(fields: Mapping[str, Any], key: str, least: int, place: str) -> int:
    value = fields.get(key)
    if type(value) is not int or not least <= value < 2**63:
        raise ValueError(f"{place}: {key} is {_short(value)}, but it must be an integer from {least}")
    return value


def _errors(fields: Mapping[str, Any], key: str, names: tuple[str, ...], place: str) -> Array:
    """One number or null for every state coordinate; shape (n,)."""
    values = _fields(fields.get(key), key, place)
    if set(values) != set(names):
        wanted = ", ".join(names)
        raise ValueError(f"{place}: {key} is of {_short(list(values))}, but it must be of {wanted}, as in steps.csv")
    for name, value in values.items():
        known = isinstance(value, (int, float)) and not isinstance(value, bool)
        if value is not None and not (known and abs(value) <= LARGEST_NUMBER):
            raise ValueError(f"{place}: {key} of {name} is {_short(value)}, but it must be a number or null")
    return np.array([np.nan if values[name] is None else float(values[name]) for name in names])


def _short(value: Any) -> str:
    """The value in one short line."""
    text = "missing" if value is None else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no JSON number")
