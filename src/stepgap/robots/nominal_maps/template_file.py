"""Templates in TOML: a step, and rough derivatives of the next state, by the names of state and command.

    step.state = { speed = 0.2, height = 0.58 }
    step.command = { fx = 0.0, fy = 0.0 }
    step.next_state = { speed = 0.2, height = 0.58 }

    [derivatives.speed]  # of the next speed by …
    speed = 0.2
    fx = 0.01

    [derivatives.height]
    height = 0.5
    fy = 0.002

A derivative that is not given is zero. Without `step`, the middle of the ranges of use is a limit cycle.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.ranges import format_value
from stepgap.base.settings_file import check_keys, inner_table, read_toml
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.step import Array, StepSpace

_STEP = ("state", "command", "next_state")


def read_template(path: Path, space: StepSpace) -> AffineMap:
    """Reads a template.

    Raises:
        InputError: The file is wrong; the message names the key and what would be right.
    """
    table = read_toml(path, "a template")
    check_keys(table, ("step", "derivatives"), f"{path}: ")
    step = inner_table(table, "step", f"{path}: ")
    derivatives = inner_table(table, "derivatives", f"{path}: ")
    check_keys(step, _STEP, f"{path}: [step] ")
    state = _numbers(step, "state", space.state_names, space.state_centre, f"{path}: [step] ")
    command = _numbers(step, "command", space.command_names, space.command_centre, f"{path}: [step] ")
    next_state = _numbers(step, "next_state", space.state_names, state, f"{path}: [step] ")
    check_keys(derivatives, space.state_names, f"{path}: [derivatives] ")
    inputs = space.names
    rows = [
        _numbers(derivatives, name, inputs, np.zeros(len(inputs)), f"{path}: [derivatives] ")
        for name in space.state_names
    ]
    matrix = np.array(rows)
    if not matrix[:, len(space.state) :].any():
        raise InputError(f"{path}: [derivatives]: none by a command; give at least one, or no command has an effect")
    return AffineMap(space, state, command, next_state, matrix)


def gaps_of_template(path: Path, template: AffineMap) -> tuple[str, ...]:
    """A sentence for each state coordinate that no command of a template changes."""
    space = template.space
    return tuple(
        f"{path}: [derivatives.{name}] has none by a command, so no command changes {name} on this "
        f"map; give a rough derivative by {' or '.join(space.command_names)}"
        for name, row in zip(space.state_names, template.matrix[:, len(space.state) :], strict=True)
        if not row.any()
    )


def _numbers(table: Mapping[str, Any], key: str, names: Sequence[str], defaults: Array, where: str) -> Array:
    """Numbers of an inner table by name, in the order of the names; a missing one has its default value."""
    given = inner_table(table, key, where)
    check_keys(given, names, f"{where}{key}.")
    for name, value in given.items():
        if type(value) not in (int, float) or not np.isfinite(float(value)):
            raise InputError(f"{where}{key}.{name} = {format_value(value)}, but it must be a finite number")
    return np.array([float(given.get(name, default)) for name, default in zip(names, defaults, strict=True)])
