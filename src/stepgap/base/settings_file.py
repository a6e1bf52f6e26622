"""Settings from TOML and back; errors about unknown keys, types and values state what is valid."""

import tomllib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, cast, get_args, get_origin, get_type_hints

import tomli_w

from stepgap.base.errors import InputError
from stepgap.base.files import read_bounded_text
from stepgap.base.plugins import suggestion
from stepgap.base.ranges import LARGEST_INTEGER, format_value

LARGEST_SETTINGS_FILE = 2**20  # Largest file of settings that is read [bytes]

FORMER_NAME = "former name"
"""Metadata key of a renamed settings field: its value is the former name, for which the error gives the present one."""

IS_KEY = "is a key"
"""Metadata key of a settings field: False if the field is not a key of the table, and has other ways into the file."""

_ITEMS = {float: "numbers", int: "integers"}  # What a list contains, for messages; strings if it is not here

BYTE_ORDER_MARK = "\ufeff"

Locate = Callable[[str], str]
"""Converts a dotted name of a setting to the form for messages: its file and table, or its option."""


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Reads the table of a TOML file; arguments and errors are those of `read_toml_text`."""
    return read_toml_text(path, what)[1]


def read_toml_text(path: Path, what: str) -> tuple[str, dict[str, Any]]:
    """Reads a TOML file: returns its text and its table; messages call the file `what`, with an article.

    Raises:
        InputError: The file cannot be read, is too large, is not text, or is not TOML.
    """
    try:
        text = read_bounded_text(path, LARGEST_SETTINGS_FILE)
        return text, parse_toml(text)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; give an existing TOML file") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: this is not text; {what} is a TOML file in UTF-8") from None
    except InputError as error:
        raise InputError(f"{error}; {what} is a TOML file in UTF-8") from None
    except ValueError as error:
        raise InputError(f"{path}: not TOML: {error}") from None


def parse_toml(text: str) -> dict[str, Any]:
    """Parses TOML, which may begin with a byte-order mark, as some editors write it.

    Raises:
        ValueError: It is not TOML.
    """
    try:
        return tomllib.loads(text.removeprefix(BYTE_ORDER_MARK))
    except RecursionError:
        raise ValueError("its lists or tables are nested too deeply") from None


def check_keys(table: Mapping[str, Any], keys: Sequence[str], where: str) -> None:
    """Raises InputError if a table has a key that is none of `keys`; `where`, such as file and table, precedes it."""
    for key in table:
        if key not in keys:
            meant = suggestion(key, keys) or f"the keys here are {', '.join(keys)}"
            raise InputError(f"{where}{key}: unknown key; {meant}")


def inner_table(table: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    """The table under a key, empty if there is none; raises InputError for another value, named as by `check_keys`."""
    return _as_table(table.get(key, {}), f"{where}{key}")


def toml_string(text: str) -> str:
    """A text as a quoted string of TOML; also a key that has any characters."""
    return tomli_w.dumps({"x": text}).removeprefix("x = ").rstrip("\n")


def toml_line(key: str, value: Any) -> str:
    """A key with its value in one line of TOML, also a list."""
    if isinstance(value, list | tuple):
        return f"{key} = [{', '.join(toml_line('x', item).removeprefix('x = ') for item in value)}]"
    return tomli_w.dumps({key: value}).rstrip("\n")


def with_table(name: str) -> str:
    """Formats a dotted name as `[table] key`."""
    table, dot, key = name.rpartition(".")
    return f"[{table}] {key}" if dot else key


def merge(settings: Any, table: Mapping[str, Any], locate: Locate, prefix: str = "", more: Collection[str] = ()) -> Any:
    """Returns the dataclass `settings` with the values of a TOML table, whose names and types are checked.

    Args:
        settings: Values of the keys that the table does not have.
        table: Its keys are names of the fields.
        locate: How messages name a key.
        prefix: Dotted name of the table, with a dot at the end.
        more: Other dotted keys that the file may have, as suggestions for a misspelt one.

    Raises:
        InputError: The message names the key and states what is valid.
    """
    return merge_all((settings,), table, locate, prefix, more)[0]


def merge_all(
    parts: Sequence[Any], table: Mapping[str, Any], locate: Locate, prefix: str = "", more: Collection[str] = ()
) -> list[Any]:
    """As `merge` for several dataclasses, the fields of which are keys of one table."""
    entries = {entry.name: entry for part in parts for entry in _settable(part)}
    current = {entry.name: getattr(part, entry.name) for part in parts for entry in _settable(part)}
    types = {name: wanted for part in parts for name, wanted in get_type_hints(type(part)).items()}
    values = _values(entries, types, current, table, locate, prefix, more)
    merged = []
    for part in parts:
        mine = {entry.name: values[entry.name] for entry in _settable(part) if entry.name in values}
        try:
            merged.append(replace(part, **mine))
        except ValueError as error:
            raise located(error, locate, prefix) from None
    return merged


def _settable(settings: Any) -> list[Field[Any]]:
    """Fields that are keys of a table."""
    return [entry for entry in fields(settings) if entry.metadata.get(IS_KEY, True)]


def build(kind: type[Any], table: Mapping[str, Any], locate: Locate, prefix: str = "") -> Any:
    """Builds a dataclass from a TOML table, which must have all fields without a default; otherwise as `merge`."""
    defaults = {entry.name: entry.default for entry in fields(kind) if is_dataclass(entry.default)}
    entries = {entry.name: entry for entry in fields(kind)}
    values = _values(entries, get_type_hints(kind), defaults, table, locate, prefix)
    for name, entry in entries.items():
        if name not in values and entry.default is MISSING and entry.default_factory is MISSING:
            raise InputError(f"{locate(prefix + name)}: missing; it must be given")
    try:
        return kind(**values)
    except ValueError as error:
        raise located(error, locate, prefix) from None


def build_from_file(kind: type[Any], path: Path, what: str) -> Any:
    """Builds a dataclass from a TOML file, as `build` does from its table; messages call the file `what`.

    Raises:
        InputError: The file cannot be read, or a setting is wrong; the message names file, key and rule.
    """
    return build(kind, read_toml(path, what), lambda name: f"{path}: {with_table(name)}")


def to_table(settings: Any) -> dict[str, Any]:
    """Converts a dataclass to a TOML table, which `build` reads; an integral float remains a float."""
    types = get_type_hints(type(settings))
    return {entry.name: _to_value(getattr(settings, entry.name), types[entry.name]) for entry in _settable(settings)}


def _to_value(value: Any, wanted: Any) -> Any:
    if is_dataclass(value):
        return to_table(value)
    if isinstance(value, Mapping):
        return {name: _to_value(item, get_args(wanted)[1]) for name, item in value.items()}
    if isinstance(value, tuple):
        return [_to_value(item, get_args(wanted)[0]) for item in value]
    return float(value) if wanted is float else value


def _values(
    entries: Mapping[str, Field[Any]],
    types: Mapping[str, Any],
    current: Mapping[str, Any],
    table: Mapping[str, Any],
    locate: Locate,
    prefix: str,
    more: Collection[str] = (),
) -> dict[str, Any]:
    """Converts the values of a table to the types of the fields."""
    keys = list(entries)
    values: dict[str, Any] = {}
    for key, value in table.items():
        here = locate(prefix + key)
        inner = f"{prefix}{key}."
        if key not in keys:
            for entry in entries.values():
                if entry.metadata.get(FORMER_NAME) == key:
                    raise InputError(f"{here}: this key is called {entry.name} now")
            keys += [name.removeprefix(prefix) for name in more if name.rpartition(".")[0] == prefix.rstrip(".")]
            raise InputError(f"{here}: unknown key; {_meant(key, keys, current, prefix)}")
        wanted = types[key]
        if is_dataclass(current.get(key)):
            values[key] = merge(current[key], _as_table(value, here), locate, inner, more)
        elif is_dataclass(wanted):
            values[key] = build(cast("type", wanted), _as_table(value, here), locate, inner)
        elif get_origin(wanted) is Mapping:
            kind = get_args(wanted)[1]
            given = _as_table(value, here).items()
            values[key] = current[key] | {name: as_type(item, kind, locate(inner + name)) for name, item in given}
        elif get_origin(wanted) is tuple:
            values[key] = _as_list(get_args(wanted)[0], value, locate, prefix + key)
        else:
            values[key] = as_type(value, wanted, here)
    return values


def _meant(key: str, keys: list[str], current: Mapping[str, Any], prefix: str) -> str:
    """Suggestion for an unknown key: a similar key here or in a table below; else all keys here."""
    below = {
        entry.name: with_table(f"{prefix}{name}.{entry.name}")
        for name, inner in current.items()
        if is_dataclass(inner)
        for entry in fields(inner)
    }
    near = [below[key]] if key in below else get_close_matches(key, keys, n=1)
    near = near or [below[name] for name in get_close_matches(key, below, n=1)]
    return f"did you mean {near[0]}?" if near else f"the keys here are {', '.join(keys)}"


def _as_table(value: Any, here: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{here} = {format_value(value)}, but it must be a table")
    return value


def _as_list(kind: type, value: Any, locate: Locate, name: str) -> tuple[Any, ...]:
    """Converts an array to strings or numbers, or an array of tables to dataclasses; messages count from 1."""
    here = locate(name)
    of_tables = is_dataclass(kind)
    if not isinstance(value, list):
        wanted = f"tables, each headed [[{name}]]" if of_tables else f"a list of {_ITEMS.get(kind, 'strings')}"
        raise InputError(f"{here} = {format_value(value)}, but it must be {wanted}")
    keys = [f"{name} {number}" for number in range(1, len(value) + 1)]
    if of_tables:
        pairs = zip(keys, value, strict=True)
        return tuple(build(kind, _as_table(item, locate(at)), locate, f"{at}.") for at, item in pairs)
    return tuple(as_type(item, kind, locate(at)) for at, item in zip(keys, value, strict=True))


def located(error: ValueError, locate: Locate, prefix: str) -> InputError:
    """Converts an error of a settings class, `key = value, but it must …`, with the key in the form for messages."""
    key, *rest = str(error).partition(" = ")
    return InputError("".join([locate(prefix + key), *rest]))


def as_type(value: Any, wanted: Any, here: str) -> Any:
    """Returns the value if it has the type of the field; an integer is converted to a float."""
    descriptions = {float: "a number", int: "an integer", bool: "true or false"}
    if wanted is float and type(value) is int and abs(value) < LARGEST_INTEGER:
        return float(value)
    if type(value) is not (wanted if wanted in descriptions else str) or value != value:
        raise InputError(f"{here} = {format_value(value)}, but it must be {descriptions.get(wanted, 'a string')}")
    return value
