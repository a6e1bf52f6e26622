"""Settings from TOML and back; unknown keys, wrong types and values are refused with what would be right."""

import tomllib
from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, cast, get_args, get_origin, get_type_hints

from stepgap.base.errors import InputError
from stepgap.base.ranges import LARGEST_INTEGER, format_value

LARGEST_SETTINGS_FILE = 2**20
"""Largest file of settings that is read [bytes]."""

FORMER_NAME = "former name"
"""Metadata of a settings field that was renamed: its former name, so that the error can give the present one."""

BYTE_ORDER_MARK = "\ufeff"

Locate = Callable[[str], str]
"""Names a dotted setting as the user knows it: by its file and table, or by its option."""


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """The table of a TOML file; arguments and errors as of `read_toml_text`."""
    return read_toml_text(path, what)[1]


def read_toml_text(path: Path, what: str) -> tuple[str, dict[str, Any]]:
    """The text of a TOML file, and its table.

    Args:
        path: The file.
        what: What the file must be, with its article, for messages.

    Raises:
        InputError: The file cannot be read, is too large, is no text, or is not TOML.
    """
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_SETTINGS_FILE + 1)
        if len(content) > LARGEST_SETTINGS_FILE:
            raise InputError(f"{path}: larger than {LARGEST_SETTINGS_FILE} bytes, so it is not {what}")
        text = content.decode("utf-8").removeprefix(BYTE_ORDER_MARK)
        return text, parse_toml(text)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; give an existing TOML file") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: this is not text; {what} is a TOML file in UTF-8") from None
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{path}: not TOML: {error}") from None


def parse_toml(text: str) -> dict[str, Any]:
    """The table of a TOML text, which may begin with a byte-order mark, as some editors write it.

    Raises:
        ValueError: It is not TOML.
    """
    try:
        return tomllib.loads(text.removeprefix(BYTE_ORDER_MARK))
    except RecursionError:
        raise ValueError("its lists or tables are nested too deeply") from None


def with_table(name: str) -> str:
    """A dotted name as `[table] key`."""
    table, dot, key = name.rpartition(".")
    return f"[{table}] {key}" if dot else key


def merge(settings: Any, table: Mapping[str, Any], locate: Locate, prefix: str = "", more: Collection[str] = ()) -> Any:
    """The dataclass `settings` with the values of a TOML table, checked for names and types.

    Args:
        settings: Holds the values of keys that the table does not have.
        table: Names are those of the fields.
        locate: How messages name a key.
        prefix: Dotted name of the table, with a dot at the end.
        more: Dotted keys that the file may have, too, as suggestions for a misspelt one.

    Raises:
        InputError: Naming key and what would be right.
    """
    current = {entry.name: getattr(settings, entry.name) for entry in fields(settings)}
    values = _values(type(settings), current, table, locate, prefix, more)
    try:
        return replace(settings, **values)
    except ValueError as error:
        raise located(error, locate, prefix) from None


def build(kind: type[Any], table: Mapping[str, Any], locate: Locate, prefix: str = "") -> Any:
    """A dataclass from a TOML table; fields without a default must be in it. Arguments and errors as of `merge`."""
    required = [entry.name for entry in fields(kind) if entry.default is MISSING and entry.default_factory is MISSING]
    defaults = {entry.name: entry.default for entry in fields(kind) if is_dataclass(entry.default)}
    values = _values(kind, defaults, table, locate, prefix)
    for name in required:
        if name not in values:
            raise InputError(f"{locate(prefix + name)}: missing; it must be given")
    try:
        return kind(**values)
    except ValueError as error:
        raise located(error, locate, prefix) from None


def to_table(settings: Any) -> dict[str, Any]:
    """The TOML table of a dataclass, which `build` reads; a float is written as a float even where it is whole."""
    types = get_type_hints(type(settings))
    return {entry.name: _to_value(getattr(settings, entry.name), types[entry.name]) for entry in fields(settings)}


