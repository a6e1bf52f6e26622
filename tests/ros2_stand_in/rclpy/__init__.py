"""A stand-in of rclpy with a walking robot on its topics: what `examples/process/ros2_robot.py` uses, and no more.

Time passes only while a node spins, 10 ms in each call, so no test depends on the speed of the machine. Messages cross
the topics in CDR, by the message definitions that are published with ROS 2 Humble, as `rosbags` has them.

Environment: STAND_IN_LOG is a file for all commands, as lines of time, vx, vy and wz; STAND_IN_FAULT=KIND,SECONDS says
from when on the robot is silent, fell, or reports nan.
"""

import math
import os
from collections.abc import Callable
from typing import Any

from ros2_messages import as_bytes, from_bytes

from rclpy import world
from rclpy.signals import SignalHandlerOptions


def init(*, signal_handler_options: SignalHandlerOptions) -> None:
    """Nothing is to be prepared."""
    assert signal_handler_options == SignalHandlerOptions.NO


class Node:
    """A node of which this process has one."""

    def __init__(self, name: str):
        self.name = name
        self.subscriptions: dict[str, tuple[type, Callable[[Any], None]]] = {}

    def create_publisher(self, kind: type, topic: str, qos_profile: int) -> "Publisher":
        """A publisher of the command."""
        assert (topic, qos_profile) == ("/cmd_vel", 1)
        return Publisher(kind)

    def create_subscription(self, kind: type, topic: str, callback: Callable[[Any], None], qos_profile: object) -> None:
        """Calls back for each message."""
        assert qos_profile == "sensor data"
        self.subscriptions[topic] = kind, callback


class Publisher:
    """Gives each message to the robot."""

    def __init__(self, kind: type):
        self.kind = kind

    def publish(self, message: Any) -> None:
        """Sends a command."""
        assert isinstance(message, self.kind)
        twist = from_bytes(as_bytes(message), self.kind)
        command = [twist.linear.x, twist.linear.y, twist.angular.z]
        assert all(map(math.isfinite, command))
        world.ROBOT.command = command
        with open(os.environ["STAND_IN_LOG"], "a", encoding="utf-8") as log:  # noqa: PTH123
            print(world.ROBOT.time, *command, file=log)


def create_node(name: str) -> Node:
    """A node."""
    return Node(name)


def spin_once(node: Node, *, timeout_sec: float) -> None:
    """Lets 10 ms pass and delivers the message that has come, if one has."""
    assert timeout_sec == world.TICK
    for topic, message in world.ROBOT.moved():
        if topic in node.subscriptions:
            kind, callback = node.subscriptions[topic]
            callback(from_bytes(as_bytes(message), kind))
