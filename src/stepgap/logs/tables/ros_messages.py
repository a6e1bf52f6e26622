"""Messages of ROS 1 and ROS 2, decoded by interpreting their definitions.

rosbags parses the definitions. It would also compile Python code made from them; a log should not lead to code that
runs. The interpreter of mcap-ros2-support knows neither ROS 1 nor IDL, reads negative durations as large ones, and does
not say whether a message fits its definition.
"""

import re
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stepgap.logs.tables.files import library
from stepgap.logs.tables.messages import MOST_ELEMENTS, Decoder, unreadable

_NUMBERS = {
    "bool": "?",
    "byte": "b",
    "char": "B",
    "octet": "B",
    **{f"int{bits}": code for bits, code in ((8, "b"), (16, "h"), (32, "i"), (64, "q"))},
    **{f"uint{bits}": code for bits, code in ((8, "B"), (16, "H"), (32, "I"), (64, "Q"))},
    "float32": "f",
    "float64": "d",
}
"""Codes of `struct` for the basic types."""

_LANGUAGES = (("cdr", "ros2msg"), ("cdr", "ros2idl"), ("ros1", "ros1msg"))
"""Encodings of messages, each with a language of their definitions."""

_RULE = re.compile(r"^=+[ \t]*$", re.MULTILINE)
"""Line between the definitions of a message and of the types in it."""

_IDL_HEADER = re.compile(r"^(=+|IDL: .*)$", re.MULTILINE)

_DEEPEST = 50


def ros_decoders(path: Path, encoding: str, name: str, definition: str, form: str, release: str = "") -> list[Decoder]:
    """The functions that may decode messages of a type.

    Args:
        path: The file, for messages.
        encoding: That of the messages, cdr or ros1.
        name: Name of the type.
        definition: Its definition; an empty one is that of a type without fields, or missing.
        form: Language of the definition; one that is not of `_LANGUAGES` is none.
        release: Release of ROS 2 that recorded the log. If the definition is or may be missing, those of the release
            follow; of all releases, the newest first, if it is not known.
    """
    if (encoding, form) not in _LANGUAGES:
        return _standard_decoders(path, name, release)
    typesys = library("rosbags.typesys", path)
    text = definition.replace("\r\n", "\n")
    try:
        if form == "ros2idl":
            types = typesys.get_types_from_idl(_IDL_HEADER.sub("", text))
        else:
            types = typesys.get_types_from_msg(_RULE.sub("=" * 80, text), name)
    except Exception:
        return [unreadable(f"the definition of {name:.80} cannot be read")]
    decoders = [_decoder(path, name, types, cdr=encoding == "cdr")]
    if encoding == "cdr" and not text.strip():
        decoders += _standard_decoders(path, name, release)
    return decoders


def _standard_decoders(path: Path, name: str, release: str) -> list[Decoder]:
    """By the definitions in ROS 2 of a type which the log does not define."""
    typesys = library("rosbags.typesys", path)
    releases = {one.value.removeprefix("ros2_"): one for one in reversed(typesys.Stores) if one.name.startswith("ROS2")}
    chosen = [releases[release]] if release in releases else list(releases.values())
    definitions = [typesys.get_typestore(store).fielddefs for store in chosen]
    normal = library("rosbags.typesys.msg", path).normalize_msgtype(name)
    decoders = [_decoder(path, name, types) for types in definitions if normal in types]
    return decoders or [unreadable(f"no definition of {normal:.80} in the log")]


def _decoder(path: Path, name: str, types: Mapping[str, Any], cdr: bool = True) -> Decoder:
    """The function that decodes messages of a type, by definitions that rosbags parsed, in CDR or as of ROS 1."""
    node = library("rosbags.interfaces", path).Nodetype
    kind = node.NAME, library("rosbags.typesys.msg", path).normalize_msgtype(name)
    return lambda data: _Message(data, types, node, cdr).whole(kind)


class _Message:
    """Reads the bytes of a message from its begin to its end."""

    def __init__(self, data: bytes, types: Mapping[str, Any], node: Any, cdr: bool) -> None:
        self._data = data
        self._types = types
        self._node = node
        self._cdr = cdr
        self._offset = 0
        self._order = "<"
        if cdr:
            if len(data) < 4 or data[0] or data[1] > 1:
                raise ValueError(f"not in the plain CDR of ROS 2, but with the header {data[:4].hex() or 'missing'}")
            self._data = data[4:]
            self._order = "<" if data[1] else ">"

    def whole(self, kind: Any) -> Any:
        """The value of the type; all bytes must belong to it, but CDR may be padded to four bytes."""
        value = self._read(kind, 0)
        left = len(self._data) - self._offset
        if left and not (self._cdr and left == -self._offset % 4):
            raise ValueError(f"a message of {left} bytes more than the definition of {kind[1]} has")
        return value

    def _read(self, kind: Any, depth: int) -> Any:
        if depth > _DEEPEST:
            raise ValueError("a definition that is nested too deeply")
        tag, inner = kind
        if tag == self._node.BASE:
            return self._text() if inner[0] == "string" else self._numbers(self._code(inner[0]), 1)[0]
        if tag == self._node.NAME:
            return self._fields(inner, depth)
        element, count = inner
        if tag == self._node.SEQUENCE:
            (count,) = self._numbers("I", 1)
        if element[0] == self._node.BASE and element[1][0] != "string":
            return self._numbers(self._code(element[1][0]), count)
        if count > len(self._data):
            raise ValueError("an array longer than its message")
        return [self._read(element, depth + 1) for _ in range(count)]

    def _code(self, name: str) -> str:
        if name not in _NUMBERS:
            raise ValueError(f"a value of type {name}, which is not read")
        return "B" if self._cdr and name == "byte" else _NUMBERS[name]

    def _fields(self, name: str, depth: int) -> dict[str, Any]:
        if name not in self._types and name in ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"):
            seconds, nanoseconds = self._numbers("I" if name.endswith("Time") and not self._cdr else "i", 2)
            return {"sec": seconds, "nanosec": nanoseconds}
        if name not in self._types:
            raise ValueError(f"no definition of {name:.80} in the log")
        fields = self._types[name][1]
        if not fields and self._cdr:
            self._numbers("B", 1)  # a type without fields has a byte
        return {field: self._read(kind, depth + 1) for field, kind in fields}

    def _numbers(self, code: str, count: int) -> Sequence[Any]:
        width = struct.calcsize("<" + code)
        if self._cdr and count:
            self._offset += -self._offset % width
        start = self._offset
        self._offset += width * count
        if self._offset > len(self._data):
            raise ValueError("a message that is shorter than its definition")
        if count > MOST_ELEMENTS:
            return range(count)  # only its length matters: it does not become columns
        return struct.unpack_from(f"{self._order}{count}{code}", self._data, start)

    def _text(self) -> str:
        (length,) = self._numbers("I", 1)
        start = self._offset
        self._offset = self._offset + length
        if self._offset > len(self._data):
            raise ValueError("a message that is shorter than its definition")
        return self._data[start : self._offset].decode("utf-8", "replace").removesuffix("\0")
