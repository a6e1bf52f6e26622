"""Steps from a log of ticks: sections, states, plans, and the reasons for which steps are left out."""

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from stepgap.base.errors import StepGapWarning
from stepgap.logs.sections.held_commands import (
    CELLS,
    MOST_CELLS,
    HeldCommands,
    command_lag,
    held_commands,
    held_in_steps,
    regular_sections,
)
from stepgap.logs.sections.plans import Plans, StepValues, joined_doubts, read_plans, step_values
from stepgap.logs.sections.section_finding import FoundSection, SectionFunction, find_sections
from stepgap.logs.sections.section_settings import (
    BOOM_COLUMNS,
    COORDINATES,
    POSE_COLUMNS,
    SectionSettings,
    SignalCoordinate,
)
from stepgap.logs.sections.section_states import SectionStates, section_states
from stepgap.logs.sections.signals import Signal, SignalLog, TimedTable, read_deployments, read_signal_log
from stepgap.logs.sections.step_means import LONGEST_GAP_IN_MEAN, step_means
from stepgap.logs.sections.tops import hop_faults
from stepgap.logs.tables.log_table import LogTable, unknown_column
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array

MOST_REGULAR: Final = 1_000_000  # Largest number of steps at equal intervals

LONGEST_GAP: Final = 0.2
"""A step is left out if a signal has no samples for this part of a typical step: a section could be hidden."""

EARLIEST: Final = -0.15
"""Nothing is extracted either if the motion is before the commands by more than this part of a step."""

MOST_DOUBTFUL: Final = 0.25  # Nothing is extracted from a log if a larger part of its sections is doubtful


_POSITION = ("position.x", "position.y")
_ORIENTATION = tuple(f"orientation.{axis}" for axis in "xyzw")

_NORM = (0.9, 1.1)  # Norms of a quaternion that is one; a sensor that has none often gives zeros


@final
@dataclass(frozen=True, eq=False)
class ExtractedSteps:
    """The steps of a log between its K sections.

    Attributes:
        source: The log.
        names: Names of state, command, target and predicted coordinates, by role.
        sections: Times and states of the K sections.
        values: Commands, targets and predictions of the K − 1 steps by role; shape (K − 1, number of coordinates).
        yaw: Yaw at the beginning of each step [rad], NaN where it is unknown; None if the settings name none.
        faults: Why a step is left out; empty texts for steps that are not.
        signals: The signals by column, first the one in which the sections are seen, such as the height.
        lag: Time by which the motion follows its commands [s], for steps of equal length; NaN if it is not known.
        deployment: The deployment in the log; empty if it is not divided.
        clock: The column of the time, where the log has several clocks; otherwise empty.
    """

    source: str
    names: dict[str, tuple[str, ...]]
    sections: SectionStates
    values: dict[str, Array]
    yaw: Array | None
    faults: tuple[str, ...]
    signals: Mapping[str, Signal]
    lag: float = np.nan
    deployment: str = ""
    clock: str = ""

    @property
    def kept(self) -> list[int]:
        """Numbers of the steps that are not left out, counted from 0."""
        return [number for number, fault in enumerate(self.faults) if not fault]

    @property
    def refusal(self) -> str:
        """Why the log is refused as a whole; empty if it is not."""
        if self.lag < EARLIEST * float(np.median(np.diff(self.sections.time))):
            return (
                f"{self.source}: the motion comes {-self.lag:.2g} s before the command that it follows, so their "
                "clocks differ; correct this by --delay"
            )
        doubtful = [doubt for doubt in self.sections.doubts if doubt]
        count = len(self.sections.time)
        if len(doubtful) > MOST_DOUBTFUL * count:
            reason = Counter(doubtful).most_common(1)[0][0]
            return f"{self.source}: {len(doubtful)} of {count} sections are doubtful, most often: {reason}"
        if not self.kept:
            reason = Counter(self.faults).most_common(1)[0][0]
            return f"{self.source}: no step can be used, most often: {reason}"
        return ""


