"""How a robot moved in a log: its velocity as the robot sees it, and the commands that it was given.

What odometry may get wrong is found here: velocities in the frame of the world, numbers that repeat while the robot
moves, and, by a measured distance, a scale or a heading that is off.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from stepgap.base.errors import InputError
from stepgap.control.shortfall import turned
from stepgap.cure.topics import COMMAND_TYPES, POSE_TYPES, VELOCITY_TYPES, Topic, chosen_topic, topics_in
from stepgap.logs.sections.held_commands import HeldCommands, held_commands
from stepgap.logs.sections.section_settings import POSE_COLUMNS, SectionSettings
from stepgap.logs.sections.signals import Signal, SignalLog, read_signal_log
from stepgap.logs.sections.step_extraction import with_columns, with_pose
from stepgap.logs.tables.text import AS_FOUND
from stepgap.step import Array

AXIS_NAMES: Final = ("vx", "vy", "wz")  # Forward, to the left [m/s], turning to the left [rad/s]
_COLUMNS: Final = tuple(f"as_the_robot_sees_it_{name}" for name in AXIS_NAMES)

FROZEN: Final = 0.25
"""Numbers that are repeated for this long while they are not zero are no measurements [s]."""

_TURNED: Final = 1.0  # Least change of yaw from which the frame of velocities can be told [rad]
_BETTER: Final = 0.7  # Part of the unexplained variance that is left in the right frame, at most
_FOLLOWS: Final = 0.3  # Time after which about any robot follows its command [s]
CELL: Final = 0.02  # Time between two values of a velocity on a grid [s]
_LONGEST_GAP: Final = 0.1  # Time without a sample that is bridged by a straight line [s]

IMPLAUSIBLE: Final = 0.05
"""Part of the way by which the end of the way may differ from where it was measured."""


@final
@dataclass(frozen=True, eq=False)
class HandDrive:
    """Commands and motion of a log.

    Attributes:
        log: The log, with the velocities as the robot sees them.
        command: Where its commands are.
        measured: Where its velocities are, or the places that they follow from.
        commands: Its commands as a function of time.
        state: Entries of the state for `SectionSettings`.
        time: Of the samples of the velocity [s]; shape (R,).
        velocity: Forward, to the left, turning, as the robot sees them; shape (R, 3).
        notes: Sentences on what was found.
        is_turned: Whether the odometry has velocities in the frame of the world, which were turned.
    """

    log: SignalLog
    command: Topic
    measured: Topic
    commands: HeldCommands
    state: tuple[str, ...]
    time: Array
    velocity: Array
    notes: tuple[str, ...] = ()
    is_turned: bool = False

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def interval(self) -> float:
        """Usual time between two samples of the velocity [s]."""
        return float(np.median(np.diff(self.time)))

    def section_settings(self, every: float) -> SectionSettings:
        """How steps of a duration are extracted."""
        command = tuple(
            f"command_{name}={column}" for name, column in zip(AXIS_NAMES, self.command.columns, strict=True)
        )
        return SectionSettings(state=self.state, command=command, every=every)

    def on_grid(self) -> tuple[Array, Array, Array]:
        """Times `CELL` apart (G,), velocities there and the commands then (G, 3), NaN where one is not known."""
        time = np.arange(self.time[0], self.time[-1], CELL)
        after = np.clip(np.searchsorted(self.time, time), 1, len(self.time) - 1)
        near = self.time[after] - self.time[after - 1] <= max(_LONGEST_GAP, 2.5 * self.interval)
        values = np.stack([np.interp(time, self.time, column) for column in self.velocity.T], axis=-1)
        at = self.commands.at(time)
        given = np.where((at >= 0)[:, None], self.commands.values[at], np.nan)
        return time, np.where(near[:, None], values, np.nan), given

    def way(self) -> tuple[float, float]:
        """Length of the way, and distance of its end from its begin, by the velocities alone [m]."""
        spans = np.diff(self.time)
        middle = (self.velocity[1:] + self.velocity[:-1]) / 2
        turns = np.append(0.0, np.cumsum(middle[:, 2] * spans))
        yaw = (turns[1:] + turns[:-1]) / 2
        moves = np.stack(turned(yaw, *(middle[:, axis] * spans for axis in (0, 1))))
        # The sway of the gait is no way: lengths are those of means over half a second.
        smooth = _means(self.velocity[:, :2], max(1, round(0.5 / self.interval)))
        return float(np.sum(np.hypot(*smooth[:-1].T) * spans)), float(np.hypot(*moves.sum(axis=1)))


def _means(values: Array, width: int) -> Array:
    """Sliding means of columns, of the same number of rows."""
    window = np.ones(width) / width
    return np.stack([np.convolve(column, window, "same") for column in values.T], axis=-1)


def read_drive(text: str, command: str = "", odometry: str = "") -> HandDrive:
    """Reads a log, and finds commands and velocities in it.

    Args:
        text: File of the log, or several joined by "+".
        command: Topic of the commands, or its three columns; empty for the only one.
        odometry: Topic of the velocities or places, or columns of the velocities; empty for the only one.

    Raises:
        InputError: There are no commands or velocities, or several; the message names the topics.
    """
    log = read_signal_log(text, "", {}, AS_FOUND)
    given = chosen_topic(log, topics_in(log, COMMAND_TYPES), "--command", command, "velocity command")
    if given is None:
        raise InputError(
            f"{log.source}: no velocity commands: no geometry_msgs/Twist or TwistStamped, and no columns "
            f"command_vx, command_vy, command_wz; name three columns by --command FORWARD,LEFT,TURN; there is "
            f"{', '.join(log.columns):.300}"
        )
    poses = topics_in(log, POSE_TYPES)
    velocities = topics_in(log, VELOCITY_TYPES)
    if odometry and odometry in [pose.name for pose in poses] and odometry not in [one.name for one in velocities]:
        velocities = []
    measured = chosen_topic(log, velocities, "--odometry", odometry if velocities else "", "odometry")
    commands = held_commands([log.signal(column) for column in given.columns])
    if measured is None:
        pose = chosen_topic(log, poses, "--odometry", odometry, "odometry")
        if pose is None:
            raise InputError(
                f"{log.source}: no odometry: no nav_msgs/Odometry or geometry_msgs/PoseStamped, and no columns vx, vy, "
                f"wz; name three columns by --odometry FORWARD,LEFT,TURN; there is {', '.join(log.columns):.300}"
            )
        return _by_places(log, given, commands, pose)
    time, velocity = _together([log.signal(column) for column in measured.columns])
    kept, notes = _measured(log, time, velocity)
    drive = _with_velocity(HandDrive(log, given, measured, commands, (), time[kept], velocity[kept]), notes)
    pose = next((pose for pose in poses if pose.name == measured.name), None)
    return _in_robot_frame(drive, pose)


def _by_places(log: SignalLog, given: Topic, commands: HeldCommands, pose: Topic) -> HandDrive:
    """The drive of a robot of which places alone are known; its velocity is the way in a step over its time."""
    settings = SectionSettings(state=("forward",), every=1.0, pose=pose.columns)
    posed = with_pose(log, settings)
    time, places = _together([posed.signal(column) for column in POSE_COLUMNS])
    kept, notes = _measured(log, time, places)
    time, places = time[kept], places[kept]
    posed = with_columns(log, "pose", dict(zip(POSE_COLUMNS, places.T, strict=True)), [time] * len(POSE_COLUMNS))
    state = tuple(f"{name}=mean(rate({column}))" for name, column in zip(AXIS_NAMES, POSE_COLUMNS, strict=True))
    note = f"Velocities are the displacements of {pose.name or 'the place'}, as the robot sees them."
    return HandDrive(posed, given, pose, commands, state, time, np.gradient(places, time, axis=0), (note, *notes))


def _together(signals: Sequence[Signal]) -> tuple[Array, Array]:
    """Times at which all signals have a sample, and their values; shapes (R,) and (R, 3)."""
    time = signals[0].time
    for signal in signals[1:]:
        time = np.intersect1d(time, signal.time)
    if len(time) < 2:
        raise InputError("the columns of the velocity have no two common times; name columns of one topic")
    rows = [np.searchsorted(signal.time, time) for signal in signals]
    values = [np.asarray(signal.values, float)[row] for signal, row in zip(signals, rows, strict=True)]
    return time, np.stack(values, axis=-1)


def _measured(log: SignalLog, time: Array, values: Array) -> tuple[NDArray[np.bool_], list[str]]:
    """Which samples (R, 3) do not repeat the same numbers, but zeros, for `FROZEN`, shape (R,); a note on the rest."""
    same = np.append(False, (values[1:] == values[:-1]).all(axis=1) & (values[1:] != 0).any(axis=1))
    begin = np.flatnonzero(~same)
    number = np.cumsum(~same) - 1
    lasting = np.append(time[begin[1:] - 1], time[-1]) - time[begin]
    frozen = same & (lasting[number] >= FROZEN)
    if np.count_nonzero(~frozen) < 2:
        raise InputError(f"{log.source}: its odometry never changes, so it says nothing of the motion")
    lost = float(np.sum(np.diff(time)[frozen[1:]]))
    note = f"For {lost:.1f} s the odometry repeats the same numbers; that part is left out."
    return ~frozen, [note] if lost else []


def _with_velocity(drive: HandDrive, notes: Sequence[str]) -> HandDrive:
    """The drive with its velocity as columns of its log."""
    columns = dict(zip(_COLUMNS, drive.velocity.T, strict=True))
    log = with_columns(drive.log, "velocity", columns, [drive.time] * len(_COLUMNS))
    state = tuple(f"{name}=mean({column})" for name, column in zip(AXIS_NAMES, _COLUMNS, strict=True))
    return replace(drive, log=log, state=state, notes=(*drive.notes, *notes))


def _in_robot_frame(drive: HandDrive, pose: Topic | None) -> HandDrive:
    """The drive with velocities as the robot sees them, where those of the odometry are in the frame of the world."""
    yaw = _yaw_of(drive, pose)
    if np.ptp(yaw) < _TURNED:
        return drive
    x, y, turning = drive.velocity.T
    in_robot = replace(drive, velocity=np.stack([*turned(-yaw, x, y), turning], axis=-1), is_turned=True)
    as_it_is, in_world = (_unexplained_sideways(one) for one in (drive, in_robot))
    if not in_world < _BETTER * as_it_is:
        return drive
    note = (
        "The velocities of the odometry are in the frame of the world (its commands explain them "
        f"{100 * (1 - as_it_is):.0f} % as they are, {100 * (1 - in_world):.0f} % turned by its yaw), so they were "
        "turned into that of the robot. The message nav_msgs/Odometry demands the frame of the robot."
    )
    return _with_velocity(replace(in_robot, log=replace(drive.log, files=drive.log.files[1:])), [note])


def _yaw_of(drive: HandDrive, pose: Topic | None) -> Array:
    """Yaw at the samples of the velocity [rad]: that of the odometry, or the sum of its turning; shape (R,)."""
    if pose is None:
        return np.append(0.0, np.cumsum(drive.velocity[1:, 2] * np.diff(drive.time)))
    settings = SectionSettings(state=("forward",), every=1.0, pose=pose.columns)
    turn = with_pose(drive.log, settings).signal(POSE_COLUMNS[2])
    return np.interp(drive.time, turn.time, np.asarray(turn.values, float))


def _unexplained_sideways(drive: HandDrive) -> float:
    """Part of the variance of the forward and sideways velocity that the commands of a moment ago leave."""
    late = round(_FOLLOWS / CELL)
    _, velocity, given = drive.on_grid()
    velocity = velocity[late:]
    given = given[:-late]
    known = np.isfinite(velocity).all(axis=1) & np.isfinite(given).all(axis=1)
    if known.sum() < 100:
        return 1.0
    basis = np.column_stack([given[known], np.ones(known.sum())])
    wanted = velocity[known, :2] - velocity[known, :2].mean(axis=0)
    left = wanted - basis @ np.linalg.lstsq(basis, wanted, rcond=None)[0]
    return float(np.sum(left**2) / max(np.sum(wanted**2), 1e-12))


def check_distance(drive: HandDrive, metres: float) -> str:
    """A sentence on whether the velocities fit a measured distance.

    Args:
        drive: The drive.
        metres: Distance of the place where the log ends from that where it begins, as measured by a tape [m].

    Raises:
        InputError: They do not fit; the message says by how much.
    """
    length, apart = drive.way()
    away = apart - metres
    words = (
        f"By its velocities the robot went {length:.1f} m and ended {apart:.2f} m from where it began; measured were "
        f"{metres:g} m"
    )
    if abs(away) <= IMPLAUSIBLE * max(length, metres):
        return f"{words}: plausible, they differ by {100 * abs(away) / max(length, metres, 1e-9):.1f} % of the way."
    scale = f" If the way was straight, its velocities are {apart / metres:.2f} times too large." if metres else ""
    raise InputError(
        f"--distance {metres:g}: {words}, which differs by more than {100 * IMPLAUSIBLE:g} % of the way, so what would "
        f"be corrected is the odometry, not the robot.{scale} Correct the odometry (docs/velocity.md: where the "
        "velocity comes from), or drive a straight line for this check"
    )
