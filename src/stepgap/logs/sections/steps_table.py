"""Extracted steps as a CSV file, and the file of columns with which `stepgap fit` reads it."""

import csv
from collections import Counter
from collections.abc import Iterator, Sequence
from io import StringIO
from pathlib import Path

import numpy as np

from stepgap.base.settings_file import toml_string
from stepgap.logs.columns import ROLES
from stepgap.logs.sections.section_settings import SectionSettings
from stepgap.logs.sections.step_extraction import ExtractedSteps

REFUSED = "Sections of a log that was refused"  # Title in the file of a figure, which the next figure may replace


def steps_table(logs: Sequence[ExtractedSteps]) -> str:
    """CSV text with a row for each step that is not left out.

    Columns: `log`; `step`, its number in the log, which also counts steps that are left out; `time` of the section
    where it begins; the state there, its standard errors NAME_std; the command; target_NAME; predicted_NAME; the state
    at the next section as next_NAME, with next_NAME_std; `yaw` at the beginning. Times have microseconds,
    since those of bags are seconds since 1970; all other numbers are read back without a change.
    """
    file = StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow([name for _, names in _columns(logs[0]) for name in names])
    for label, log in zip(_labels(logs), logs, strict=True):
        for number in log.kept:
            writer.writerow([label, number + 1, f"{log.sections.time[number]:.6f}", *map(_exact, _row(log, number))])
    return file.getvalue()


def _exact(value: float) -> str:
    """The shortest text from which a number is read back without a change."""
    return repr(float(value)).removesuffix(".0")


def columns_toml(log: ExtractedSteps, settings: SectionSettings) -> str:
    """TOML text of the meaning of these columns, for `stepgap fit --columns`; empty without commands and targets."""
    columns = dict(_columns(log))
    if not (columns.get("command") or columns.get("target")):
        return ""
    lines = [
        f"{role} = [{', '.join(map(toml_string, names))}]" for role, names in columns.items() if names and role in ROLES
    ]
    lines += ['deployment = "log"', *(['yaw = "yaw"'] if log.yaw is not None else [])]
    units = {name: unit for name, unit in _units(columns, settings) if unit}
    if units:
        lines += ["", "[units]"]
        lines += [f"{toml_string(name)} = {toml_string(unit)}" for name, unit in units.items()]
    return "\n".join([*lines, ""])


def _columns(log: ExtractedSteps) -> list[tuple[str, list[str]]]:
    """Names of the columns by their meaning, in their order."""
    state = log.names["state"]
    command = log.names["command"]
    taken = {"log", "step", "time", "yaw", *state, *(f"{name}_std" for name in state)}
    return [
        ("head", ["log", "step", "time"]),
        ("state", [*state]),
        ("std", [f"{name}_std" for name in state]),
        ("command", [f"command_{name}" if name in taken else name for name in command]),
        ("target", [f"target_{name}" for name in state] if "target" in log.values else []),
        ("predicted", [f"predicted_{name}" for name in state] if "predicted" in log.values else []),
        ("next", [f"next_{name}" for name in state]),
        ("next_std", [f"next_{name}_std" for name in state]),
        ("yaw", ["yaw"] if log.yaw is not None else []),
    ]


def _row(log: ExtractedSteps, number: int) -> Iterator[float]:
    sections = log.sections
    yield from sections.state[number]
    yield from sections.std[number]
    for role in ("command", "target", "predicted"):
        yield from log.values[role][number] if role in log.values else ()
    yield from sections.state[number + 1]
    yield from sections.std[number + 1]
    if log.yaw is not None:
        yield log.yaw[number]


def label_of(log: ExtractedSteps) -> str:
    """A short name for a log: that of its first file, with printable letters, and of the deployment in it.

    It is no formula where a spreadsheet opens the table.
    """
    files = log.source.removesuffix(f", {log.deployment}") if log.deployment else log.source
    name = f"{Path(files.split('+')[0].strip()).name} {log.deployment}".rstrip()
    shown = "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in name)
    return f"'{shown}" if shown.startswith(("=", "+", "-", "@")) else shown


def _labels(logs: Sequence[ExtractedSteps]) -> list[str]:
    names = [label_of(log) for log in logs]
    counts = Counter(names)
    seen = Counter[str]()
    labels: list[str] = []
    for name in names:
        seen[name] += 1
        labels.append(f"{name} ({seen[name]})" if counts[name] > 1 else name)
    return labels


def _units(columns: dict[str, list[str]], settings: SectionSettings) -> Iterator[tuple[str, str]]:
    computed = {"height": "m", "forward": "m"} if settings.boom else {}
    computed |= {"forward": "m", "left": "m", "turn": "rad"} if settings.pose else {}
    units = computed | dict(settings.units)
    for role in ("state", "command"):
        for name, coordinate in zip(columns[role], settings.coordinates(role), strict=True):
            unit = units.get(coordinate.column) or _unit_of_message(coordinate.column)
            rate = f"{unit}/s" if unit and coordinate.rate else unit
            yield name, units.get(coordinate.name, rate) if coordinate.name != coordinate.column else rate


def _unit_of_message(column: str) -> str:
    """Unit of a field of the ROS message geometry_msgs/Twist, which REP 103 fixes; empty for other columns."""
    vector, _, axis = column.rpartition(".")
    if axis not in ("x", "y", "z"):
        return ""
    units = {"linear": "m/s", "angular": "rad/s"}
    return next((unit for name, unit in units.items() if vector.endswith(name)), "")


def describe_steps(log: ExtractedSteps) -> str:
    """Lines for the user: what was found in a log, what is left out and why."""
    sections = log.sections
    kept = log.kept
    errors = ", ".join(
        f"{name} {np.nanmedian(std):.2g}" for name, std in zip(log.names["state"], sections.std.T, strict=True)
    )
    how = f"estimated within ±{1e3 * sections.window:.3g} ms" if np.isfinite(sections.window) else "mean over a step"
    lines = [
        f"{log.source}: {len(sections.time)} sections, {len(kept)} of {len(log.faults)} steps; state {how}, "
        f"median standard errors: {errors}"
    ]
    if log.clock:
        lines.append(f"  all times are {log.clock}")
    if np.isfinite(log.lag):
        lines.append(f"  the motion follows its commands by about {log.lag:.2g} s")
    for fault, count in Counter(fault for fault in log.faults if fault).most_common():
        lines.append(f"  left out: {count} × {fault}")
    for time, doubt in zip(sections.time, sections.doubts, strict=True):
        if doubt:
            lines.append(f"  doubtful section at {time:.3f} s: {doubt}")
    return "\n".join(lines)