def extract_steps(
    text: str, plan: Path | None, settings: SectionSettings, find: SectionFunction | None = None
) -> ExtractedSteps:
    """Extracts the steps of a log that is a single deployment.

    Args:
        text: The log, as of `read_signal_log`.
        plan: File of its plans; None if commands and targets are columns of the log.
        find: Finds the sections, in place of the rule of the settings.

    Raises:
        RecordError: A file cannot be read, a column is missing, or no sections are found.
    """
    return extract_from(read_signal_log(text, settings.time, settings.factors, settings.format), plan, settings, find)


def extract_deployments(text: str, plan: Path | None, settings: SectionSettings) -> list[ExtractedSteps]:
    """Extracts the steps of each deployment of a log, which is a single one unless the settings name a column.

    A `StepGapWarning` names those that are left out, with the reasons; arguments and errors are as of `extract_steps`.
    """
    if not settings.deployment:
        return [extract_steps(text, plan, settings)]
    logs = read_deployments(text, settings.time, settings.factors, settings.format, settings.deployment)
    extracted: list[ExtractedSteps] = []
    faults: list[RecordError] = []
    for read in logs:
        try:
            extracted.append(extract_from(read(), plan, settings))
        except RecordError as error:
            faults.append(error)
    if not extracted:
        raise faults[0]
    for fault in faults:
        warnings.warn(f"left out: {fault}", StepGapWarning, stacklevel=2)
    return extracted


def extract_from(
    log: SignalLog, plan: Path | None, settings: SectionSettings, find: SectionFunction | None = None
) -> ExtractedSteps:
    """Extracts the steps of a log that was read; arguments and errors as of `extract_steps`."""
    log = with_pose(with_boom(log, settings), settings)
    plans = read_plans(plan, log, settings) if plan else None
    _check_factors(settings, log, plans)
    # Sections: where a step ends and the next one begins.
    held = _held(log, plans, settings) if settings.every and not find else None
    boundaries = _boundaries(log, settings, held, find)
    sections = section_states(log, boundaries, settings)
    # Commands, targets and predictions of the steps between them.
    parts: dict[str, list[StepValues]] = {}
    for role in COORDINATES[1:]:
        sources = [_source(entry, log, plans, settings) for entry in getattr(settings, role)]
        if held and role == "command" and sources:
            parts[role] = [held_in_steps(held, boundaries, settings.every)]
        elif sources:
            parts[role] = [step_values(source, sections.time, settings.of_several) for source in sources]
    values = {
        role: np.concatenate([part.values.reshape(len(boundaries) - 1, -1) for part in of_role], -1)
        for role, of_role in parts.items()
    }
    # Reasons for which steps are left out.
    signals = {column: log.signal(column) for column in _columns(settings)}
    hops = log.signal(settings.height_column) if settings.at_apex else None
    longest = LONGEST_GAP_IN_MEAN * settings.every or LONGEST_GAP * float(np.median(np.diff(sections.time)))
    doubts = [""] * (len(boundaries) - 1)
    if parts:
        doubts = joined_doubts([part for of_role in parts.values() for part in of_role])
    return ExtractedSteps(
        source=log.source,
        deployment=log.deployment,
        clock=log.clock,
        names={role: tuple(coordinate.name for coordinate in settings.coordinates(role)) for role in COORDINATES},
        sections=sections,
        values=values,
        yaw=_yaw(log, settings, sections.time[:-1]),
        faults=_faults(sections, list(signals.values()), hops, longest, doubts),
        signals=signals,
        lag=_lag(held, log, settings) if held and settings.command else np.nan,
    )


def _boundaries(
    log: SignalLog, settings: SectionSettings, held: HeldCommands | None, find: SectionFunction | None
) -> list[FoundSection]:
    """The sections in the order of their times."""
    if find:
        sections = find(log)
    else:
        sections = _regular(held, log, settings) if held else find_sections(log, settings)
    ordered = sorted(sections, key=lambda section: section.time)
    if len(ordered) < 2:
        raise RecordError(f"{log.source}: {len(ordered)} sections; at least two are needed")
    return ordered


