"""Steps as text for any program: a table with one line of names, and a second table with the meanings of the names."""

import csv
from collections.abc import Iterable, Sequence
from io import StringIO

from stepgap.records.export.columns import Column


def steps_text(columns: Sequence[Column]) -> str:
    """One line of names, then a line for each step; numbers are read back to the last bit."""
    rows = zip(*(column.values.tolist() for column in columns), strict=True)
    return _text([[column.name for column in columns], *rows])


def columns_text(columns: Sequence[Column]) -> str:
    """Name, unit and meaning of each column, a line each."""
    return _text([["column", "unit", "meaning"], *([each.name, each.unit, each.meaning] for each in columns)])


def _text(rows: Iterable[Iterable[object]]) -> str:
    stream = StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue()
