"""Nodes: topics, parameters, timers, clock and log."""

import json
import math
import os
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from ros2_messages import as_bytes, from_bytes, message_type

from rclpy import arguments, world


class Node:
    """A node of which this process has one."""

    given = arguments.Arguments()

    def __init__(self, name: str):
        self.name = self.given.node or name
        self.subscriptions: dict[str, tuple[type, Callable[[Any], None]]] = {}
        self.parameters: dict[str, Any] = {}
        self.timers: list[list[Any]] = []

    def create_publisher(self, kind: type, topic: str, qos_profile: int) -> "Publisher":
        """A publisher."""
        assert qos_profile == 1
        return Publisher(kind, self.given.resolved(topic, self.name))

    def create_subscription(self, kind: type, topic: str, callback: Callable[[Any], None], qos_profile: object) -> None:
        """Calls back for each message."""
        assert qos_profile in ("sensor data", 1)
        self.subscriptions[self.given.resolved(topic, self.name)] = kind, callback

    def declare_parameter(self, name: str, value: Any) -> SimpleNamespace:
        """A parameter with its default; raises TypeError if the given one has another type."""
        assert name not in self.parameters
        found = self.given.parameters.get(name, value)
        if type(found) is not type(value):
            raise TypeError(f"InvalidParameterTypeException: {name} must be a {type(value).__name__}")
        self.parameters[name] = found
        return self.get_parameter(name)

    def get_parameter(self, name: str) -> SimpleNamespace:
        """A declared parameter."""
        return SimpleNamespace(value=self.parameters[name])

    def create_timer(self, period: float, callback: Callable[[], None]) -> None:
        """Calls back at intervals."""
        self.timers.append([world.ROBOT.time + period, period, callback])

    def get_clock(self) -> SimpleNamespace:
        """The clock of the robot."""
        return SimpleNamespace(now=lambda: _Time(world.ROBOT.time))

    def get_logger(self) -> SimpleNamespace:
        """The log, whose lines go where statuses go."""
        return SimpleNamespace(**dict.fromkeys(("info", "warning"), _noted))

    def destroy_node(self) -> None:
        """Nothing is to be done."""


class _Time:
    def __init__(self, seconds: float):
        self.nanoseconds = round(seconds * 1e9)

    def to_msg(self) -> Any:
        """The message of this time."""
        stamp = message_type("builtin_interfaces/msg/Time")()
        stamp.sec, stamp.nanosec = divmod(self.nanoseconds, 10**9)
        return stamp


def _noted(line: str) -> None:
    if "STAND_IN_SAID" in os.environ:
        with open(os.environ["STAND_IN_SAID"], "a", encoding="utf-8") as log:  # noqa: PTH123
            print(json.dumps([world.ROBOT.time, "log", line]), file=log)


class Publisher:
    """Gives each command to the robot, if it is for its topic, and notes all else."""

    def __init__(self, kind: type, topic: str):
        self.kind, self.topic = kind, topic

    def publish(self, message: Any) -> None:
        """Sends a message."""
        assert isinstance(message, self.kind)
        found = from_bytes(as_bytes(message), self.kind)
        if hasattr(found, "data"):
            if "STAND_IN_SAID" in os.environ:
                with open(os.environ["STAND_IN_SAID"], "a", encoding="utf-8") as log:  # noqa: PTH123
                    print(json.dumps([world.ROBOT.time, self.topic, found.data]), file=log)
            return
        if hasattr(found, "pose"):
            pose, twist = found.pose.pose, found.twist.twist
            yaw = 2 * math.atan2(pose.orientation.z, pose.orientation.w)
            numbers = [twist.linear.x, twist.linear.y, twist.angular.z, pose.position.x, pose.position.y, yaw]
            truth = [*world.ROBOT.velocity, *world.ROBOT.pose]
            with open(os.environ["STAND_IN_SAID"], "a", encoding="utf-8") as log:  # noqa: PTH123
                print(json.dumps([world.ROBOT.time, self.topic, numbers, truth]), file=log)
            return
        assert self.topic == os.environ.get("STAND_IN_COMMAND", "/cmd_vel")
        if hasattr(found, "parameter"):
            given = json.loads(found.parameter) if found.header.identity.api_id == 1008 else dict.fromkeys("xyz", 0.0)
            command = [given["x"], given["y"], given["z"]]
        else:
            command = self.velocity_of(found)
        assert all(map(math.isfinite, command))
        world.ROBOT.command = command
        with open(os.environ["STAND_IN_LOG"], "a", encoding="utf-8") as log:  # noqa: PTH123
            print(world.ROBOT.time, *command, file=log)

    def velocity_of(self, found: Any) -> list[float]:
        """The command of a Twist or TwistStamped."""
        if hasattr(found, "header"):
            assert found.header.stamp.sec + 1e-9 * found.header.stamp.nanosec <= world.ROBOT.time + 1e-6
        twist = found.twist if hasattr(found, "twist") else found
        return [twist.linear.x, twist.linear.y, twist.angular.z]
