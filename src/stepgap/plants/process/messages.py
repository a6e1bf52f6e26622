"""The lines that StepGap and the program of a robot exchange: each is one JSON object.

StepGap sends                                             the program answers
`{"stepgap": 1, "state": [QUANTITY…], "command": […]}`    `{"ready": {"state": {NAME: UNIT…}, "command": {…}}}`
`{"start": true}`                                         `{"state": {NAME: NUMBER…}, …}`, and its context, as below
`{"step": NUMBER, "command": {NAME: NUMBER…}}`            `{"step": NUMBER, "next": {…}, "status": "ok", …}`
`{"stop": true}`                                          nothing; it brings the robot to rest and ends

The first line also has `"seconds"`, the duration of a step, where the robot's steps have one. A QUANTITY is
`{"name": …, "unit": …, "lower": …, "upper": …}`. An answer to a step may contain `"applied"`, the command
after all limits, and the numbers of the robot's context, each under its name. Its status is one of the names of
`StepStatus` in lower case; a step that is not `"ok"` needs no next state and ends the deployment. The program also has
to bring the robot to rest when its input ends.

Before its answer the program may send `{"step": NUMBER, "touchdown": {NAME: NUMBER…}}`, with what it has just measured
of its context, such as the height of the ground under the foot. StepGap then sends `{"step": NUMBER, "command": {…}}`
again, and that command shall act if it comes in time; the answer to the step says which did, as `"requested"`.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from stepgap.base.errors import StepGapError
from stepgap.base.json_data import LARGEST_NUMBER, is_measurement, parse_json
from stepgap.base.ranges import format_value
from stepgap.step import Array, Quantity, StepSpace, StepStatus

PROTOCOL = 1  # Version of the protocol


class ProcessFault(StepGapError):
    """The program of a robot ended, did not answer in time, or gave an invalid answer."""


class ReportedError(ProcessFault):
    """The program itself reports that its robot cannot go on."""


class Answer(NamedTuple):
    """A step as the program executed it.

    Attributes:
        next_state: NaN if the step failed; shape (n,).
        applied: The command after all limits; shape (m,).
        status: How the step ended.
        context: What was measured around the step, by name.
        requested: The command that acted, before limits; shape (m,).
    """

    next_state: Array
    applied: Array
    status: StepStatus
    context: dict[str, float]
    requested: Array


def hello(space: StepSpace, seconds: float | None = None) -> str:
    """First line to the program: version, quantities of state and command, and the duration of a step if any [s]."""

    def described(quantities: Sequence[Quantity]) -> list[dict[str, Any]]:
        return [{"name": one.name, "unit": one.unit, "lower": one.lower, "upper": one.upper} for one in quantities]

    lasting = {} if seconds is None else {"seconds": seconds}
    return _line({"stepgap": PROTOCOL, "state": described(space.state), "command": described(space.command), **lasting})


def step(number: int, command: Array, space: StepSpace) -> str:
    """Line with the command of a step."""
    return _line({"step": number, "command": dict(zip(space.command_names, command.tolist(), strict=True))})


START = '{"start": true}\n'  # Line that asks the program to release the robot
STOP = '{"stop": true}\n'  # Last line to the program


def check_ready(line: str, space: StepSpace) -> None:
    """Checks the answer to `hello`.

    Raises:
        ProcessFault: Names or units differ.
    """
    ready = _table(_parsed(line), "ready", line)
    for kind, quantities in (("state", space.state), ("command", space.command)):
        wanted = {one.name: one.unit for one in quantities}
        units = ready.get(kind)
        if units != wanted:
            needed = ", ".join(f"{name} [{unit}]" for name, unit in wanted.items())
            raise ProcessFault(f"the program has the {kind} {format_value(units)}, but the experiment needs {needed}")


def read_start(line: str, space: StepSpace) -> tuple[Array, dict[str, float]]:
    """The state in the answer to `START`, shape (n,), and what it has of the context.

    Raises:
        ProcessFault: The answer is invalid.
    """
    content = _parsed(line)
    return _numbers(content, "state", space.state_names, line), _context(content, space, line)


def read_answer(line: str, number: int, requested: Array, space: StepSpace) -> Answer:
    """The answer to `step`.

    Args:
        number: Number of the step that it must belong to.
        requested: Command that was sent last, which counts as the one that acted, and as applied, if the answer does
            not contain another one.

    Raises:
        ProcessFault: The answer is invalid.
    """
    answer = _parsed(line)
    if answer.get("step") != number:
        raise ProcessFault(f'step {number} was answered by {_quoted(line)}, which must contain "step": {number}')
    statuses = {status.label: status for status in StepStatus}
    if answer.get("status") not in list(statuses):
        raise ProcessFault(f'{_quoted(line)}: "status" must be one of {", ".join(statuses)}')
    status = statuses[answer["status"]]
    next_state = np.full(len(space.state), np.nan)
    if status == StepStatus.OK:
        next_state = _numbers(answer, "next", space.state_names, line)
    acted = _numbers(answer, "requested", space.command_names, line) if "requested" in answer else requested
    within = (space.command_lower <= acted) & (acted <= space.command_upper)
    if not within.all():
        name = space.command_names[int(np.argmin(within))]
        raise ProcessFault(f"{_quoted(line)}: requested.{name} must lie within its bounds")
    applied = _numbers(answer, "applied", space.command_names, line) if "applied" in answer else acted
    context = _context(answer, space, line, needed=status == StepStatus.OK)
    return Answer(next_state, applied, status, context=context, requested=acted)


def read_touchdown(line: str, number: int, space: StepSpace) -> dict[str, float] | None:
    """What the touchdown of a step has found, by name; None for another line.

    Raises:
        ProcessFault: The line is invalid.
    """
    content = _parsed(line)
    if "touchdown" not in content or content.get("step") != number:
        return None
    return _context(_table(content, "touchdown", line), space, line)


def _context(content: Mapping[str, Any], space: StepSpace, line: str, *, needed: bool = True) -> dict[str, float]:
    """The numbers of the robot's context in a table; if needed, all above which a state is measured."""
    for name in (quantity.above for quantity in space.state):
        if needed and name and name not in content:
            raise ProcessFault(f'{_quoted(line)}: must contain "{name}", above which a state is measured')
    context = {name: value for name in space.context_names if (value := content.get(name)) is not None}
    for name, value in context.items():
        if not is_measurement(value):
            raise ProcessFault(f'{_quoted(line)}: "{name}" must be a number within ±{LARGEST_NUMBER:g}')
    return {name: float(value) for name, value in context.items()}


