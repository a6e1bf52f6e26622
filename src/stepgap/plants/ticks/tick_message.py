"""One tick as an MCAP record: a Protobuf message whose fields are all `double`, and its schema.

Every number is stored exactly, also numbers that are not finite, which JSON cannot represent. All messages of a log
have the same length, so that many are encoded and parsed at once.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Self

import numpy as np
from mcap.opcode import Opcode

from stepgap.step import Array

SCHEMA_NAME = "stepgap.Tick"
CHANNEL = 1  # Number of the only channel of a log
MOST_FIELDS = 2000  # Largest number of fields in a tick; about as many Protobuf keys have two bytes or less
LATEST = 9e9  # Latest time [s]; MCAP counts nanoseconds in 64 bits

_HEAD = [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4")]
_TIMES = [("log_time", "<u8"), ("publish_time", "<u8")]
HEAD_SIZE = np.dtype(_HEAD + _TIMES).itemsize
"""Length of a message's record before its Protobuf content [bytes]."""


@dataclass(frozen=True)
class TickLayout:
    """Names and units of a tick's fields, and their layout in a message.

    Attributes:
        units: Unit of each field by its name, in the order of a row; the first is time [s].

    Raises:
        ValueError: A name has other characters than letters, digits and underscores, a unit has a comma, or there are
            too many fields.
    """

    units: Mapping[str, str]

    def __post_init__(self) -> None:
        if not 1 <= len(self.units) <= MOST_FIELDS:
            raise ValueError(f"a tick of {len(self.units)} fields; it must have 1 to {MOST_FIELDS}")
        for name, unit in self.units.items():
            if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name):
                raise ValueError(f"field {name!r:.60}: a name consists of letters, digits and underscores")
            if "," in unit:
                raise ValueError(f"field {name!r:.60}: unit {unit!r:.60} has a comma")

    @classmethod
    def of_channel(cls, metadata: Mapping[str, str]) -> Self:
        """Reads the layout from a channel's metadata; ValueError if they contain none."""
        names = metadata.get("names", "").split(",")
        units = metadata.get("units", "").split(",")
        if len(set(names)) != len(units):
            raise ValueError(f"{len(names)} names and {len(units)} units")
        return cls(dict(zip(names, units, strict=True)))

    @property
    def metadata(self) -> dict[str, str]:
        """Names and units as the channel's metadata; in two strings, since tools may change the order of metadata."""
        return {"names": ",".join(self.units), "units": ",".join(self.units.values())}

    @cached_property
    def schema(self) -> bytes:
        """The message as a Protobuf `FileDescriptorSet`, syntax proto2, fields numbered from 1."""
        optional = _number(4, 1)
        double = _number(5, 1)
        fields = b"".join(
            _content(2, _content(1, name.encode()) + _number(3, i) + optional + double)
            for i, name in enumerate(self.units, 1)
        )
        package, message = SCHEMA_NAME.split(".")
        tick = _content(4, _content(1, message.encode()) + fields)
        return _content(1, _content(1, b"stepgap/tick.proto") + _content(2, package.encode()) + tick)

    @cached_property
    def _message(self) -> np.ndarray:
        """Template of a message's record, without the values that change with each tick; structured, shape ()."""
        keys = [_varint(i << 3 | 1) for i in range(1, len(self.units) + 1)]
        pairs = ([(f"key {i}", f"<u{len(key)}"), (f"value {i}", "<f8")] for i, key in enumerate(keys))
        message = np.zeros((), [*_HEAD, *_TIMES, *chain.from_iterable(pairs)])
        message["opcode"] = Opcode.MESSAGE
        message["channel"] = CHANNEL
        message["length"] = message.itemsize - 9
        for i, key in enumerate(keys):
            message[f"key {i}"] = int.from_bytes(key, "little")
        return message

    def messages(self, rows: Array, first: int) -> np.ndarray:
        """Encodes ticks as records.

        Args:
            rows: One tick per row, the first column its time [s]; shape (k, fields).
            first: Sequence number of the first message.

        Returns:
            Structured array, shape (k,); its bytes are the records.

        Raises:
            ValueError: The shape is another one, or a time is not within 0…9e9 s.
        """
        rows = np.asarray(rows, float)
        if rows.ndim != 2 or rows.shape[1] != len(self.units):
            raise ValueError(f"ticks of shape {rows.shape}; it must be (k, {len(self.units)})")
        in_range = _in_range(rows[:, 0])
        if not in_range.all():
            raise ValueError(f"a tick at time {rows[~in_range, 0][0]} s; time must be within 0…{LATEST:g} s")
        messages = np.full(len(rows), self._message)
        messages["sequence"] = np.arange(first, first + len(rows))
        messages["log_time"] = messages["publish_time"] = _nanoseconds(rows[:, 0])
        for i, column in enumerate(rows.T):
            messages[f"value {i}"] = column
        return messages

    def parse(self, content: bytes) -> np.ndarray:
        """Parses the records at the start of `content`, up to one that is not a tick of this layout or not the next."""
        messages = np.frombuffer(content, self._message.dtype, len(content) // self._message.itemsize)
        time = messages["value 0"]
        right = _in_range(time)
        right &= messages["log_time"] == _nanoseconds(np.where(right, time, 0.0))
        right &= np.diff(messages["sequence"], prepend=messages["sequence"][:1] - np.uint32(1)) == 1
        for name in ("opcode", "length", "channel", *(f"key {i}" for i in range(len(self.units)))):
            right &= messages[name] == self._message[name]
        return messages if right.all() else messages[: right.argmin()]

    def rows(self, messages: np.ndarray) -> Array:
        """Converts records to ticks; shape (k, fields)."""
        return np.stack([messages[f"value {i}"] for i in range(len(self.units))], axis=1)


def _in_range(time: Array) -> np.ndarray:
    """Whether times [s] can be encoded."""
    return (time >= 0) & (time <= LATEST)


def _nanoseconds(time: Array) -> np.ndarray:
    return np.rint(time * 1e9).astype(np.uint64)


def _varint(number: int) -> bytes:
    """Encodes an integer for Protobuf, seven bits per byte."""
    *more, last = [number >> shift & 127 for shift in range(0, max(1, number.bit_length()), 7)]
    return bytes([*(bits | 128 for bits in more), last])


def _number(field: int, number: int) -> bytes:
    """Encodes a Protobuf field that is an integer."""
    return _varint(field << 3) + _varint(number)


def _content(field: int, content: bytes) -> bytes:
    """Encodes a Protobuf field that is a string or a message."""
    return _varint(field << 3 | 2) + _varint(len(content)) + content
