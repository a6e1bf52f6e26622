"""Message types by their published definitions, with default values as those of rclpy have."""

from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)

UNITREE = {
    "unitree_api/msg/Request": "RequestHeader header\nstring parameter\nuint8[] binary",
    "unitree_api/msg/RequestHeader": "RequestIdentity identity\nRequestLease lease\nRequestPolicy policy",
    "unitree_api/msg/RequestIdentity": "int64 id\nint64 api_id",
    "unitree_api/msg/RequestLease": "int64 id",
    "unitree_api/msg/RequestPolicy": "int32 priority\nbool noreply",
    "unitree_go/msg/SportModeState": """TimeSpec stamp
uint32 error_code
IMUState imu_state
uint8 mode
float32 progress
uint8 gait_type
float32 foot_raise_height
float32[3] position
float32 body_height
float32[3] velocity
float32 yaw_speed
float32[4] range_obstacle
int16[4] foot_force
float32[12] foot_position_body
float32[12] foot_speed_body""",
    "unitree_go/msg/TimeSpec": "int32 sec\nuint32 nanosec",
    "unitree_go/msg/IMUState": """float32[4] quaternion
float32[3] gyroscope
float32[3] accelerometer
float32[3] rpy
int8 temperature""",
}
"""Definitions of messages as unitree_ros2 has them."""

for type_name, text in UNITREE.items():
    STORE.register(get_types_from_msg(text, type_name))


@cache
def message_type(name: str) -> type:
    """A type whose fields have defaults: zero, the quaternion w = 1, and an empty text."""

    def init(self: Any, **given: Any) -> None:
        for field, kind in STORE.fielddefs[name][1]:
            value = given[field] if field in given else default(name, field, kind)
            setattr(self, field, value)

    return type(name.rpartition("/")[2], (STORE.types[name],), {"__init__": init, "__msgtype__": name})


def default(owner: str, field: str, kind: tuple[Any, Any]) -> Any:
    """Default of a field, by the kind of its definition."""
    number, description = kind
    if number.name == "NAME":
        return message_type(description)()
    if number.name in ("ARRAY", "SEQUENCE"):
        (_, (element, _)), size = description
        return np.zeros(size if number.name == "ARRAY" else 0, element)
    base = description[0]
    return "" if base == "string" else 1.0 if (owner, field) == ("geometry_msgs/msg/Quaternion", "w") else 0


def as_bytes(message: Any) -> bytes:
    """The message in CDR."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def from_bytes(data: bytes, kind: Any) -> Any:
    """A message of a type."""
    return STORE.deserialize_cdr(data, kind.__msgtype__)
