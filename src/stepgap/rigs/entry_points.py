"""Rigs by name: those of this package and of others, found by their entry points."""

from difflib import get_close_matches
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from stepgap.base.settings_file import InputError
from stepgap.rigs.rig import Rig

GROUP = "stepgap.rigs"
"""Entry points of this group are callables (settings file, robot) → `Rig`."""


def rig_names() -> tuple[str, ...]:
    """Names of all installed rigs, in alphabetical order."""
    return tuple(sorted(entry_points(group=GROUP).names))


def load_rig(name: str, settings: Path, robot: object) -> Rig:
    """The rig with a name, not yet connected.

    Args:
        name: Of its entry point.
        settings: File that describes the rig; the rig reads it.
        robot: The robot the rig is taken to be.

    Raises:
        InputError: There is no such rig, what it needs is not installed, it is none, or its settings are not right.
    """
    make = _maker(name)
    rig = make(settings, robot)
    if not isinstance(rig, Rig):
        raise InputError(f"rig '{name}': its entry point must return a stepgap Rig, not {type(rig).__name__}")
    return rig


def _maker(name: str) -> Any:
    """What the entry point names."""
    found = entry_points(group=GROUP, name=name)
    if not found:
        raise InputError(f"rig '{name}': unknown; {_hint(name)}")
    if len({entry.value for entry in found}) > 1:
        raise InputError(
            f"rig '{name}': offered by {' and by '.join(sorted(map(_owner, found)))}; uninstall one of them"
        )
    entry = next(iter(found))
    try:
        make = entry.load()
    except ModuleNotFoundError as error:
        raise InputError(f"rig '{name}' needs {error.name}: pip install {_remedy(entry, error)}") from None
    except (ImportError, AttributeError) as error:
        raise InputError(f"rig '{name}': {entry.value} of {_owner(entry)} cannot be imported: {error}") from None
    if not callable(make):
        raise InputError(f"rig '{name}': {entry.value} of {_owner(entry)} must be callable with (settings, robot)")
    return make


def _hint(name: str) -> str:
    names = rig_names()
    close = get_close_matches(name, names, n=1)
    known = f"the rigs installed here are {', '.join(names)}" if names else "no rig is installed here"
    return f"did you mean {close[0]}? {known}" if close else known


def _remedy(entry: EntryPoint, error: ModuleNotFoundError) -> str:
    """What pip is to install: the extra that has the rig's name, if there is one."""
    package = entry.dist
    if package and entry.name in (package.metadata.get_all("Provides-Extra") or []):
        return f"'{package.name}[{entry.name}]'"
    return f"'{(error.name or '').partition('.')[0]}'"


def _owner(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist else "a package without a name"
