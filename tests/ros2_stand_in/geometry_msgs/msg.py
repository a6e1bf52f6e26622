"""Messages of geometry_msgs."""

from ros2_messages import message_type

Twist = message_type("geometry_msgs/msg/Twist")
PoseStamped = message_type("geometry_msgs/msg/PoseStamped")
TwistStamped = message_type("geometry_msgs/msg/TwistStamped")
