"""Steps as CSV text: a table with one line of names, and a second table with the meanings of the names."""

import csv
from collections.abc import Iterable, Sequence
from io import StringIO

from stepgap.records.step_columns import Column


def steps_text(columns: Sequence[Column]) -> str:
    """Table with a line of names and a line for each step; numbers can be read back without loss."""
    rows = zip(*(column.values.tolist() for column in columns), strict=True)
    return _text([[column.name for column in columns], *rows])


def columns_text(columns: Sequence[Column]) -> str:
    """Table with name, unit and meaning of each column, one line per column."""
    return _text([["column", "unit", "meaning"], *([column.name, column.unit, column.meaning] for column in columns)])


def _text(rows: Iterable[Iterable[object]]) -> str:
    stream = StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue()
