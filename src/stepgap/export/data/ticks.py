"""Ticks of a run as MCAP files, which Foxglove and PlotJuggler open."""

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

from stepgap.base.files import new_file, new_folder
from stepgap.plants.ticks.tick_log import TickLog, TickLogError, read_ticks, recover_ticks
from stepgap.plants.ticks.tick_table import TickTable


def write_ticks(ticks: TickTable, out: Path) -> None:
    """Writes ticks into a new file.

    Raises:
        TickLogError: The file exists or cannot be written.
    """
    with new_file(out) as partial, TickLog(partial, ticks.units) as log:
        log.append(ticks.rows)


def copy_ticks(logs: Path, out: Path) -> Iterator[str]:
    """Copies the tick logs of a rig's run, or their intact parts, into a new folder; yields a message for each.

    Raises:
        OSError: A file cannot be read or written.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    with new_folder(out) as partial:
        for log in sorted(logs.glob("*.mcap")):
            try:
                read_ticks(log)
            except TickLogError:
                yield _recovered(log, partial / log.name, out)
            else:
                shutil.copyfile(log, partial / log.name)
                yield str(out / log.name)


def logged_units(logs: Path) -> Mapping[str, str]:
    """Units of the fields, by their names, in the first tick log of a folder that can be read.

    Raises:
        TickLogError: No tick log can be read.
    """
    *others, last = sorted(logs.glob("*.mcap"))
    for log in others:
        try:
            return read_ticks(log)[0]
        except TickLogError:
            continue
    return read_ticks(last)[0]


def _recovered(log: Path, copy: Path, out: Path) -> str:
    try:
        ticks, faults = recover_ticks(log, copy)
    except TickLogError as error:
        return f"left out: {error}"
    return f"{out / copy.name} ({ticks} ticks recovered: {'; '.join(faults)})"
