"""A stand-in of rclpy with a walking robot on its topics: what the nodes of StepGap use, and no more.

Time passes only while a node spins, 10 ms in each call, so no test depends on the speed of the machine. Messages cross
the topics in CDR, by the message definitions that are published with ROS 2 Humble, as `rosbags` has them. Arguments of
ROS are read as rcl reads them: names are expanded by node and namespace, and then remapped.

Environment: STAND_IN_LOG is a file for all commands, as lines of time, vx, vy and wz; STAND_IN_SAID one for lines of
the log, text and odometry that are published; STAND_IN_FAULT=KIND,SECONDS[,SECONDS] says from when to when the robot is
silent, fell, or reports nan, frozen or jumping numbers, or that nobody asks for a velocity; STAND_IN_ASKED has the
velocities that somebody asks for on cmd_vel_raw, as [[SECONDS, vx, vy, wz], …], up to the last of these times, when the
node is told to end; STAND_IN_COMMAND, STAND_IN_RAW and STAND_IN_ODOM are the full names of topics; STAND_IN_STAMPED is
1 for TwistStamped.
"""

import sys

from ros2_messages import as_bytes, from_bytes

from rclpy import arguments, world
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions


def init(
    *, args: list[str] | None = None, signal_handler_options: SignalHandlerOptions = SignalHandlerOptions.ALL
) -> None:
    """Reads the arguments of ROS."""
    del signal_handler_options
    Node.given = arguments.read(sys.argv if args is None else args)


def create_node(name: str) -> Node:
    """A node."""
    return Node(name)


def spin_once(node: Node, *, timeout_sec: float) -> None:
    """Lets 10 ms pass and delivers the messages that have come."""
    assert timeout_sec == world.TICK
    for topic, message in world.ROBOT.moved():
        if topic in node.subscriptions:
            kind, callback = node.subscriptions[topic]
            assert message.__msgtype__ == kind.__msgtype__, "a subscription of another type gets nothing"
            callback(from_bytes(as_bytes(message), kind))
    for timer in node.timers:
        if world.ROBOT.time >= timer[0] - 1e-9:
            timer[0] += timer[1]
            timer[2]()


def spin(node: Node) -> None:
    """Spins until nobody asks for a velocity any more."""
    while not world.ROBOT.is_over:
        spin_once(node, timeout_sec=world.TICK)
    raise ExternalShutdownException


def try_shutdown() -> None:
    """Nothing is to be ended."""
