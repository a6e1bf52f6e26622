"""Utilities."""

from rclpy.arguments import without_ros


def remove_ros_args(args: list[str]) -> list[str]:
    """The words of a command line that are not for ROS."""
    return without_ros(args)[0]
