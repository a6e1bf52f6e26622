"""A robot that follows its commanded velocity with lag and a gain, has odometry at 50 Hz, and may fail."""

import json
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
        kind, begin, end = (*os.environ.get("STAND_IN_FAULT", "").split(","), "", "")[:3]
        self.fault, self.fails, self.recovers = kind, float(begin or math.inf), float(end or math.inf)
        self.asked = json.loads(os.environ.get("STAND_IN_ASKED", "[]"))
        self.seen = [0.0] * 3  # the velocities of the latest odometry
        self.seen_at = list(self.pose)  # the latest place of the motion capture
        self.drift = json.loads(os.environ.get("STAND_IN_DRIFT", "[0, 0, 0]"))

    def moved(self) -> Iterator[tuple[str, Any]]:
        """Moves for a tick; yields topics and messages every second time."""
        self.time += TICK
        change = TICK / LAG
        pairs = zip(self.velocity, self.command, self.drift, strict=True)
        self.velocity = [v + change * (GAIN * c + drift - v) for v, c, drift in pairs]
        forward, left, turn = self.velocity
        x, y, yaw = self.pose
        middle = yaw + turn * TICK / 2
        x += TICK * (forward * math.cos(middle) - left * math.sin(middle))
        y += TICK * (forward * math.sin(middle) + left * math.cos(middle))
        self.pose = [x, y, yaw + turn * TICK]
        failed = self.fault if self.fails < self.time < self.recovers else ""
        if round(self.time / TICK) % 2 == 0 and failed != "silent":
            yield os.environ.get("STAND_IN_ODOM", "/odom"), self.odometry(failed)
            yield "/mocap", self.stamped(failed)
            yield "/sportmodestate", self.sport_mode_state()
        if self.asked and round(self.time / TICK) % 10 == 0 and failed != "nobody":
            yield os.environ.get("STAND_IN_RAW", "/cmd_vel_raw"), self.wanted()

    @property
    def is_over(self) -> bool:
        """Whether the last time at which somebody asks for a velocity is over."""
        return self.time >= self.asked[-1][0]

    def wanted(self) -> Any:
        """The message of the velocity that somebody asks for now."""
        kind = "TwistStamped" if os.environ.get("STAND_IN_STAMPED", "1") == "1" else "Twist"
        message = message_type(f"geometry_msgs/msg/{kind}")()
        twist = message.twist if kind == "TwistStamped" else message
        twist.linear.x, twist.linear.y, twist.angular.z = [row for row in self.asked if row[0] <= self.time][-1][1:]
        return message

    def odometry(self, failed: str) -> Any:
        """The message of its odometry."""
        message = message_type("nav_msgs/msg/Odometry")()
        self.write(message.header.stamp, message.pose.pose)
        twist = message.twist.twist
        self.seen = self.seen if failed == "frozen" else list(self.velocity)
        twist.linear.x, twist.linear.y, twist.angular.z = self.seen
        if failed == "jumps":
            twist.linear.y += 3.0 * (round(self.time / TICK) % 4 == 0)
        if failed == "nan":
            twist.linear.x = math.nan
        if failed == "fell":
            turn = message.pose.pose.orientation
            turn.x, turn.y, turn.z, turn.w = 0.8, 0.0, 0.0, 0.6
        return message

    def stamped(self, failed: str) -> Any:
        """The message of a motion capture."""
        message = message_type("geometry_msgs/msg/PoseStamped")()
        self.seen_at = self.seen_at if failed == "frozen" else list(self.pose)
        pose, self.pose = self.pose, self.seen_at
        self.write(message.header.stamp, message.pose)
        self.pose = pose
        if failed == "jumps":
            message.pose.position.y += 0.1 * (round(self.time / TICK) % 6 == 0)
        if failed == "nan":
            message.pose.position.x = math.nan
        return message

    def sport_mode_state(self) -> Any:
        """The message of the sport mode of Unitree's quadrupeds."""
        message = message_type("unitree_go/msg/SportModeState")()
        message.position[:2], message.imu_state.rpy[2] = self.pose[:2], self.pose[2]
        message.velocity[:2], message.yaw_speed = self.velocity[:2], self.velocity[2]
        return message

    def write(self, stamp: Any, pose: Any) -> None:
        """Writes time and pose."""
        stamp.sec, stamp.nanosec = 1000 + int(self.time), int(self.time % 1 * 1e9)
        pose.position.x, pose.position.y, yaw = self.pose
        pose.orientation.z, pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)


ROBOT = Robot()
