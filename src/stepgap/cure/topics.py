"""Which columns of a log are velocity commands, which are odometry: by the fields of the ROS messages.

A log in a table, such as CSV, has the same names, with slashes or points, or the short names of StepGap's own files.
"""

from collections.abc import Collection, Iterator, Sequence
from typing import Final, NamedTuple

from stepgap.base.errors import InputError
from stepgap.logs.sections.signals import SignalLog

_AXES: Final = ("linear.x", "linear.y", "angular.z")

COMMAND_TYPES: Final = {
    "geometry_msgs/Twist": _AXES,
    "geometry_msgs/TwistStamped": tuple(f"twist.{axis}" for axis in _AXES),
    "commands in a table": ("command_vx", "command_vy", "command_wz"),
    "short commands in a table": ("cx", "cy", "cw"),
}
"""Columns of commanded velocities: forward, to the left, turning to the left."""

VELOCITY_TYPES: Final = {
    "nav_msgs/Odometry": tuple(f"twist.twist.{axis}" for axis in _AXES),
    "velocities in a table": ("vx", "vy", "wz"),
}
"""Columns of measured velocities, in the same order."""

_PLACE: Final = ("position.x", "position.y", *(f"orientation.{axis}" for axis in "xyzw"))

POSE_TYPES: Final = {
    "nav_msgs/Odometry": tuple(f"pose.pose.{part}" for part in _PLACE),
    "geometry_msgs/PoseStamped": tuple(f"pose.{part}" for part in _PLACE),
    "places in a table": ("x", "y", "yaw"),
}
"""Columns of places and headings."""

_WITHIN: Final = ("twist", "pose")  # Fields whose parts look like messages of another type


class Topic(NamedTuple):
    """Columns of a log that belong together.

    Attributes:
        name: Name of the topic, or the beginning that its columns share; may be empty.
        kind: Type of the message.
        columns: Names of the columns.
    """

    name: str
    kind: str
    columns: tuple[str, ...]


def topics_in(log: SignalLog, kinds: dict[str, tuple[str, ...]]) -> list[Topic]:
    """All topics of a log that have the fields of one of the kinds."""
    found = list[Topic]()
    for file in log.files:
        for one in file:
            of_table = [topic for kind, fields in kinds.items() for topic in _of_kind(one.table.columns, kind, fields)]
            # Columns of a bag are there with and without the name of their topic.
            named = [topic for topic in of_table if topic.name]
            found += named or of_table
    return found


def _of_kind(columns: Collection[str], kind: str, fields: tuple[str, ...]) -> Iterator[Topic]:
    for column in columns:
        if not _is_field(column.replace("/", "."), fields[0]):
            continue
        before = column[: len(column) - len(fields[0])]
        slashes = "/" in column[len(before) :] or before.endswith("/")
        names = tuple(before + (field.replace(".", "/") if slashes else field) for field in fields)
        name = before.rstrip(".:/")
        field = name.replace("/", ".").replace(":", ".").rpartition(".")[2]
        if field in _WITHIN and not before.endswith(":"):  # the colon is after a topic, which may have such a name
            continue
        if all(name in columns for name in names):
            yield Topic(name, kind, names)


def _is_field(column: str, field: str) -> bool:
    return column == field or column.endswith((f".{field}", f":{field}"))


def chosen_topic(log: SignalLog, topics: Sequence[Topic], option: str, wanted: str, what: str) -> Topic | None:
    """The only topic, or the one with the wanted name; None if there is none and none is wanted.

    Args:
        log: The log.
        topics: Those of the right types.
        option: The option that chooses, for messages.
        wanted: Name of the topic, or its columns, separated by commas; empty for the only one.
        what: What it is, for messages.

    Raises:
        InputError: There are several, or none of this name.
    """
    names = ", ".join(topic.name or topic.columns[0] for topic in topics)
    if "," in wanted:
        return Topic("", "columns that were named", tuple(name.strip() for name in wanted.split(",")))
    if wanted:
        having = [topic for topic in topics if wanted in (topic.name, topic.name.lstrip("/"), f"/{topic.name}")]
        if not having:
            there = names or f"none; name columns as {option} FORWARD,LEFT,TURN, of {', '.join(log.columns):.300}"
            raise InputError(f"{option} {wanted}: {log.source} has no such {what}; there is {there}")
        return having[0]
    if len(topics) > 1:
        raise InputError(f"{log.source}: {len(topics)} topics may be the {what}: {names}; choose one by {option} NAME")
    return topics[0] if topics else None
