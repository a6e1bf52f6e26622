"""Messages of Unitree's quadrupeds."""

from ros2_messages import message_type

SportModeState = message_type("unitree_go/msg/SportModeState")
