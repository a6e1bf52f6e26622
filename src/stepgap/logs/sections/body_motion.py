"""Columns that are computed: of a robot on a boom, and its motion as it sees it, from poses in the world."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stepgap.logs.sections.section_settings import BOOM_COLUMNS, POSE_COLUMNS, SectionSettings
from stepgap.logs.sections.signals import SignalLog, TimedTable
from stepgap.logs.tables.log_table import LogTable
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array

_POSITION = ("position.x", "position.y")
_ORIENTATION = tuple(f"orientation.{axis}" for axis in "xyzw")

_NORM = (0.9, 1.1)  # Norms of a quaternion that is one; a sensor that has none often gives zeros


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
    return _with_columns(log, "boom", dict(zip(BOOM_COLUMNS, columns, strict=True)), (pitch.time, yaw.time))


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
    yaw, known = (parts[0], np.ones(len(time), bool)) if len(parts) == 1 else _yaw_of(np.stack(parts))
    if known.sum() < 2:
        raise RecordError(f"{log.source}, column {columns[2]!r}: no quaternion x, y, z, w with a norm of 1")
    moved = body_motion(*(np.asarray(each, float)[known] for each in (x.values, y.values, yaw)))
    return _with_columns(log, "pose", dict(zip(POSE_COLUMNS, moved, strict=True)), [time[known]] * len(moved))


def _with_columns(log: SignalLog, name: str, columns: Mapping[str, Array], times: Sequence[Array]) -> SignalLog:
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
