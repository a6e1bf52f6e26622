"""A command table of the hopper's map as cases, one for each batch of its nodes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from stepgap.base.errors import InputError, StepGapError
from stepgap.base.settings_file import build, to_table, with_table
from stepgap.control.command_table import BATCH, CommandTable, TableBatches
from stepgap.control.solve_many import Answers
from stepgap.experiment.cases.case_folder import CaseFolder
from stepgap.experiment.cases.plan import CaseOutput
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.sampled_map import nominal_map

TABLE_FILE = "table.toml"
"""File in the folder of a table's cases with its plan."""


@dataclass(frozen=True)
class TablePlan:
    """The map and the grid of a table; it is a `Plan`.

    Attributes:
        robot: Robot of the map.
        gains: Its joint controller.
        command: Bounds of the command.
        points: Points along each axis of the grid.
        tick: Time for which torques are held [s]; 0: they act continuously.
        batch: Approximate number of nodes of a case.
    """

    robot: RobotParameters
    gains: Gains
    command: CommandBounds
    points: int
    tick: float = 0.0
    batch: int = BATCH

    @property
    def batches(self) -> TableBatches:
        """The cases as batches of nodes."""
        return TableBatches(self.command.space(), self.points, self.batch)

    def __len__(self) -> int:
        return len(self.batches)

    @property
    def files(self) -> Mapping[str, str]:
        """Text of the file that identifies the table, by its name."""
        return {TABLE_FILE: tomli_w.dumps(to_table(self))}

    def case(self, number: int) -> str:
        """The number of a batch, and the plan, as TOML."""
        return tomli_w.dumps({"number": number, "table": to_table(self)})


def solve_batch(case: Mapping[str, Any]) -> CaseOutput:
    """Solves the nodes of a batch; the result contains the arrays of `Answers` as nested lists, without NaN."""
    plan = build(TablePlan, case["table"], with_table)
    nominal = nominal_map(plan.robot, plan.gains, plan.command, plan.tick or None)
    answers = plan.batches.solve(nominal, case["number"])
    return CaseOutput({name: _plain(values) for name, values in vars(answers).items()})


def _plain(values: NDArray[Any]) -> Any:
    """An array as nested lists, in which None replaces NaN."""
    plain = values.astype(object)
    plain[np.isnan(values)] = None
    return plain.tolist()


def table_of_cases(plan: TablePlan, folder: CaseFolder) -> CommandTable:
    """Assembles the table from the results of all cases.

    Raises:
        StepGapError: Some of the cases failed.
        InputError: A result is not valid.
        OSError: A file cannot be read.
    """
    results = [found for _, found in folder.results()]
    if failed := [found.failed for found in results if found.failed]:
        remedy = "compute them again by --resume --retry-failed"
        raise StepGapError(f"{folder.path}: {len(failed)} of {len(plan)} cases failed ({failed[0]}); {remedy}")
    try:
        return plan.batches.table([_answers(found.result) for found in results])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{folder.path}: a result is not that of this table ({error}); remove this folder") from None


def _answers(result: Mapping[str, Any]) -> Answers:
    return Answers(
        np.array(result["command"], float),
        np.array(result["predicted"], float),
        np.array(result["reached"], bool),
        np.array(result["status"], np.int64),
    )
