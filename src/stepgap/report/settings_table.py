"""Tables of settings that differ: from their defaults, or between runs."""

from collections.abc import Mapping, Sequence
from typing import Any

from stepgap.report.html import paragraph, table

DASH = "–"
"""Mark of a missing value in a table."""


def flat_settings(settings: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Values of nested tables as short texts, by their dotted names."""
    flat: dict[str, str] = {}
    for name, value in settings.items():
        if isinstance(value, Mapping):
            flat |= flat_settings(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = _format(value)
    return flat


def differing(columns: Sequence[Mapping[str, str]]) -> list[list[str]]:
    """Names and values of the settings that are not equal in all columns, in the order of their first occurrence."""
    names = list(dict.fromkeys(name for column in columns for name in column))
    rows = [[name, *(column.get(name, DASH) for column in columns)] for name in names]
    return [row for row in rows if len(set(row[1:])) > 1]


def changed_settings(settings: Mapping[str, Any], defaults: Mapping[str, Any], owner: str = "this run") -> str:
    """HTML table of the settings of a run, or of another `owner`, that differ from their defaults."""
    rows = differing([flat_settings(settings), flat_settings(defaults)])
    if not rows:
        return paragraph("All settings are the defaults.")
    return table("Settings that differ from their defaults", ["setting", owner, "default"], rows)


def _format(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_format, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return f"{value:.12g}"
    text = str(value) or "(empty)"
    return text if len(text) <= 80 else f"{text[:77]}…"
