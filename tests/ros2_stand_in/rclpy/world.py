"""A robot that follows its commanded velocity with lag and a gain, has odometry at 50 Hz, and may fail."""

import math
import os
from collections.abc import Iterator
from typing import Any

from ros2_messages import message_type

TICK, LAG, GAIN = 0.01, 0.1, 0.8  # s, s


class Robot:
    """Where the robot is and how it moves."""

    def __init__(self) -> None:
        self.time, self.command, self.velocity, self.pose = 0.0, [0.0] * 3, [0.0] * 3, [1.0, 2.0, 3.0]
        kind, _, begin = os.environ.get("STAND_IN_FAULT", "").partition(",")
        self.fault, self.fails = kind, float(begin or math.inf)

    def moved(self) -> Iterator[tuple[str, Any]]:
        """Moves for a tick; yields topics and messages every second time."""
        self.time += TICK
        change = TICK / LAG
        self.velocity = [v + change * (GAIN * c - v) for v, c in zip(self.velocity, self.command, strict=True)]
        forward, left, turn = self.velocity
        x, y, yaw = self.pose
        middle = yaw + turn * TICK / 2
        x += TICK * (forward * math.cos(middle) - left * math.sin(middle))
        y += TICK * (forward * math.sin(middle) + left * math.cos(middle))
        self.pose = [x, y, yaw + turn * TICK]
        failed = self.fault if self.time > self.fails else ""
        if round(self.time / TICK) % 2 == 0 and failed != "silent":
            yield "/odom", self.odometry(failed)
            yield "/mocap", self.stamped()

    def odometry(self, failed: str) -> Any:
        """The message of its odometry."""
        message = message_type("nav_msgs/msg/Odometry")()
        self.write(message.header.stamp, message.pose.pose)
        twist = message.twist.twist
        twist.linear.x, twist.linear.y, twist.angular.z = self.velocity
        if failed == "nan":
            twist.linear.x = math.nan
        if failed == "fell":
            turn = message.pose.pose.orientation
            turn.x, turn.y, turn.z, turn.w = 0.8, 0.0, 0.0, 0.6
        return message

    def stamped(self) -> Any:
        """The message of a motion capture."""
        message = message_type("geometry_msgs/msg/PoseStamped")()
        self.write(message.header.stamp, message.pose)
        return message

    def write(self, stamp: Any, pose: Any) -> None:
        """Writes time and pose."""
        stamp.sec, stamp.nanosec = 1000 + int(self.time), int(self.time % 1 * 1e9)
        pose.position.x, pose.position.y, yaw = self.pose
        pose.orientation.z, pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)


ROBOT = Robot()
