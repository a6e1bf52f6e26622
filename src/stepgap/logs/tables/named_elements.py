"""Arrays in messages whose elements have names, such as those of joints, in an order that differs between messages.

The column `position[0]` of such a topic would be another joint from row to row, as where two programs publish their
joints on one topic, or transforms of several bodies do. Columns are then by name: `position[left_knee]`.
"""

import re
import warnings
from collections import defaultdict
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stepgap.base.errors import StepGapWarning
from stepgap.logs.tables.log_table import LogColumn

_NAMES = re.compile(r"(?P<before>(?:.*\.)?)(?:name|names|joint_name|joint_names|interface_names)\[(?P<at>\d+)\]")
"""Columns of an array of names, beside arrays of what is named: `name[0]` of `position[0]`."""

_NAME_WITHIN = re.compile(r"(?P<array>.*)\[(?P<at>\d+)\]\.(?:name|joint_name|child_frame_id)")
"""Columns of the names in an array of structs: `transforms[0].child_frame_id` of `transforms[0].transform`."""

_MOST_NAMES = 1000  # Largest number of names of one array
_DEEPEST = 3  # Number of arrays within each other


class _Named(NamedTuple):
    """An array whose elements have names.

    Attributes:
        shown: The array, for messages.
        elements: Matches the names of its columns; groups `before`, `at`, the index, and `rest`.
        names: Names of the elements by index; each of shape (R,), empty where there is none.
    """

    shown: str
    elements: re.Pattern[str]
    names: Mapping[int, NDArray[np.str_]]


def by_name(source: str, columns: Mapping[str, LogColumn], unread: dict[str, str]) -> dict[str, LogColumn]:
    """Columns of messages, where those of arrays whose names change their places are by name instead of index.

    A `StepGapWarning` names them. An array that cannot be told apart by its names is added to `unread`.
    """
    renamed = dict(columns)
    for _ in range(_DEEPEST):
        named = next(filter(_changes, _named_arrays(renamed)), None)
        if named is None:
            break
        renamed = _renamed(source, renamed, named, unread)
    return renamed


def _named_arrays(columns: Mapping[str, LogColumn]) -> list[_Named]:
    """The arrays with names, outer ones first."""
    patterns: dict[str, str] = {}
    names: defaultdict[str, dict[int, Any]] = defaultdict(dict)
    for column, values in columns.items():
        if values.dtype.kind != "U":
            continue
        if beside := _NAMES.fullmatch(column):
            shown = f"{beside['before']}name"
            patterns[shown] = rf"(?P<before>{re.escape(beside['before'])}\w+)\[(?P<at>\d+)\](?P<rest>.*)"
            names[shown][int(beside["at"])] = values
        elif within := _NAME_WITHIN.fullmatch(column):
            shown = within["array"]
            patterns[shown] = rf"(?P<before>{re.escape(within['array'])})\[(?P<at>\d+)\](?P<rest>.*)"
            names[shown][int(within["at"])] = values
    return [
        _Named(shown, re.compile(pattern), names[shown])
        for shown, pattern in sorted(patterns.items(), key=lambda one: (one[0].count("["), one[0]))
    ]


def _changes(named: _Named) -> bool:
    """Whether the element at some index does not always have the same name."""
    return any(len(set(values[values != ""].tolist())) > 1 for values in named.names.values())


def _renamed(
    source: str, columns: Mapping[str, LogColumn], named: _Named, unread: dict[str, str]
) -> dict[str, LogColumn]:
    """The columns, where those of an array are by the names of its elements."""
    matches = {column: named.elements.fullmatch(column) for column in columns}
    kept = {column: values for column, values in columns.items() if not matches[column]}
    labels = np.stack([named.names[index] for index in sorted(named.names)])
    names = sorted(set(labels[labels != ""].tolist()))
    shown = {label: re.sub(r"[^\w./-]", "_", label) for label in names}
    if why := _fault(labels, list(shown.values())):
        reason = f"the order of {named.shown} differs from message to message, and {why}"
        unread.update((match["before"], reason) for match in matches.values() if match)
        return kept
    by_field: defaultdict[tuple[str, str], dict[int, LogColumn]] = defaultdict(dict)
    for column, match in matches.items():
        if match and int(match["at"]) in named.names:
            by_field[match["before"], match["rest"]][int(match["at"])] = columns[column]
    for (before, rest), values in by_field.items():
        is_text = any(one.dtype.kind == "U" for one in values.values())
        for label in names:
            kept[f"{before}[{shown[label]}]{rest}"] = _of_label(label, named.names, values, is_text)
    example = next(name for name in kept if f"[{shown[names[0]]}]" in name)
    message = f"{source}: the order of {named.shown} differs from message to message, so columns are by name: {example}"
    warnings.warn(message, StepGapWarning, stacklevel=2)
    return kept


def _fault(labels: NDArray[np.str_], shown: list[str]) -> str:
    """Why names do not tell the elements of an array apart; empty if they do. `labels` has the shape (I, R)."""
    if len(shown) > _MOST_NAMES:
        return f"there are {len(shown)} names"
    if len(set(shown)) < len(shown):
        return "two names differ in signs that no column has"
    ordered = np.sort(labels, axis=0)
    twice = (ordered[1:] == ordered[:-1]) & (ordered[1:] != "")
    return f"a message has {str(ordered[1:][twice][0])!r:.60} twice" if twice.any() else ""


def _of_label(
    label: str, names: Mapping[int, NDArray[np.str_]], values: Mapping[int, LogColumn], is_text: bool
) -> LogColumn:
    """The values of the element with a name, in each row; missing where the message has none."""
    parts = {index: _as_text(one) if is_text else one for index, one in values.items()}
    width = max(part.dtype.itemsize for part in parts.values())
    rows = len(next(iter(parts.values())))
    chosen: Any = np.full(rows, "", f"U{width // 4}") if is_text else np.full(rows, np.nan)
    for index, part in parts.items():
        here = names[index] == label
        chosen[here] = part[here]
    return chosen


def _as_text(values: Any) -> Any:
    """Labels; those of a column without any, which is of missing numbers, are empty."""
    return values if values.dtype.kind == "U" else np.full(len(values), "", "U1")
