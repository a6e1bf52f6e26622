"""Connects the sport mode of Unitree's quadrupeds, which does not listen to cmd_vel, to the topics cmd_vel and odom.

    python3 unitree_bridge.py [--ros-args -r cmd_vel:=/go2/cmd_vel …]

It needs rclpy and the messages of unitree_ros2. With it a robot is driven, recorded and corrected as any other, by
`ros2 bag record /cmd_vel /odom`, `stepgap cure` and the node that this writes, or by ros2_robot.py. A Twist
on cmd_vel becomes a request `Move`; when none has come for SILENCE, one request `StopMove` is sent. The state of the
sport mode becomes a nav_msgs/Odometry. Whether its velocity is in the frame of the robot or of the world, the message
does not say: `stepgap cure` finds out, and its node turns it. The remote control must not move the robot meanwhile.
"""

import json
import math
import sys
from contextlib import suppress

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from unitree_api.msg import Request
from unitree_go.msg import SportModeState

MOVE, STOP_MOVE = 1008, 1003  # numbers of requests
SILENCE = 0.5  # Time without a command after which the robot is stopped [s]


class Bridge(Node):
    """The node."""

    def __init__(self):
        super().__init__("unitree_bridge")
        self.heard = math.inf  # when the latest command came, inf if the robot was stopped since [s]
        self.orders = self.create_publisher(Request, "/api/sport/request", 1)
        self.odometry = self.create_publisher(Odometry, "odom", 1)
        self.create_subscription(Twist, "cmd_vel", self.on_command, 1)
        self.create_subscription(SportModeState, "sportmodestate", self.on_state, qos_profile_sensor_data)
        self.create_timer(0.1, self.watch)

    def now(self) -> float:
        """Time [s]."""
        return 1e-9 * self.get_clock().now().nanoseconds

    def on_command(self, twist) -> None:
        """Moves the robot."""
        self.heard = self.now()
        self.order(MOVE, json.dumps({"x": twist.linear.x, "y": twist.linear.y, "z": twist.angular.z}))

    def watch(self) -> None:
        """Stops the robot, once, when no command comes any more."""
        if self.now() - self.heard > SILENCE:
            self.heard = math.inf
            self.order(STOP_MOVE, "")

    def order(self, number: int, parameter: str) -> None:
        """Sends a request."""
        request = Request()
        request.header.identity.api_id = number
        request.parameter = parameter
        self.orders.publish(request)

    def on_state(self, state) -> None:
        """Passes on place, heading and velocity, stamped when they come."""
        message = Odometry()
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id, message.child_frame_id = "odom", "base_link"
        pose, twist = message.pose.pose, message.twist.twist
        pose.position.x, pose.position.y = float(state.position[0]), float(state.position[1])
        yaw = float(state.imu_state.rpy[2])
        pose.orientation.z, pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        twist.linear.x, twist.linear.y = float(state.velocity[0]), float(state.velocity[1])
        twist.angular.z = float(state.yaw_speed)
        self.odometry.publish(message)


def main() -> None:
    """Connects until it is told to end."""
    rclpy.init(args=sys.argv)
    node = Bridge()
    try:
        with suppress(KeyboardInterrupt, ExternalShutdownException):
            rclpy.spin(node)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