def _to_value(value: Any, wanted: Any) -> Any:
    if is_dataclass(value):
        return to_table(value)
    if isinstance(value, tuple):
        return [_to_value(each, get_args(wanted)[0]) for each in value]
    return float(value) if wanted is float else value


def _values(
    kind: type,
    current: Mapping[str, Any],
    table: Mapping[str, Any],
    locate: Locate,
    prefix: str,
    more: Collection[str] = (),
) -> dict[str, Any]:
    """The values of a table as the fields of a dataclass want them."""
    types = get_type_hints(kind)
    known = [entry.name for entry in fields(kind)]
    values: dict[str, Any] = {}
    for key, value in table.items():
        here, inner = locate(prefix + key), f"{prefix}{key}."
        if key not in known:
            for entry in fields(kind):
                if entry.metadata.get(FORMER_NAME) == key:
                    raise InputError(f"{here}: this key is called {entry.name} now")
            known += [name.removeprefix(prefix) for name in more if name.rpartition(".")[0] == prefix.rstrip(".")]
            raise InputError(f"{here}: unknown key; {_meant(key, known, current, prefix)}")
        wanted = types[key]
        if is_dataclass(current.get(key)):
            values[key] = merge(current[key], _as_table(value, here), locate, inner, more)
        elif is_dataclass(wanted):
            values[key] = build(cast("type", wanted), _as_table(value, here), locate, inner)
        elif get_origin(wanted) is tuple:
            values[key] = _as_list(get_args(wanted)[0], value, locate, prefix + key)
        else:
            values[key] = as_type(value, wanted, here)
    return values


def _meant(key: str, known: list[str], current: Mapping[str, Any], prefix: str) -> str:
    """The key that was probably meant, one of these or of a table here; else all that are here."""
    below = {
        entry.name: with_table(f"{prefix}{name}.{entry.name}")
        for name, inner in current.items()
        if is_dataclass(inner)
        for entry in fields(inner)
    }
    near = [below[key]] if key in below else get_close_matches(key, known, n=1)
    near = near or [below[name] for name in get_close_matches(key, below, n=1)]
    return f"did you mean {near[0]}?" if near else f"the keys here are {', '.join(known)}"


def _as_table(value: Any, here: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{here} = {format_value(value)}, but it must be a table")
    return value


def _as_list(kind: type, value: Any, locate: Locate, name: str) -> tuple[Any, ...]:
    """Strings from an array, or dataclasses from an array of tables; messages count from 1."""
    here, of_tables = locate(name), is_dataclass(kind)
    if not isinstance(value, list):
        wanted = f"tables, each headed [[{name}]]" if of_tables else "a list of strings"
        raise InputError(f"{here} = {format_value(value)}, but it must be {wanted}")
    keys = [f"{name} {number}" for number in range(1, len(value) + 1)]
    if of_tables:
        pairs = zip(keys, value, strict=True)
        return tuple(build(kind, _as_table(each, locate(at)), locate, f"{at}.") for at, each in pairs)
    return tuple(as_type(each, kind, locate(at)) for at, each in zip(keys, value, strict=True))


def located(error: ValueError, locate: Locate, prefix: str) -> InputError:
    """The error of a settings class, `key = value, but it must …`, with the key as the user knows it."""
    key, *rest = str(error).partition(" = ")
    return InputError("".join([locate(prefix + key), *rest]))


def as_type(value: Any, wanted: Any, here: str) -> Any:
    """The value, if it has the type of the field; an integer may stand for a number."""
    words = {float: "a number", int: "an integer", bool: "true or false"}
    if wanted is float and type(value) is int and abs(value) < LARGEST_INTEGER:
        return float(value)
    if type(value) is not (wanted if wanted in words else str):
        raise InputError(f"{here} = {format_value(value)}, but it must be {words.get(wanted, 'a string')}")
    return value
