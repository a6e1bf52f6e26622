"""The figure of `stepgap rig incident`: all fields of the log about the incident, by unit, with limits and states."""

from collections.abc import Callable, Mapping
from functools import partial
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from stepgap.hardware.incident import Incident, bit_numbers, namers_of
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.report.drawing import BLACK, BLUE, GREY, LIGHT, SKY, VERMILLION, plain
from stepgap.step import Array

CURVES = (BLUE, VERMILLION, BLACK, SKY, GREY)  # Colours of the fields in a panel
NEAR = 0.5  # Part of a limit from which on it is drawn


def incident_picture(incident: Incident, form: str) -> bytes:
    """Draws the incident as pdf, png or svg."""
    shown = incident.shown
    namers = namers_of(incident)
    bits = incident.description.meaning.bits
    drawn: list[tuple[float, Callable[[Any], None]]] = [
        (0.6, partial(_draw_names, time=_time(incident), ticks=shown, field=field, name=name))
        for field, name in sorted(namers.items(), key=lambda item: item[0] != "state")
    ]
    drawn += [
        (0.9, partial(_draw_bits, time=_time(incident), ticks=shown, field=field, names=names))
        for field, names in bits.items()
        if field in shown.units and bit_numbers(shown, field).any()
    ]
    numbers = [field for field in shown.units if field not in {"time", *namers, *bits}]
    drawn += [(1.2, partial(_draw_fields, incident=incident, fields=fields)) for fields in _by_unit(shown, numbers)]
    figure = Figure(figsize=(11, 1.0 + sum(height for height, _ in drawn)), layout="constrained")
    heights = [height for height, _ in drawn]
    panels = figure.subplots(len(drawn), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0].tolist()
    for panel, (_, draw) in zip(panels, drawn, strict=True):
        draw(panel)
    for panel in panels:
        panel.axvline(0, color=VERMILLION, linewidth=0.8, linestyle="--")
        panel.spines[["top", "right"]].set_visible(False)
    panels[-1].set_xlabel(f"Time after {'the fault' if incident.fault else 'the last tick'} [ms]")
    figure.suptitle(plain(f"{incident.path.name}, {incident.time:.3f} s"), x=0.01, ha="left", fontsize=9)
    picture = BytesIO()
    figure.savefig(picture, format=form, dpi=110)
    return picture.getvalue()


def _time(incident: Incident) -> Array:
    """Times of the shown ticks after the incident [ms]."""
    return 1e3 * (incident.shown["time"] - incident.time)


def _by_unit(ticks: TickTable, fields: list[str]) -> list[list[str]]:
    """Fields with the same unit, in the order of the first of them; durations come last."""
    units = sorted(dict.fromkeys(ticks.units[field] for field in fields), key=lambda unit: unit == "s")
    return [[field for field in fields if ticks.units[field] == unit] for unit in units]


def _draw_names(panel: Any, time: Array, ticks: TickTable, field: str, name: Callable[[int], str]) -> None:
    has_value = np.isfinite(ticks[field])
    texts = [name(int(number)) for number in ticks[field][has_value]]
    rows = list(dict.fromkeys(name(int(number)) for number in np.unique(ticks[field][has_value])))
    panel.step(time[has_value], [rows.index(text) for text in texts], where="post", color=BLACK)
    panel.set_yticks(range(len(rows)), [plain(text) for text in rows], fontsize=7)
    panel.set_ylabel(plain(field), rotation=0, ha="right", va="center")
    panel.set_ylim(-0.4, max(0.4, len(rows) - 0.6))


def _draw_bits(panel: Any, time: Array, ticks: TickTable, field: str, names: Mapping[int, str]) -> None:
    values = bit_numbers(ticks, field)
    raised = [(bit, name) for bit, name in names.items() if bit and (values & bit).any()]
    for row, (bit, _) in enumerate(raised):
        at = time[(values & bit) > 0]
        panel.plot(at, np.full(len(at), row), color=BLUE, linestyle="", marker="|", markersize=7)
    panel.set_yticks(range(len(raised)), [plain(name.lower().replace("_", " ")) for _, name in raised], fontsize=7)
    panel.set_ylim(-0.6, max(0.6, len(raised) - 0.4))
    panel.set_ylabel(plain(field), rotation=0, ha="right", va="center")


def _draw_fields(panel: Any, incident: Incident, fields: list[str]) -> None:
    """Fields with the same unit, and their limits if they come near; counts from their first value on."""
    shown = incident.shown
    unit = incident.ticks.units[fields[0]]
    time = _time(incident)
    for number, field in enumerate(fields):
        values = shown[field]
        colour = CURVES[number % len(CURVES)]
        measured = values[np.isfinite(values)]
        offset = measured[0] if unit == "counts" and len(measured) else 0.0
        panel.plot(time, values - offset, color=colour, linewidth=0.9, label=plain(field))
        for limit in incident.description.meaning.ranges.get(field, ()):
            if np.isfinite(limit) and limit and (measured / limit >= NEAR).any():
                panel.axhline(limit, color=colour, linewidth=0.7, linestyle=":")
    panel.set_ylabel(plain(f"[{'counts from start' if unit == 'counts' else unit or 'number'}]"))
    panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=7)
    panel.grid(color=LIGHT, linewidth=0.3)
