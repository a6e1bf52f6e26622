"""Message types by their published definitions, with default values as those of rclpy have."""

from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)


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
    if number.name == "ARRAY":
        return np.zeros(description[1])
    base = description[0]
    return "" if base == "string" else 1.0 if (owner, field) == ("geometry_msgs/msg/Quaternion", "w") else 0


def as_bytes(message: Any) -> bytes:
    """The message in CDR."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def from_bytes(data: bytes, kind: Any) -> Any:
    """A message of a type."""
    return STORE.deserialize_cdr(data, kind.__msgtype__)
