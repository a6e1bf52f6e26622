"""The steps of a run as columns with units and meanings."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stepgap.base.errors import InputError
from stepgap.learning.steps import AFTER, Steps
from stepgap.step import Quantity, StepSpace

STATE_MEANINGS = {
    "": "state before the step",
    "target_": "target state after the step",
    "next_": "state after the step, as measured; NaN if it failed",
    "true_next_": "state after the step as it truly was, known only in a simulation; else NaN",
    "predicted_": "state after the step as predicted when it began; NaN where no command was known",
    "std_": "standard deviation of that prediction",
}
"""Meaning of a state coordinate's column, by its prefix."""

COMMAND_MEANINGS = {
    "": "command of the controller",
    "requested_": "command that was requested of the joints, which learning uses",
    "applied_": "command that the joints received",
}
"""Meaning of a command coordinate's column, by its prefix."""


@dataclass(frozen=True, eq=False)
class Column:
    """One column of `steps.csv`.

    Attributes:
        name: Name in the header.
        unit: SI unit; empty for counts and for strings.
        meaning: Short description of the content.
        values: One value per step: integers, numbers or strings; shape (N,).
    """

    name: str
    unit: str
    meaning: str
    values: np.ndarray


def step_columns(recorded: Steps, iteration: int | None = None) -> list[Column]:
    """Columns of the steps of one deployment, or of all.

    Raises:
        InputError: There is no such deployment.
    """
    steps = recorded if iteration is None else recorded.of_iteration(iteration)
    if not len(steps):
        there = ", ".join(map(str, recorded.iterations))
        raise InputError(f"--deployment {iteration}: no step of it in the run; there are {there}")
    legend = _legend(steps.space)
    return [Column(name, *legend[name], values) for name, values in steps.to_dict().items()]


def _legend(space: StepSpace) -> dict[str, tuple[str, str]]:
    def of(quantities: Sequence[Quantity], meanings: dict[str, str]) -> dict[str, tuple[str, str]]:
        return {
            prefix + quantity.name: (quantity.unit, meaning)
            for prefix, meaning in meanings.items()
            for quantity in quantities
        }

    return {
        "iteration": ("", "number of the deployment, from 0"),
        "step": (
            "",
            "number of the step in the deployment, from 1; earlier ones, such as exploratory steps, have less",
        ),
        **of(space.state, STATE_MEANINGS),
        **of(space.command, COMMAND_MEANINGS),
        **{
            f"{quantity.name}{AFTER}": (quantity.unit, f"{quantity.name} after the step; NaN where it is not measured")
            for quantity in space.context
        },
        "status": ("", "outcome of the step: ok, or the reason why there is no next state"),
    }
