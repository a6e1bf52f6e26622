"""Messages of Unitree's requests."""

from ros2_messages import message_type

Request = message_type("unitree_api/msg/Request")
