"""Recovery of the intact part of truncated or damaged files: `steps.csv` and tick logs."""

from pathlib import Path

from mcap.writer import MCAP0_MAGIC

from stepgap.base.errors import InputError
from stepgap.base.files import naming
from stepgap.plants.ticks.tick_log import TickLogError, recover_ticks
from stepgap.records.steps_csv import recover_steps, space_of_header, text_of


def recover_file(path: Path, out: Path) -> list[str]:
    """Writes the intact part of a file into a new one; the file itself is not changed.

    Returns:
        Messages that describe the faults of the file and the number of recovered items.

    Raises:
        InputError: Nothing can be recovered, or `out` exists or cannot be written.
    """
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: not a file; give a steps.csv or an .mcap file")
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
        raise InputError(f"{path}: it contains no complete step")
    with naming(out), out.open("x", encoding="utf-8") as file:
        file.write(text_of(steps))
    return [*([fault] if fault else []), _counted(len(steps), "step", bool(fault))]


def _counted(count: int, noun: str, broken: bool) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'} {'recovered' if broken else 'copied: the file has no fault'}"
