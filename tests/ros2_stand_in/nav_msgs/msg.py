"""Messages of nav_msgs."""

from ros2_messages import message_type

Odometry = message_type("nav_msgs/msg/Odometry")
