"""The file `summary.json` of a run folder: tracking errors of each deployment, written whole and read strictly."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from stepgap.base.errors import InputError, StepGapError
from stepgap.base.files import read_bounded_text, write_whole
from stepgap.base.json_data import as_object, check_value, describe_value, integer, is_measurement, objects, parse_json
from stepgap.learning.alarm import ALARM_SOURCES, Alarm
from stepgap.step import Array

SUMMARY_SCHEMA = 1  # Version of `summary.json`

MEASURES = ("rmse", "mae", "bias", "steady_rmse", "transient_rmse", "true_rmse")
"""Tracking errors in `summary.json`, each with one number per state coordinate."""

MEASURED = tuple(measure for measure in MEASURES if measure != "true_rmse")
"""Those that are known of any robot, also of hardware."""

LARGEST_SUMMARY = 2**24  # Largest `summary.json` that is read [bytes]
LONGEST_RESIDUAL_NAME = 100  # Longest name of a residual model [characters]


class OtherSchema(StepGapError, ValueError):
    """A summary of another version; the message is one line that names the file."""


@dataclass(frozen=True, eq=False, repr=False)
class Deployment:
    """Tracking errors of one deployment, next state − target, over the steps that ended at their section.

    An error is NaN where there are no such steps, or no targets.

    Attributes:
        iteration: Number of the deployment, from 0.
        residual: Name of the residual model that the controller used.
        steps: Number of executed steps, including those before step 1, which do not count in the errors.
        failed_steps: Number of steps that ended without a next state; at most one, because it aborts the deployment.
            Key `falls`, also the column of tables.
        rmse: Root-mean-square error; shape (n,).
        mae: Mean absolute error; shape (n,).
        bias: Mean error; shape (n,).
        steady_rmse: RMSE over `Reference.steady`; shape (n,).
        transient_rmse: RMSE over `Reference.transient`; shape (n,).
        true_rmse: RMSE of the true next state, NaN where it is not known, as on hardware; shape (n,).
        cut: Number of commands that limits cut.
        unreachable: Targets that no command holds according to the map with which it began, NaN in coordinates
            without a target; shape (k, n).
        missed: Other targets whose steady error exceeds three noise floors; shape (k, n).
        alarms: When which hypothesis about the robot was trusted from then on.
    """

    iteration: int
    residual: str
    steps: int
    failed_steps: int
    rmse: Array
    mae: Array
    bias: Array
    steady_rmse: Array
    transient_rmse: Array
    true_rmse: Array
    cut: int
    unreachable: Array
    missed: Array
    alarms: tuple[Alarm, ...] = ()

    def __repr__(self) -> str:
        rmse = ", ".join(f"{error:.3g}" for error in self.rmse)
        end = ", the last one failed" if self.failed_steps else ""
        return f"<Deployment {self.iteration} with residual '{self.residual}': {self.steps} steps{end}, RMSE {rmse}>"

    @property
    def errors(self) -> Mapping[str, Array]:
        """Errors of the state coordinates (n,), by the name of the measure."""
        return {measure: getattr(self, measure) for measure in MEASURES}


class NoiseFloor(NamedTuple):
    """Standard deviation of the next state when a step is repeated; NaN where it is not known.

    Attributes:
        any_phase: If the phase of the periodic context differs from repetition to repetition; shape (n,). Key
            `repeatability`.
        same_phase: If only the noise differs; shape (n,). Key `repeatability_same_yaw`.
        any_phase_freedom: Degrees of freedom of `any_phase`, NaN where they are not known; shape (n,) or a number. Key
            `repeatability_freedom`.
        same_phase_freedom: Degrees of freedom of `same_phase`. Key `repeatability_same_yaw_freedom`.
        steps: Number of steps from which both were computed; 0 if it is not known. Key `repeatability_steps`.
    """

    any_phase: Array
    same_phase: Array
    any_phase_freedom: Array | float = np.nan
    same_phase_freedom: Array | float = np.nan
    steps: int = 0

    @classmethod
    def unknown(cls, size: int) -> Self:
        """A noise floor that is not known, for n coordinates."""
        return cls(np.full(size, np.nan), np.full(size, np.nan))


@dataclass(frozen=True)
class WarmStart:
    """The steps that were known before a run.

    Attributes:
        steps: Number of these steps.
        steps_sha256: Digest of these steps.
    """

    steps: int
    steps_sha256: str


@dataclass(frozen=True, eq=False)
class Summary:
    """The content of `summary.json`; without arguments, that of a run without a finished deployment.

    Attributes:
        seed: Random seed of the run.
        deployments: Finished deployments in ascending order.
        noise_floor: Standard deviation of repeated steps.
        noise_floor_measured: Whether the noise floor was measured by repeating steps, not estimated from steady steps.
        versions: Versions of the software, as far as recorded.
        steps_sha256: Digest of the steps of the deployments; empty if not recorded.
        warm_start: The steps known before the run; None if there were none.
    """

    seed: int | None = None
    deployments: tuple[Deployment, ...] = ()
    noise_floor: NoiseFloor | None = None
    noise_floor_measured: bool = False
    versions: tuple[tuple[str, str], ...] = ()
    steps_sha256: str = ""
    warm_start: WarmStart | None = None


def write_summary(path: Path, summary: Summary, names: Sequence[str]) -> None:
    """Writes `summary.json`; NaN becomes null.

    Args:
        path: The file.
        summary: Content of the file, with at least one deployment and the noise floor.
        names: State coordinates of the run.
    """
    floor = summary.noise_floor or NoiseFloor.unknown(len(names))
    content = {
        "schema": SUMMARY_SCHEMA,
        "seed": summary.seed,
        "iterations": [deployment_entry(deployment, names) for deployment in summary.deployments],
        "repeatability": _by_name(names, floor.any_phase),
        "repeatability_same_yaw": _by_name(names, floor.same_phase),
        "repeatability_freedom": _by_name(names, np.broadcast_to(floor.any_phase_freedom, len(names))),
        "repeatability_same_yaw_freedom": _by_name(names, np.broadcast_to(floor.same_phase_freedom, len(names))),
        "repeatability_steps": floor.steps,
        "repeatability_measured": summary.noise_floor_measured,
        "steps_sha256": summary.steps_sha256,
        **({"warm_start": asdict(summary.warm_start)} if summary.warm_start else {}),
        "versions": dict(summary.versions),
    }
    write_whole(path, json.dumps(content, indent=1))


def deployment_entry(deployment: Deployment, names: Sequence[str]) -> dict[str, Any]:
    """Entry of a deployment in `summary.json`; `names` are the state coordinates. NaN becomes null."""
    return {
        "iteration": deployment.iteration,
        "residual": deployment.residual,
        "steps": deployment.steps,
        "falls": deployment.failed_steps,
        **{measure: _by_name(names, error) for measure, error in deployment.errors.items()},
        "cut": deployment.cut,
        "unreachable": _with_null(deployment.unreachable),
        "missed": _with_null(deployment.missed),
        "alarms": [alarm._asdict() for alarm in deployment.alarms],
    }


def _is_number_or_null(value: Any) -> bool:
    return value is None or is_measurement(value)


def _with_null(targets: Array) -> list[list[float | None]]:
    return [[value if value == value else None for value in target] for target in targets.tolist()]


def _by_name(names: Sequence[str], values: Array) -> dict[str, float | None]:
    return {name: float(value) if np.isfinite(value) else None for name, value in zip(names, values, strict=True)}


def parse_summary(text: str, names: tuple[str, ...], source: str = "summary.json") -> Summary:
    """Parses the content of `summary.json`.

    Args:
        text: The file's text.
        names: State coordinates of the run.
        source: Name of the text in messages, usually its file name.

    Raises:
        OtherSchema: It was written by another version.
        ValueError: The content is wrong; the message names source, key and rule.
    """
    try:
        content = parse_json(text)
    except ValueError as error:
        raise ValueError(f"{source}: not JSON ({error}); it must be the file that the run wrote") from None
    fields = as_object(content, f"{source}: it")
    if (schema := fields.get("schema")) != SUMMARY_SCHEMA or isinstance(schema, bool):
        raise OtherSchema(
            f"{source}: schema is {describe_value(schema)}, but it must be {SUMMARY_SCHEMA}, which this version reads"
        )
    entries = objects(fields, "iterations", "deployments", f"{source}: ")
    check_value(entries, f"{source}: iterations", entries, "be a list of deployments")
    deployments = [parse_deployment(entry, names, f"iterations[{row}]", source) for row, entry in enumerate(entries)]
    numbers = [deployment.iteration for deployment in deployments]
    check_value(numbers == sorted(set(numbers)), f"{source}: the number of iterations", numbers, "increase")
    versions = as_object(fields.get("versions", {}), f"{source}: versions")
    return Summary(
        integer(fields, "seed", 0, f"{source}: "),
        tuple(deployments),
        _noise_floor(fields, names, source),
        fields.get("repeatability_measured") is True,
        tuple((name, str(version)) for name, version in versions.items()),
        str(fields.get("steps_sha256", "")),
        _warm_start(fields.get("warm_start"), source),
    )


def read_summary(path: Path, names: tuple[str, ...]) -> Summary:
    """Reads `summary.json`; an empty `Summary` if there is none yet.

    Raises:
        ValueError: The file is not a summary of a run with these state coordinates.
        OSError: It cannot be read.
    """
    text = read_text(path, LARGEST_SUMMARY)
    return Summary() if text is None else parse_summary(text, names, str(path))


def read_text(path: Path, largest: int) -> str | None:
    """Text of a regular file; None if it does not exist.

    Raises:
        ValueError: It is larger than `largest` bytes, or not text.
        OSError: It cannot be read.
    """
    if not path.exists():
        return None
    if not path.is_file():
        raise ValueError(f"{path}: not a file; it must be a text file that the run wrote")
    try:
        return read_bounded_text(path, largest)
    except InputError as error:
        raise InputError(f"{error}; it must be the file that the run wrote") from None
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not a text file ({error.reason}); it must be the file that the run wrote") from None


def parse_deployment(entry: Any, names: tuple[str, ...], key: str, source: str) -> Deployment:
    """The deployment of an entry as `deployment_entry` makes it.

    Raises:
        ValueError: It is not such an entry; the message names source, key and rule.
    """
    source = f"{source}: {key}"
    fields = as_object(entry, source)
    older = {"alarms": [], **fields}  # summaries of former versions have none
    residual = fields.get("residual")
    short = isinstance(residual, str) and len(residual) <= LONGEST_RESIDUAL_NAME
    check_value(short, f"{source}: residual", residual, "be a short string such as 'gp'")
    return Deployment(
        iteration=integer(fields, "iteration", 0, f"{source}: "),
        residual=str(residual),
        steps=integer(fields, "steps", 1, f"{source}: "),
        failed_steps=integer(fields, "falls", 0, f"{source}: "),
        **{measure: _errors(fields, measure, names, source) for measure in MEASURES},
        cut=integer(fields, "cut", 0, f"{source}: "),
        unreachable=_targets(fields, "unreachable", names, source),
        missed=_targets(fields, "missed", names, source),
        alarms=tuple(
            _alarm(alarm, f"{source}: alarms: ") for alarm in objects(older, "alarms", "alarms", f"{source}: ")
        ),
    )


def _alarm(fields: Mapping[str, Any], where: str) -> Alarm:
    source = fields.get("source")
    check_value(source in ALARM_SOURCES, f"{where}source", source, f"be one of {', '.join(ALARM_SOURCES)}")
    return Alarm(integer(fields, "step", -(2**31), where), str(source))


def _warm_start(entry: Any, source: str) -> WarmStart | None:
    if entry is None:
        return None
    fields = as_object(entry, f"{source}: warm_start")
    return WarmStart(integer(fields, "steps", 1, f"{source}: warm_start: "), str(fields.get("steps_sha256", "")))


def _errors(fields: Mapping[str, Any], key: str, names: tuple[str, ...], source: str) -> Array:
    """Errors of the state coordinates, each a number or null; shape (n,)."""
    values = as_object(fields.get(key), f"{source}: {key}")
    check_value(set(values) == set(names), f"{source}: {key}", values, f"have {', '.join(names)}, as in steps.csv")
    for name, value in values.items():
        check_value(_is_number_or_null(value), f"{source}: {key} of {name}", value, "be a number or null")
    return np.array([np.nan if values[name] is None else float(values[name]) for name in names])


def _noise_floor(fields: Mapping[str, Any], names: tuple[str, ...], source: str) -> NoiseFloor:
    """The noise floor; summaries of former versions have neither degrees of freedom nor the number of steps."""
    whole = {"repeatability_freedom": dict.fromkeys(names), "repeatability_same_yaw_freedom": dict.fromkeys(names)}
    whole |= {"repeatability_steps": 0, **fields}
    return NoiseFloor(
        any_phase=_errors(whole, "repeatability", names, source),
        same_phase=_errors(whole, "repeatability_same_yaw", names, source),
        any_phase_freedom=_errors(whole, "repeatability_freedom", names, source),
        same_phase_freedom=_errors(whole, "repeatability_same_yaw_freedom", names, source),
        steps=integer(whole, "repeatability_steps", 0, f"{source}: "),
    )


def _targets(fields: Mapping[str, Any], key: str, names: tuple[str, ...], source: str) -> Array:
    """A list of targets, each a list with a number, or null for none, for each state coordinate; shape (k, n)."""
    values = fields.get(key)
    rows = values if isinstance(values, list) else [None]
    valid = all(isinstance(row, list) and len(row) == len(names) and all(map(_is_number_or_null, row)) for row in rows)
    check_value(valid, f"{source}: {key}", values, f"be a list of targets [{', '.join(names)}]")
    return np.array(rows, float).reshape(-1, len(names))
