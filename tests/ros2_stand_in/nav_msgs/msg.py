"""Messages of nav_msgs."""

from rclpy.messages import message_type

Odometry = message_type("nav_msgs/msg/Odometry")
