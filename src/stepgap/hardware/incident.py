"""An incident in the tick log of a rig: what happened before the stop, which limits were near, when torque was off."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from math import inf, isfinite
from pathlib import Path

import numpy as np

from stepgap.hardware.ethercat.cia402 import INTERNAL_LIMIT, STATUSWORD_UNIT, WARNING, state_of
from stepgap.plants.ticks.log_description import LogDescription, LogEvent, Range
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_log import TickLogError, read_description, read_intact_ticks
from stepgap.plants.ticks.tick_table import TickTable

AFTERWARDS = 0.5  # Time after the incident that is shown [s]
MOST_LINES = 60  # Largest number of changes that are listed


@dataclass(frozen=True)
class Occurrence:
    """Something that happened.

    Attributes:
        time: When [s].
        text: What.
    """

    time: float
    text: str


@dataclass(frozen=True, eq=False)
class Incident:
    """The end of a deployment in a tick log.

    Attributes:
        path: The log.
        ticks: All its ticks.
        description: Its description; empty in a log of an earlier version.
        events: Its events.
        damage: Faults of the file, as of a process that was killed.
        fault: Whether the robot was stopped by a fault: a tick is in the state FAULT, or none came after one in which
            the robot stood or hopped.
        time: Time of the first tick in FAULT, else of the last one [s].
        begin: Beginning of the part that is shown [s].
    """

    path: Path
    ticks: TickTable
    description: LogDescription
    events: list[LogEvent]
    damage: tuple[str, ...]
    fault: bool
    time: float
    begin: float

    @property
    def shown(self) -> TickTable:
        """The ticks about the incident."""
        time = self.ticks["time"]
        return TickTable(self.ticks.units, self.ticks.rows[(time >= self.begin) & (time <= self.time + AFTERWARDS)])


def read_incident(path: Path, seconds: float) -> Incident:
    """Reads the incident in a log, of which some seconds before it are shown.

    Raises:
        TickLogError: The file is not the log of a rig, or it has no ticks.
    """
    units, rows, damage = read_intact_ticks(path)
    if "state" not in units:
        raise TickLogError(f"{path}: has no field 'state'; give a log of stepgap run or rig dry-run on a rig")
    if not len(rows):
        raise TickLogError(f"{path}: contains no ticks")
    description, events = read_description(path)
    ticks = TickTable(units, rows)
    states = ticks["state"]
    faults = np.flatnonzero(states == RigState.FAULT)
    time = float(ticks["time"][faults[0] if len(faults) else -1])
    fault = bool(len(faults)) or states[-1] in (RigState.STAND, RigState.STEP)
    return Incident(path, ticks, description, events, damage, fault, time, time - seconds)


def utc_of(incident: Incident, time: float) -> str:
    """UTC of a time in the log, from its first event, to some 0.1 s; empty if the log has none."""
    for event in incident.events:
        try:
            utc = datetime.fromisoformat(event.utc).astimezone(UTC) + timedelta(seconds=time - event.time)
            return utc.replace(tzinfo=None).isoformat(" ", "milliseconds")
        except (ValueError, OverflowError):
            continue
    return ""


def namers_of(incident: Incident) -> dict[str, Callable[[int], str]]:
    """For each field whose numbers have names, the function that gives them; status words are decoded."""
    namers: dict[str, Callable[[int], str]] = {
        field: _described_word for field, unit in incident.ticks.units.items() if unit == STATUSWORD_UNIT
    }
    names = {"state": {state.value: state.name for state in RigState}, **incident.description.meaning.names}
    for field in incident.ticks.units.keys() & names:
        namers[field] = lambda number, texts=names[field]: texts.get(number, str(number))
    return {field: namers[field] for field in incident.ticks.units if field in namers}


def _described_word(word: int) -> str:
    """State, warning and internal limit in a status word (CiA 402-2, object 0x6041)."""
    marks = [text for bit, text in ((WARNING, "warning"), (INTERNAL_LIMIT, "internal limit")) if word & bit]
    return ", ".join([state_of(word).value, *marks])


def changes_of(incident: Incident) -> list[Occurrence]:
    """Changes of states, names, reasons and status words, and the events, in the order of their times."""
    shown = incident.shown
    changes = list[Occurrence]()
    for field, name in namers_of(incident).items():
        changes += _renamed(shown, field, name)
    for field, names in incident.description.meaning.bits.items():
        changes += _first_bits(shown, field, names) if field in shown.units else []
    changes += [
        Occurrence(event.time, f"message: {event.text}") for event in incident.events if event.time >= incident.begin
    ]
    changes += _lateness(incident)
    return sorted(changes, key=lambda change: change.time)


def bit_numbers(ticks: TickTable, field: str) -> np.ndarray:
    """A field whose bits have names, as integers; 0 where it has no value."""
    return np.clip(np.nan_to_num(ticks[field]), 0, 2.0**53).astype(np.int64)


def _renamed(ticks: TickTable, field: str, name: Callable[[int], str]) -> list[Occurrence]:
    has_value = np.isfinite(ticks[field])
    time = ticks["time"][has_value]
    texts = [name(int(value)) for value in ticks[field][has_value]]
    return [
        Occurrence(float(time[i]), f"{field}: {texts[i - 1]} → {texts[i]}")
        for i in range(1, len(texts))
        if texts[i] != texts[i - 1]
    ]


def _first_bits(ticks: TickTable, field: str, names: Mapping[int, str]) -> list[Occurrence]:
    time = ticks["time"]
    numbers = bit_numbers(ticks, field)
    return [
        Occurrence(
            float(time[at[0]]), f"{field}: {text.lower().replace('_', ' ')}, in {len(at)} tick{'s' * (len(at) > 1)}"
        )
        for bit, text in names.items()
        if bit and len(at := np.flatnonzero(numbers & bit))
    ]


def _lateness(incident: Incident) -> list[Occurrence]:
    """Ticks that were late by half a tick or more."""
    shown = incident.shown
    if "late" not in shown.units or len(shown) < 2:
        return []
    time = shown["time"]
    late = shown["late"]
    tick = float(np.median(np.diff(incident.ticks["time"])))
    return [Occurrence(float(time[i]), f"late by {1e3 * late[i]:.2f} ms") for i in np.flatnonzero(late >= tick / 2)]


@dataclass(frozen=True)
class Margin:
    """How near a field came to its limits until the incident.

    Attributes:
        field: Its name.
        unit: Its unit.
        least: Smallest value.
        most: Largest value.
        limits: The limits.
    """

    field: str
    unit: str
    least: float
    most: float
    limits: Range

    @property
    def used(self) -> float:
        """Largest part of the way from the middle of the range, or from zero, to a limit; more than 1 is beyond it."""
        low, high = self.limits
        if isfinite(low) and isfinite(high):
            middle = (low + high) / 2
            half = (high - low) / 2
            return max(self.most - middle, middle - self.least) / half if half > 0 else inf
        if isfinite(high):
            return self.most / high if high > 0 else inf
        return self.least / low if isfinite(low) and low < 0 else 0.0


def margins_of(incident: Incident) -> list[Margin]:
    """Fields with limits, the nearest to its limit first."""
    margins = list[Margin]()
    shown = incident.shown
    before = shown["time"] <= incident.time
    for field, limits in incident.description.meaning.ranges.items():
        if field in incident.ticks.units and (limits[0] > -inf or limits[1] < inf):
            values = shown[field][before]
            values = values[np.isfinite(values)]
            if len(values):
                unit = incident.ticks.units[field]
                margins.append(Margin(field, unit, float(values.min()), float(values.max()), limits))
    return sorted(margins, key=lambda margin: -margin.used)


def torque_fields(ticks: TickTable) -> list[str]:
    """Names of the fields with torques that were applied."""
    return [field for field in ticks.units if field.startswith("applied")]


def reaction_of(incident: Incident) -> tuple[float, float] | None:
    """Time until all torques were zero [s], infinite if the log does not show it, and the largest torque meanwhile.

    None if there is no fault or no torque in the log. After a tick without values the rig has switched torque off.
    """
    fields = torque_fields(incident.ticks)
    time = incident.ticks["time"]
    if not incident.fault or not fields:
        return None
    first = int(np.searchsorted(time, incident.time))
    torques = np.abs(np.column_stack([incident.ticks[field] for field in fields]))[first:]
    off = np.flatnonzero(~(torques > 0).any(axis=1))
    if not len(off):
        return inf, float(torques.max())
    return float(time[first + off[0]] - time[first]), float(np.nanmax(torques[: off[0]], initial=0.0))


def describe_incident(incident: Incident) -> str:
    """Describes the incident in lines of text."""
    description = incident.description
    ticks = incident.ticks
    versions = ", ".join(f"{name} {version}" for name, version in description.versions.items())
    lines = [f"{incident.path}: {len(ticks)} ticks, {ticks['time'][-1]:.3f} s"]
    lines += [f"recorded with {versions}"] if versions else []
    lines += [f"damaged: {fault}" for fault in incident.damage]
    utc = utc_of(incident, incident.time)
    last = int(ticks["state"][-1])
    ends = f"the log ends in the state {RigState(last).name if last in set(RigState) else last}"
    what = "no fault; the log ends"
    if incident.fault:
        what = "fault" if last == RigState.FAULT else f"fault: {ends}"
    lines.append(f"{what} at {incident.time:.3f} s{f', {utc} UTC' if utc else ''}")
    changes = changes_of(incident)
    lines += ["", f"{'time':>9}  change"]
    lines += [f"{1e3 * (change.time - incident.time):+7.0f} ms  {change.text}" for change in changes[-MOST_LINES:]]
    if len(changes) > MOST_LINES:
        lines.append(f"({len(changes) - MOST_LINES} earlier changes are not listed; choose smaller --seconds)")
    lines += ["", *_margin_lines(incident)]
    if reaction := reaction_of(incident):
        after, most = reaction
        when = f"{1e3 * after:.0f} ms after the fault" if isfinite(after) else "not until the end of the log"
        lines += ["", f"torque was off {when}; largest torque from the fault on {most:.2f} N·m"]
    return "\n".join(lines)


def _margin_lines(incident: Incident) -> list[str]:
    """A table of the margins, or a line that says why there is none."""
    margins = margins_of(incident)
    if not margins:
        return ["limits: the log contains none"]
    head = f"{'limited field':18} {'least':>9} {'most':>9}   {'limits':22} used"
    return [head, *map(_margin_line, margins)]


def _margin_line(margin: Margin) -> str:
    low, high = margin.limits
    limits = f"{'' if low == -inf else f'{low:g}'} … {'' if high == inf else f'{high:g}'} {margin.unit}"
    beyond = "  beyond" if margin.used > 1 else ""
    return f"{margin.field:18} {margin.least:9.4g} {margin.most:9.4g}   {limits:22} {100 * margin.used:3.0f} %{beyond}"