def _lag(held: HeldCommands, log: SignalLog, settings: SectionSettings) -> float:
    """Time by which the means of the state follow the commands [s]; NaN if it has none."""
    coordinates = [coordinate for coordinate in settings.coordinates("state") if coordinate.mean]
    means = [(log.signal(coordinate.column), coordinate.rate) for coordinate in coordinates]
    if not means:
        return np.nan
    first = max(signal.time[0] for signal, _ in means)
    last = min(signal.time[-1] for signal, _ in means)
    cells = np.arange(first, last, settings.every / CELLS)[:MOST_CELLS]
    return command_lag(cells, [step_means(signal, cells[:-1], cells[1:], rate=rate)[0] for signal, rate in means], held)


def _held(log: SignalLog, plans: Plans | None, settings: SectionSettings) -> HeldCommands:
    """The commands of a log; without any, a single one that holds all the time."""
    if settings.command:
        return held_commands([_source(entry, log, plans, settings) for entry in settings.command], settings.hold)
    first = log.signal(settings.coordinates("state")[0].column)
    return HeldCommands(first.time[[0, -1]], np.zeros((2, 0)))


def _regular(held: HeldCommands, log: SignalLog, settings: SectionSettings) -> list[FoundSection]:
    """Sections at equal intervals, while all signals of the state have samples."""
    signals = [log.signal(coordinate.column) for coordinate in settings.coordinates("state")]
    first = max(signal.time[0] for signal in signals)
    last = min(signal.time[-1] for signal in signals)
    holds = np.isfinite(held.values[:-1]).all(axis=1)
    if np.diff(held.begin)[holds].sum() > MOST_REGULAR * settings.every:
        raise RecordError(f"{log.source}: every = {settings.every:g} s makes more than {MOST_REGULAR:,} steps of it")
    sections = regular_sections(held, settings.every, float(first), float(last))
    if len(sections) < 2:
        raise RecordError(
            f"{log.source}: no command holds for {settings.every:g} s from {first:.3f} to {last:.3f} s, when the state "
            "is known"
        )
    return sections


def _source(entry: str, log: SignalLog, plans: Plans | None, settings: SectionSettings) -> Signal:
    """The signal of a coordinate of the command, in the plans or else in the log, with its delay."""
    coordinate = SignalCoordinate.of(entry)
    if coordinate.rate or coordinate.mean:
        raise RecordError(f"{entry}: only coordinates of the state may be rates or means")
    column = coordinate.column
    signal = plans.signal(column) if plans else None
    if plans and signal is None and column not in log.columns:
        raise RecordError(f"{plans.table.source}: {plans.table.fault_of(column)}; nor has {log.source} one")
    if signal is None:
        signal = log.signal(column)
    return Signal(signal.time + settings.delay, signal.values)


def _check_factors(settings: SectionSettings, log: SignalLog, plans: Plans | None) -> None:
    """Raises RecordError if a column that has a factor does not exist, because its name may be misspelt."""
    for column in settings.factors:
        if column not in log.columns and (plans is None or plans.signal(column) is None):
            raise RecordError(f"{log.source}: factors: {unknown_column(column, log.columns)}")


def _columns(settings: SectionSettings) -> list[str]:
    """Columns of numbers that must not have gaps, first the one in which sections are seen."""
    seen = [column for column in (settings.crossing, settings.height_column) if column]
    state = [coordinate.column for coordinate in settings.coordinates("state")]
    return list(dict.fromkeys([*seen, *state, *settings.contact, *settings.force]))


def _faults(
    sections: SectionStates, used: Sequence[Signal], height: Signal | None, longest: float, planned: Sequence[str]
) -> tuple[str, ...]:
    """Why each step is left out; `longest` is the longest time that a signal may be without a sample [s]."""
    times = sections.time
    hops = hop_faults(height, times) if height else [""] * (len(times) - 1)
    faults: list[str] = []
    for number, (begin, end) in enumerate(pairwise(times.tolist())):
        doubtful = any(sections.doubts[number : number + 2])
        unknown = not np.isfinite(sections.state[number : number + 2]).all()
        if end <= begin:
            faults.append("it ends before it begins")
        elif doubtful:
            faults.append("a section is doubtful")
        elif unknown:
            faults.append("a state is unknown")
        elif any(_largest_gap(signal, begin, end) > longest for signal in used):
            faults.append(f"no samples for {longest:.2g} s")
        else:
            faults.append(hops[number] or planned[number])
    return tuple(faults)


