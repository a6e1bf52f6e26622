"""What a tick log contains beside its ticks: when and with what it was recorded, the meaning of numbers, and events."""

import json
import os
import platform
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from math import inf, isfinite, isnan
from typing import Any, Self

from stepgap.base.versions import versions_here

DESCRIPTION = "stepgap"  # Name of the metadata record with the description
EVENT = "event"  # Name of the metadata record of an event

Range = tuple[float, float]
"""Least and largest allowed value of a field; infinite where there is no limit."""


@dataclass(frozen=True)
class FieldMeaning:
    """Meaning of the numbers in the fields of a tick.

    Attributes:
        names: Names of the numbers of an enum, by field.
        bits: Names of the bits, by field; a number is a sum of bits.
        ranges: Limits within which a robot is not stopped, by field.
    """

    names: Mapping[str, Mapping[int, str]] = field(default_factory=dict)
    bits: Mapping[str, Mapping[int, str]] = field(default_factory=dict)
    ranges: Mapping[str, Range] = field(default_factory=dict)

    def joined(self, other: "FieldMeaning") -> "FieldMeaning":
        """The meaning of the fields of both."""
        return FieldMeaning({**self.names, **other.names}, {**self.bits, **other.bits}, {**self.ranges, **other.ranges})


@dataclass(frozen=True)
class LogDescription:
    """Description of a log.

    Attributes:
        started: UTC at which the log was opened, as ISO 8601.
        settings: Text of the file that describes the rig, empty if there is none.
        versions: Versions of the software, the kernel, the host and the user, by name.
        meaning: Meaning of the fields.
    """

    started: str = ""
    settings: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    meaning: FieldMeaning = FieldMeaning()

    @classmethod
    def here(cls, settings: str, meaning: FieldMeaning) -> Self:
        """Description of a log that this process opens now."""
        user = str(getattr(os, "getuid", lambda: "")())
        machine = {"kernel": platform.release(), "host": platform.node(), "user": user}
        return cls(_now(), settings, {**versions_here(), **machine}, meaning)

    def to_metadata(self) -> dict[str, str]:
        """The description as texts by name."""
        meaning = self.meaning
        ranges = {
            name: [float(value) if isfinite(value) else None for value in ends] for name, ends in meaning.ranges.items()
        }
        return {
            "started": self.started,
            "settings": self.settings,
            "versions": _as_json(self.versions),
            "names": _as_json(meaning.names),
            "bits": _as_json(meaning.bits),
            "ranges": _as_json(ranges),
        }

    @classmethod
    def of_metadata(cls, texts: Mapping[str, str]) -> Self:
        """Reads a description; what is missing or damaged is left out."""
        ranges = {
            name: (_number(ends[0], -inf), _number(ends[1], inf))
            for name, ends in _table(texts, "ranges").items()
            if isinstance(ends, list) and len(ends) == 2
        }
        meaning = FieldMeaning(_numbers(texts, "names"), _numbers(texts, "bits"), ranges)
        versions = {name: str(value) for name, value in _table(texts, "versions").items()}
        return cls(texts.get("started", ""), texts.get("settings", ""), versions, meaning)


@dataclass(frozen=True)
class LogEvent:
    """A message about the deployment, such as the reason of a stop.

    Attributes:
        time: Time of the latest tick in the log when it was written [s].
        utc: UTC at which it was written, as ISO 8601.
        text: The message.
    """

    time: float
    utc: str
    text: str

    @classmethod
    def now(cls, time: float, text: str) -> Self:
        """An event after the tick at a time [s]."""
        return cls(time, _now(), text)

    def to_metadata(self) -> dict[str, str]:
        """The event as texts by name."""
        return {"time": repr(self.time), "utc": self.utc, "text": self.text}

    @classmethod
    def of_metadata(cls, texts: Mapping[str, str]) -> Self:
        """Reads an event; raises ValueError if its time is not a number."""
        return cls(float(texts.get("time", "")), texts.get("utc", ""), texts.get("text", ""))


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def _as_json(content: Any) -> str:
    return json.dumps(content, ensure_ascii=False)


def _table(texts: Mapping[str, str], key: str) -> dict[str, Any]:
    """A JSON object among the texts; empty if there is none."""
    try:
        content = json.loads(texts.get(key, "{}"))
    except (ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def _numbers(texts: Mapping[str, str], key: str) -> dict[str, dict[int, str]]:
    """Names by number, by field."""
    return {
        name: {int(number): str(text) for number, text in names.items() if re.fullmatch(r"[0-9]{1,15}", number)}
        for name, names in _table(texts, key).items()
        if isinstance(names, dict)
    }


def _number(value: Any, default: float) -> float:
    """A number, or a default value for anything else."""
    return value if isinstance(value, float) and not isnan(value) else default
