"""Tables from messages, each a tree of named values: those of topics, and lines of JSON."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, final

import numpy as np

from stepgap.logs.tables.damaged_text import warn_of_cut
from stepgap.logs.tables.files import cause_of
from stepgap.logs.tables.log_table import MISSING, MOST_ELEMENTS, MOST_NUMBERS, LogColumn, LogTable, check_size
from stepgap.logs.tables.named_elements import by_name
from stepgap.records.steps_csv import RecordError

_STAMPS = ({"sec", "nanosec"}, {"sec", "nsec"}, {"secs", "nsecs"}, {"seconds", "nanos"})
"""Names of the parts of a time, in seconds and nanoseconds."""

Cell = float | str

Decoder = Callable[[bytes], Any]
"""Gives the content of a message as a tree; it raises an error if the message is not one of its type."""


def flattened(value: Any, name: str = "") -> Iterator[tuple[str, Cell | Sequence[Any]]]:
    """Yields the numbers and labels in a message with their names, as in pose.position[0]; a time in seconds.

    Sequences that are too long to become columns are yielded as they are.
    """
    if isinstance(value, Mapping):
        if set(value) in _STAMPS and all(isinstance(part, int) for part in value.values()):
            seconds, nanoseconds = (value[key] for key in sorted(value, reverse=True))
            yield name or "stamp", seconds + nanoseconds * 1e-9
            return
        for key, part in value.items():
            yield from flattened(part, f"{name}.{key}" if name else str(key))
    elif isinstance(value, str):
        yield name, value
    elif isinstance(value, bool | int | float | np.number | np.bool_):
        yield name, _as_float(value)
    elif isinstance(value, Sequence) and not isinstance(value, bytes | bytearray):
        if len(value) > MOST_ELEMENTS:
            yield name, value
            return
        for index, part in enumerate(value):
            yield from flattened(part, f"{name}[{index}]")


def row_of_message(time: int, tree: Any) -> Iterator[tuple[str, Cell | Sequence[Any]]]:
    """Yields the time at which a message was logged [ns] as `log_time` [s], and the values in the message."""
    yield "log_time", time * 1e-9
    yield from ((name, value) for name, value in flattened(tree) if name != "log_time")


def too_long(length: int) -> str:
    """Why an array in a row is no column."""
    return f"{length} elements; at most {MOST_ELEMENTS} become columns"


def unreadable(reason: str) -> Decoder:
    """A decoder of messages that cannot be read."""

    def refuse(_: bytes) -> Any:
        raise ValueError(reason)

    return refuse


@final
class MessageRows:
    """Columns that grow by a row at a time; a name that comes later has missing values before."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._columns: dict[str, list[Cell | None]] = {}
        self._lines: list[int] = []
        self._unread: dict[str, str] = {}

    def append(self, cells: Iterator[tuple[str, Cell | Sequence[Any]]], line: int = 0) -> None:
        """Adds a row.

        Raises:
            RecordError: There are too many values.
        """
        row = len(self._lines)
        for name, value in cells:
            if not isinstance(value, float | int | str):
                self._unread[name] = too_long(len(value))
                continue
            column = self._columns.setdefault(name, [])
            column.extend([None] * (row - len(column)))
            column.append(value)
        self._lines.append(line)
        check_size(self._source, len(self._columns) * len(self._lines))

    def table(self, has_lines: bool) -> LogTable:
        """The table of all rows."""
        columns = {
            name: _values(cells + [None] * (len(self._lines) - len(cells))) for name, cells in self._columns.items()
        }
        kept = {name: values for name, values in columns.items() if values is not None}
        named = by_name(self._source, kept, self._unread)
        lines = np.array(self._lines, np.intp) if has_lines else None
        return LogTable(self._source, named, lines, unread=self._unread)


@final
class TopicRows:
    """Rows of the topics of a log, which grow message by message.

    A topic is left out if a message of it does not fit its definition: its numbers would be wrong.
    """

    def __init__(self, source: str) -> None:
        self.count = 0  # number of messages
        self._source = source
        self._rows: dict[str, MessageRows] = {}
        self._decoders: dict[str, Decoder] = {}
        self._faults: dict[str, str] = {}

    def append(self, topic: str, time: int, data: bytes, decoders: Sequence[Decoder]) -> None:
        """Adds a message logged at a time [ns]; the topic has the first of the decoders that its first message fits."""
        self.count += 1
        if topic in self._faults:
            return
        if topic not in self._decoders:
            self._decoders[topic] = next((one for one in decoders if _fits(data, one)), decoders[0])
            self._rows[topic] = MessageRows(f"{self._source}, {topic}")
        try:
            tree = self._decoders[topic](data)
        except Exception as error:
            self._faults[topic] = cause_of(error)
            del self._rows[topic]
        else:
            self._rows[topic].append(row_of_message(time, tree))

    def tables(self, unread: dict[str, str]) -> dict[str, LogTable]:
        """The tables of the topics; those that are left out are added to `unread`."""
        unread.update(self._faults)
        return {topic: rows.table(has_lines=False) for topic, rows in self._rows.items()}


def _fits(data: bytes, decode: Decoder) -> bool:
    try:
        decode(data)
    except Exception:
        return False
    return True


def _values(cells: list[Cell | None]) -> LogColumn | None:
    """Numbers, NaN where one is missing; labels if a cell is text that does not mean a missing number."""
    if any(isinstance(cell, str) and cell.lower() not in MISSING for cell in cells):
        labels = ["" if cell is None else str(cell) for cell in cells]
        return np.array(labels, np.str_) if max(map(len, labels)) * len(labels) <= MOST_NUMBERS else None
    return np.array([cell if isinstance(cell, float) else np.nan for cell in cells], float)


def _as_float(value: Any) -> float:
    try:
        return float(value)
    except OverflowError:
        return float("inf")


def read_json_lines(text: str, source: str) -> LogTable:
    """The numbers and labels of objects; nested values have names as in imu.acc[0].

    Raises:
        RecordError: A line is no JSON object, or has a key twice.
    """
    rows = MessageRows(source)
    lines = text.split("\n")
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            value = json.loads(line, parse_constant=lambda _: None, object_pairs_hook=_unrepeated)
        except (ValueError, RecursionError) as error:
            if 1 < number == len(lines) and isinstance(error, json.JSONDecodeError):
                warn_of_cut(source, number, line)
                break
            right = 'it must be one JSON object, such as {"v": 0.5}'
            raise RecordError(f"{source}, line {number}: {error!s:.100}; {right}") from None
        if not isinstance(value, dict):
            raise RecordError(f'{source}, line {number}: not an object; it must be one, such as {{"v": 0.5}}')
        try:
            rows.append(flattened(value), number)
        except RecursionError:
            raise RecordError(f"{source}, line {number}: nested too deeply") from None
    return rows.table(has_lines=True)


def _unrepeated(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        raise ValueError("a key occurs twice")
    return table
