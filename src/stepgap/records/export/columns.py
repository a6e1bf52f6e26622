"""The steps of a run as columns with units and meanings."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stepgap.base.errors import InputError
from stepgap.learning.step_log import column_names, values_of
from stepgap.records.run_folder import RunRecord
from stepgap.robots.hopper.parameters import CommandBounds
from stepgap.step import Quantity, StepSpace

PLACES = {
    "": "state at the apex before the step",
    "target_": "state wanted after the step",
    "next_": "state after the step, as measured; NaN after a fall",
    "predicted_": "state after the step as predicted when it began; NaN where no command was known",
    "std_": "standard deviation of that prediction",
}
"""What a prefix says of a state coordinate."""

COMMANDS = {"": "command asked", "applied_": "command the joints received, which learning uses"}
"""What a prefix says of a command coordinate."""


@dataclass(frozen=True, eq=False)
class Column:
    """One column of `steps.csv`.

    Attributes:
        name: As in its header.
        unit: SI; empty for numbers that count and for words.
        meaning: In words.
        values: One for each step: whole numbers, numbers, or words; shape (N,).
    """

    name: str
    unit: str
    meaning: str
    values: np.ndarray


def step_columns(record: RunRecord, iteration: int | None = None) -> list[Column]:
    """The columns of the steps of one deployment, or of all.

    Raises:
        InputError: There is no such deployment.
    """
    steps = record.steps if iteration is None else record.steps.of_iteration(iteration)
    if not len(steps):
        there = ", ".join(map(str, record.steps.iterations))
        raise InputError(f"--iteration {iteration}: no step of it in {record.folder}; there are {there}")
    said = _said(record.space)
    rows = [list(values_of(logged, record.space).values()) for logged in steps]
    return [
        Column(name, *said[name], np.array(values))
        for name, values in zip(column_names(record.space), zip(*rows, strict=True), strict=True)
    ]


def _said(space: StepSpace) -> dict[str, tuple[str, str]]:
    """Unit and meaning of each column; the header does not know units, but those of the hopper are known."""
    hopper = CommandBounds().space()
    known = {quantity.name: quantity.unit for quantity in (*hopper.state, *hopper.command)}

    def of(quantities: Sequence[Quantity], places: dict[str, str]) -> dict[str, tuple[str, str]]:
        return {
            place + quantity.name: (quantity.unit or known.get(quantity.name, ""), meaning)
            for place, meaning in places.items()
            for quantity in quantities
        }

    return {
        "iteration": ("", "number of the deployment, from 0"),
        "step": ("", "number of the step in it, from 1; steps that calibrate come before"),
        **of(space.state, PLACES),
        **of(space.command, COMMANDS),
        "yaw_after": ("rad", "yaw after the step; NaN where it is not measured"),
        "status": ("", "how the step ended: ok, or why there was no next apex"),
    }
