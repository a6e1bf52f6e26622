"""A layout of Foxglove with a plot of every field of a tick log, one for each unit."""

import json
from collections.abc import Mapping, Sequence
from math import ceil
from typing import Any

from stepgap.plants.ticks.tick_log import TOPIC

TIME = "time"  # Field that is the time of a tick; it is the horizontal axis

Tiles = dict[str, Any] | str
"""Part of the window: the name of a panel, or a division into two parts."""


def foxglove_layout(units: Mapping[str, str]) -> str:
    """The layout as JSON, which Foxglove imports.

    Args:
        units: Units of the fields of a tick by their names.
    """
    groups: dict[str, list[str]] = {}
    for name, unit in units.items():
        if name != TIME:
            groups.setdefault(unit, []).append(name)
    panels = {f"Plot!{number}": _plot(unit, names) for number, (unit, names) in enumerate(groups.items())}
    layout = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _arranged(list(panels)),
    }
    return json.dumps(layout, indent=1, ensure_ascii=False)


def _plot(unit: str, names: Sequence[str]) -> dict[str, Any]:
    """Settings of a panel that plots fields with one unit over the time, together with the other panels."""
    series = [{"value": f"{TOPIC}.{name}", "enabled": True, "timestampMethod": "receiveTime"} for name in names]
    return {
        "title": unit or "without unit",
        "paths": series,
        "xAxisVal": "timestamp",
        "isSynced": True,
        "showLegend": True,
        "legendDisplay": "left",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showPlotValuesInLegend": True,
    }


def _arranged(panels: Sequence[str]) -> Tiles:
    """Two columns of panels of equal height; a single column if there are at most three."""
    if len(panels) <= 3:
        return _stacked(panels)
    half = ceil(len(panels) / 2)
    return {"direction": "row", "first": _stacked(panels[:half]), "second": _stacked(panels[half:])}


def _stacked(panels: Sequence[str]) -> Tiles:
    """Panels below each other, each of the same height."""
    if len(panels) == 1:
        return panels[0]
    share = 100 / len(panels)
    return {"direction": "column", "first": panels[0], "second": _stacked(panels[1:]), "splitPercentage": share}
