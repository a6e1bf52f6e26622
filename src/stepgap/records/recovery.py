"""Recovers the intact part of truncated or damaged files: `steps.csv`, and logs of ticks."""

from pathlib import Path

from mcap.writer import MCAP0_MAGIC

from stepgap.base.errors import InputError
from stepgap.base.files import naming
from stepgap.plants.ticks.tick_log import TickLogError, recover_ticks
from stepgap.records.steps_csv import recover_steps, space_of_header, text_of


def recover_file(path: Path, out: Path) -> list[str]:
    """Writes the intact part of a file into a new one; the file itself is not changed.

    Returns:
        Messages: what is wrong with the file, and how much was recovered.

    Raises:
        InputError: Nothing can be recovered, or `out` exists or cannot be written.
    """
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: this is no file; give a steps.csv or an .mcap file")
    try:
        return _recover_ticks(path, out) if _is_tick_log(path) else _recover_steps(path, out)
    except FileExistsError:
        raise InputError(f"{out}: exists already; choose another --out") from None
    except OSError as error:
        raise InputError(f"{error.filename or path}: {error.strerror}") from None
    except (ValueError, TickLogError) as error:
        raise InputError(str(error)) from None


def _is_tick_log(path: Path) -> bool:
    with path.open("rb") as file:
        return path.suffix == ".mcap" or file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC


def _recover_ticks(path: Path, out: Path) -> list[str]:
    ticks, faults = recover_ticks(path, out)
    return [*(f"{path}: {fault}" for fault in faults), _counted(ticks, "tick", bool(faults))]


def _recover_steps(path: Path, out: Path) -> list[str]:
    steps, fault = recover_steps(path, space_of_header(path))
    if not len(steps):
        raise InputError(f"{path}: no whole step in it")
    with naming(out), out.open("x", encoding="utf-8") as file:
        file.write(text_of(steps))
    return [*([fault] if fault else []), _counted(len(steps), "step", bool(fault))]


def _counted(count: int, what: str, broken: bool) -> str:
    return (
        f"{count} {what}{'' if count == 1 else 's'} {'recovered' if broken else 'copied: nothing is wrong with them'}"
    )
