"""Every setting with its meaning: the docstrings of the settings classes as comments in TOML, and as a page."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from textwrap import wrap
from typing import Any, get_type_hints

import tomli_w
from docstring_parser import DocstringStyle, parse, parse_from_object

from stepgap.base.ranges import format_value
from stepgap.base.settings_file import IS_KEY
from stepgap.experiment.settings import METHODS, Experiment, experiment_table, preset_names
from stepgap.robots.entry_points import load_robot
from stepgap.robots.gap import Gap, differences

COMMENT_WIDTH = 100  # Longest line of a comment

_KEY = re.compile(r"(\w+) = ")
_HEADER = re.compile(r"\[+([\w.]+)\]+")


@cache
def meanings(settings: type) -> Mapping[str, str]:
    """Text on each attribute in the docstring of a class and of those that it extends, in one line each.

    Of a `Gap`, it is the docstring below the field, with the value without gap.
    """
    texts: dict[str, str] = {}
    for kind in reversed(settings.__mro__):
        style = DocstringStyle.GOOGLE
        text = parse_from_object(kind, style) if issubclass(kind, Gap) else parse(kind.__doc__ or "", style)
        texts |= {entry.arg_name: " ".join((entry.description or "").split()) for entry in text.params}
    for name, difference in differences(settings).items() if issubclass(settings, Gap) else ():
        if name in texts and difference.exact is not None:
            texts[name] += f" No gap: {format_value(difference.exact)}."
    return texts


def experiment_toml(experiment: Experiment) -> str:
    """The TOML file of an experiment, with the meaning of every setting as a comment."""
    texts = {name: text for name, text, _ in described_settings(experiment)}
    lines = []
    table = ""
    for line in tomli_w.dumps(experiment_table(experiment)).splitlines():
        key = _KEY.match(line)
        header = _HEADER.match(line)
        name = ""
        if header:
            name = header[1]
            table = f"{name}."
        elif key:
            name = table + key[1]
        lines += [*(f"# {part}" for part in wrap(texts.get(name, ""), COMMENT_WIDTH)), line]
    return "\n".join([*lines, ""])


def described_settings(experiment: Experiment) -> Iterator[tuple[str, str, Any]]:
    """Yields dotted name, meaning and value of every setting and table, in the order of the file; None for a table."""
    yield "robot", "Name of the robot.", experiment.robot.name
    sets = "sets the tables learning and control, and nominal.linear, before their keys. It is not in the file."
    yield "method", f"{', '.join(METHODS)}: {sets}", None
    for owner in (experiment, experiment.robot):
        yield from _described(owner, "")
    for name, presets in preset_names(experiment.robot).items():
        text = f"{', '.join(presets)}: sets all keys of this table, before the others. It is not in the file."
        yield f"{name}.preset", text, None


def settings_page(robots: tuple[str, ...]) -> str:
    """Page with the settings of an experiment with each of these robots, in Markdown."""
    experiments = [Experiment(load_robot(name)) for name in robots]
    common = {"robot", "method", *(name for name, _, _ in _described(experiments[0], ""))}
    printed = dict[tuple[str, str], str]()
    parts = [_PAGE_HEAD, *_tables(experiments[0], common, {})]
    for experiment in experiments:
        named = {name for name, _, _ in described_settings(experiment)} - common
        parts += [f"## Robot {experiment.robot.name}\n", *_tables(experiment, named, printed)]
    return "\n".join(parts)


_PAGE_HEAD = """# Settings

All settings of an experiment, with their default values. They are in `experiment.toml` of every run, with the same
texts, and `stepgap settings` prints them. On the command line, a setting has the name of its table and its own:
`stepgap run --learning.residual linear --gap.ground_slope 0.002`. Units are in brackets.

This page is written by `./go python docs/settings_page.py`.

## Every robot
"""


def _tables(experiment: Experiment, names: set[str], printed: dict[tuple[str, str], str]) -> list[str]:
    """The tables of settings with these names.

    Args:
        names: Dotted names.
        printed: Name of the robot at which each name and meaning is on the page already; those of this robot are added.
    """
    robot = experiment.robot.name
    tables: dict[str, list[str]] = {}
    heads: dict[str, str] = {}
    owners: dict[str, set[str]] = {}
    for name, text, value in described_settings(experiment):
        if name not in names:
            continue
        table, _, key = name.rpartition(".")
        if value is None and key != "preset" and name != "method":
            heads[name] = text
            continue
        shown = f"`{_in_toml(value)}`" if value is not None else ""
        owner = printed.setdefault((name, text), robot)
        owners.setdefault(table, set()).add(printed.setdefault((name, f"{shown} {text}"), robot))
        meaning = text.replace("|", chr(92) + "|") if owner == robot else f"as of {owner}"
        tables.setdefault(table, []).append(f"| `{key}` | {shown} | {meaning} |")
    lines = []
    for table, rows in tables.items():
        same = owners[table] - {robot}
        if len(owners[table]) == len(same) == 1:
            lines.append(f"### `[{table}]`\n\nAs of {same.pop()}, with the same defaults.\n")
            continue
        lines += [f"### `[{table}]`\n\n{heads.get(table, '')}\n"] if table else []
        lines += ["| setting | default | meaning |\n|---|---|---|", *rows, ""]
    return lines


def _described(settings: Any, prefix: str) -> Iterator[tuple[str, str, Any]]:
    """Yields dotted name, meaning and value of every setting of a dataclass and of the tables in it."""
    texts = meanings(type(settings))
    types = get_type_hints(type(settings))
    entries = [entry for entry in fields(settings) if entry.metadata.get(IS_KEY, True)]
    tables = [entry for entry in entries if is_dataclass(getattr(settings, entry.name))]
    for entry in (*(entry for entry in entries if entry not in tables), *tables):
        name = prefix + entry.name
        value = getattr(settings, entry.name)
        if entry in tables:
            yield name, texts.get(entry.name, ""), None
            yield from _described(value, f"{name}.")
        else:
            shown = float(value) if types[entry.name] is float else value
            yield name, texts.get(entry.name, ""), list(shown) if isinstance(shown, tuple) else shown


def _in_toml(value: Any) -> str:
    return tomli_w.dumps({"x": value})[4:].strip() if value != {} else "{}"
