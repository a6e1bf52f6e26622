"""Rigs by name: those of this package and of others, found by their entry points."""

from pathlib import Path

from stepgap.base.errors import InputError
from stepgap.base.plugins import load_plugin, plugin_names
from stepgap.rigs.rig import Rig

GROUP = "stepgap.rigs"  # Entry points of this group are callables (settings file, robot) → `Rig`


def rig_names() -> tuple[str, ...]:
    """Names of all installed rigs, in alphabetical order."""
    return plugin_names(GROUP)


def load_rig(name: str, settings: Path, robot: object) -> Rig:
    """Creates a rig by its name, not yet connected.

    Args:
        name: Name of its entry point.
        settings: File that describes the rig; the rig reads it.
        robot: Robot that the rig is expected to be.

    Raises:
        InputError: There is no such rig, a package that it needs is not installed, it is not a rig, or its settings are
            not valid.
    """
    make = load_plugin(GROUP, "rig", name, callable, "callable with (settings, robot)")
    rig = make(settings, robot)
    if not isinstance(rig, Rig):
        raise InputError(f"rig '{name}': its entry point must return a stepgap Rig, not {type(rig).__name__}")
    return rig
