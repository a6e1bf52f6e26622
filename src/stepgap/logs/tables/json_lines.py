"""JSON lines: one object a line."""

import json
from typing import Any

from stepgap.logs.tables.log_table import LogTable
from stepgap.logs.tables.messages import MessageRows, flattened
from stepgap.records.steps_csv import RecordError


def read_json_lines(text: str, source: str) -> LogTable:
    """The numbers and labels of objects; nested values have names as in imu.acc[0].

    Raises:
        RecordError: A line is no JSON object, or has a key twice.
    """
    rows = MessageRows(source)
    for number, line in enumerate(text.split("\n"), 1):
        if not line.strip():
            continue
        try:
            value = json.loads(line, parse_constant=lambda _: None, object_pairs_hook=_unrepeated)
        except (ValueError, RecursionError) as error:
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