def _largest_gap(signal: Signal, begin: float, end: float) -> float:
    return float(np.diff([begin, *signal.between(begin, end).time.tolist(), end]).max())


def _yaw(log: SignalLog, settings: SectionSettings, times: Array) -> Array | None:
    if not settings.yaw:
        return None
    yaw = log.signal(settings.yaw)
    return np.interp(times, yaw.time, np.asarray(yaw.values, float))


def with_boom(log: SignalLog, settings: SectionSettings) -> SignalLog:
    """The log with the columns `height` and `forward`, if the robot hops around a boom.

    Raises:
        RecordError: There is no such angle.
    """
    if not settings.boom:
        return log
    pitch = log.signal(settings.pitch)
    yaw = log.signal(settings.yaw)
    columns = (settings.boom * np.sin(np.asarray(pitch.values, float)), settings.boom * np.asarray(yaw.values, float))
    return with_columns(log, "boom", dict(zip(BOOM_COLUMNS, columns, strict=True)), (pitch.time, yaw.time))


def with_pose(log: SignalLog, settings: SectionSettings) -> SignalLog:
    """The log with the columns `POSE_COLUMNS`, if the settings name a pose.

    Raises:
        RecordError: There is no such pose, or its columns are of different tables.
    """
    if not settings.pose:
        return log
    columns = settings.pose
    if len(columns) == 1:
        columns = tuple(f"{columns[0]}.{part}" for part in (*_POSITION, *_ORIENTATION))
    x, y, *orientation = (log.signal(column) for column in columns)
    time = x.time
    for column, signal in zip(columns, (x, y, *orientation), strict=True):
        if signal.time.shape != time.shape or (signal.time != time).any():
            raise RecordError(f"{log.source}, column {column!r}: its times are not those of {columns[0]!r}")
    parts = [np.asarray(signal.values, float) for signal in orientation]
    yaw, valid = (parts[0], np.ones(len(time), bool)) if len(parts) == 1 else _yaw_of(np.stack(parts))
    if valid.sum() < 2:
        raise RecordError(f"{log.source}, column {columns[2]!r}: no quaternion x, y, z, w with a norm of 1")
    moved = body_motion(*(np.asarray(values, float)[valid] for values in (x.values, y.values, yaw)))
    return with_columns(log, "pose", dict(zip(POSE_COLUMNS, moved, strict=True)), [time[valid]] * len(moved))


def with_columns(log: SignalLog, name: str, columns: Mapping[str, Array], times: Sequence[Array]) -> SignalLog:
    """The log with computed columns before its own ones, which have no factors, and the times of each."""
    tables = [
        TimedTable(LogTable(f"{log.source}, {name}", {column: values}), time)
        for (column, values), time in zip(columns.items(), times, strict=True)
    ]
    factors = {column: factor for column, factor in log.factors.items() if column not in columns}
    return replace(log, files=[tables, *log.files], factors=factors)


def body_motion(x: Array, y: Array, yaw: Array) -> tuple[Array, Array, Array]:
    """Sums of the displacements forward and to the left, as seen by the robot, and the unwrapped yaw.

    Each displacement is turned into the frame that is in the middle of both yaws.

    Args:
        x: Positions in the world [m]; shape (R,).
        y: The same along the other axis, to the left of x.
        yaw: Angles of the forward axis from x to y [rad], which may jump by full turns.
    """
    turn = np.unwrap(yaw)
    middle = (turn[1:] + turn[:-1]) / 2
    dx = np.diff(x)
    dy = np.diff(y)
    forward = np.cos(middle) * dx + np.sin(middle) * dy
    left = np.cos(middle) * dy - np.sin(middle) * dx
    return np.append(0.0, np.cumsum(forward)), np.append(0.0, np.cumsum(left)), turn


def _yaw_of(quaternion: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Yaw of quaternions x, y, z, w, shape (4, R), and where they are ones."""
    x, y, z, w = quaternion
    norm = np.linalg.norm(quaternion, axis=0)
    yaw = np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return yaw, (norm > _NORM[0]) & (norm < _NORM[1])
