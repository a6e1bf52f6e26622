"""Plug-ins by name: what this package and others offer under an entry-point group."""

from collections.abc import Callable, Iterable
from difflib import get_close_matches
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from stepgap.base.settings_file import InputError


def plugin_names(group: str) -> tuple[str, ...]:
    """Names of all installed plug-ins of a group, in alphabetical order; imports none of them."""
    return tuple(sorted(entry_points(group=group).names))


def load_plugin(group: str, kind: str, name: str, accepts: Callable[[Any], bool], wanted: str) -> Any:
    """What the entry point with a name refers to.

    Only an installed entry point is ever imported, so a file may name a plug-in without being able to run code.

    Args:
        group: Of the entry points.
        kind: What its plug-ins are, for messages, such as "rig".
        name: Of the entry point.
        accepts: Whether what it refers to can be used.
        wanted: What it must be, for the message where `accepts` is false.

    Raises:
        InputError: The name is unknown, or offered by two packages; or what it refers to cannot be imported or used.
    """
    found = entry_points(group=group, name=name)
    if not found:
        names = plugin_names(group)
        meant = suggestion(name, names)
        known = f"the {kind}s installed here are {', '.join(names)}" if names else f"no {kind} is installed here"
        raise InputError(f"{kind} '{name:.40}': unknown; {f'{meant} ' if meant else ''}{known}")
    if len({entry.value for entry in found}) > 1:
        owners = " and by ".join(sorted(map(owner, found)))
        raise InputError(f"{kind} '{name}': offered by {owners}; uninstall one of them")
    entry = next(iter(found))
    try:
        plugin = entry.load()
    except ModuleNotFoundError as error:
        raise InputError(f"{kind} '{name}' needs {error.name}: pip install {_remedy(entry, error)}") from None
    except (ImportError, AttributeError) as error:
        raise InputError(f"{kind} '{name}': {entry.value} of {owner(entry)} cannot be imported: {error}") from None
    if not accepts(plugin):
        raise InputError(f"{kind} '{name}': {entry.value} of {owner(entry)} must be {wanted}")
    return plugin


def suggestion(name: str, names: Iterable[str]) -> str:
    """The one of `names` that was probably meant, as "did you mean NAME?"; empty if none is similar."""
    close = get_close_matches(name, list(names), n=1)
    return f"did you mean {close[0]}?" if close else ""


def owner(entry: EntryPoint) -> str:
    """Name of the package that offers an entry point."""
    return entry.dist.name if entry.dist else "a package without a name"


def _remedy(entry: EntryPoint, error: ModuleNotFoundError) -> str:
    """What pip is to install: the extra that has the plug-in's name, if there is one."""
    package = entry.dist
    if package and entry.name in (package.metadata.get_all("Provides-Extra") or []):
        return f"'{package.name}[{entry.name}]'"
    return f"'{(error.name or '').partition('.')[0]}'"
