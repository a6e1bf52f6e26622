"""Plug-ins by name: the entry points of a group, of this package and of others."""

import sys
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from functools import cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from typing import Any

from stepgap.base.errors import InputError


def plugin_names(group: str) -> tuple[str, ...]:
    """Names of all installed plug-ins of a group, in alphabetical order; imports none of them."""
    return tuple(sorted(_entries(group, tuple(sys.path)).names))


@cache
def _entries(group: str, path: tuple[str, ...]) -> EntryPoints:
    """The plug-ins of a group on a search path; to find them takes 10 ms, and settings and models need them often."""
    return entry_points(group=group)


def load_plugin(group: str, kind: str, name: str, accepts: Callable[[Any], bool], wanted: str) -> Any:
    """Loads the object that an entry point refers to.

    Only installed entry points are imported, so a file that names a plug-in cannot run other code.

    Args:
        kind: Kind of its plug-ins for messages, such as "rig".
        accepts: Whether the object is valid.
        wanted: Description of a valid object, for the message where `accepts` is false.

    Raises:
        InputError: The name is unknown, or offered by two packages; or the object cannot be imported or is not valid.
    """
    entries = _entries(group, tuple(sys.path)).select(name=name)
    if not entries:
        names = plugin_names(group)
        meant = suggestion(name, names)
        choices = f"the {kind}s installed here are {', '.join(names)}" if names else f"no {kind} is installed here"
        raise InputError(f"{kind} '{name:.40}': unknown; {f'{meant} ' if meant else ''}{choices}")
    if len({entry.value for entry in entries}) > 1:
        owners = " and by ".join(sorted(map(owner, entries)))
        raise InputError(f"{kind} '{name}': offered by {owners}; uninstall one of them")
    entry = next(iter(entries))
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


def one_of(given: object, choices: Iterable[str]) -> str:
    """The valid names, and the one of them that was probably meant, for the message about another one."""
    names = tuple(choices)
    close = get_close_matches(str(given), names, n=1)
    return " or ".join(f"'{name}'" for name in names) + (f"; did you mean '{close[0]}'?" if close else "")


def owner(entry: EntryPoint) -> str:
    """Name of the package that offers an entry point."""
    return entry.dist.name if entry.dist else "a package without a name"


def _remedy(entry: EntryPoint, error: ModuleNotFoundError) -> str:
    """Argument of `pip install`: the extra with the plug-in's name, if there is one, else the missing package."""
    package = entry.dist
    if package and entry.name in (package.metadata.get_all("Provides-Extra") or []):
        return f"'{package.name}[{entry.name}]'"
    return f"'{(error.name or '').partition('.')[0]}'"
