"""Messages."""

from ros2_messages import message_type

String = message_type("std_msgs/msg/String")
