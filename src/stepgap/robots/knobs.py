"""What could be the step command of a robot: numbers of its settings that a controller could change for one step."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, NamedTuple

_SHARE = 0.1
"""Range of a gain of which none is known, as a part of the gain."""


class Knob(NamedTuple):
    """A number that could be a coordinate of the step command.

    Attributes:
        key: Its setting, such as `gains.stiffness`; the name of a coordinate that the command has.
        unit: SI unit; empty if it is not known.
        reach: By how much a command may change it, up or down.
    """

    key: str
    unit: str
    reach: float


def gain_knobs(robot: Any) -> tuple[Knob, ...]:
    """All numbers of a robot's table `gains` that are not zero, each with a tenth of it as range."""
    gains = getattr(robot, "gains", None)
    numbers: Mapping[str, Any] = (
        {field.name: getattr(gains, field.name) for field in fields(gains)} if is_dataclass(gains) else {}
    )
    return tuple(
        Knob(f"gains.{name}", "", _SHARE * abs(value))
        for name, value in numbers.items()
        if isinstance(value, float) and value != 0
    )


def turned(robot: Any, changes: Mapping[str, float]) -> Any:
    """A robot with other settings.

    Args:
        robot: The robot.
        changes: What is added to each, by keys as in `Knob`.

    Raises:
        ValueError: A setting is out of its range then.
    """
    for key, change in changes.items():
        table, _, name = key.partition(".")
        old = getattr(robot, table)
        robot = replace(robot, **{table: replace(old, **{name: getattr(old, name) + change})})
    return robot