def _line(content: Mapping[str, Any]) -> str:
    return json.dumps(content, ensure_ascii=False, allow_nan=False) + "\n"


def _parsed(line: str) -> dict[str, Any]:
    """The JSON object of a line; NaN and infinity are no JSON."""
    try:
        content = parse_json(line)
    except ValueError as error:
        raise ProcessFault(f"{_quoted(line)}: the answer must be one JSON object per line ({error})") from None
    if not isinstance(content, dict):
        raise ProcessFault(f"{_quoted(line)}: the answer must be a JSON object")
    if "error" in content:
        raise ReportedError(f"the program reports: {format_value(content['error'])}")
    return content


def _table(content: Mapping[str, Any], key: str, line: str) -> dict[str, Any]:
    table = content.get(key)
    if not isinstance(table, dict):
        raise ProcessFault(f'{_quoted(line)}: the answer must contain "{key}": {{…}}')
    return table


def _numbers(content: Mapping[str, Any], key: str, names: Sequence[str], line: str) -> Array:
    """The finite numbers of a table that has these names and no others."""
    table = _table(content, key, line)
    if sorted(table) != sorted(names):
        raise ProcessFault(f'{_quoted(line)}: "{key}" must contain {", ".join(names)}, and nothing else')
    for name in names:
        if not is_measurement(table[name]):
            raise ProcessFault(f"{_quoted(line)}: {key}.{name} must be a number within ±{LARGEST_NUMBER:g}")
    return np.array([table[name] for name in names], float)


def _quoted(line: str) -> str:
    """The beginning of a line in quotes, for a message."""
    return format_value(line.strip())
