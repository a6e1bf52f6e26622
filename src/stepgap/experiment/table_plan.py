"""A command table of a nominal map as cases, one for each batch of its nodes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from stepgap.base.errors import InputError, StepGapError
from stepgap.base.settings_file import with_table
from stepgap.control.command_table import BATCH, CommandTable, TableBatches
from stepgap.control.solve_many import Answers
from stepgap.experiment.cases.case_folder import CaseFolder
from stepgap.experiment.cases.plan import CaseOutput
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.settings import Experiment, changed_experiment, experiment_table
from stepgap.step import StepMap

TABLE_FILE = "table.toml"
"""File in the folder of a table's cases with its plan."""


@dataclass(frozen=True)
class TablePlan:
    """The map and the grid of a table; it is a `Plan`.

    Attributes:
        settings: Experiment with the robot and its nominal map.
        points: Points along each axis of the grid.
        tick: Time for which torques are held [s]; 0: they act continuously.
        batch: Approximate number of nodes of a case.
    """

    settings: Experiment
    points: int
    tick: float = 0.0
    batch: int = BATCH

    @property
    def batches(self) -> TableBatches:
        """The cases as batches of nodes."""
        return TableBatches(self.settings.robot.space, self.points, self.batch)

    def __len__(self) -> int:
        return len(self.batches)

    @property
    def files(self) -> Mapping[str, str]:
        """Text of the file that identifies the table, by its name."""
        return {TABLE_FILE: tomli_w.dumps(self._table())}

    def case(self, number: int) -> str:
        """The number of a batch, and the plan, as TOML."""
        return tomli_w.dumps({"number": number, **self._table()})

    def _table(self) -> dict[str, Any]:
        """All that determines the table."""
        model = Experiment(self.settings.robot.as_modelled, nominal=self.settings.nominal)
        return {"points": self.points, "tick": self.tick, "batch": self.batch, "model": experiment_table(model)}


def solve_batch(case: Mapping[str, Any]) -> CaseOutput:
    """Solves the nodes of a batch; the result contains the arrays of `Answers` as nested lists, without NaN."""
    settings = changed_experiment(Experiment(), case["model"], with_table)
    plan = TablePlan(settings, case["points"], case["tick"], case["batch"])
    nominal = sampled_map(settings, plan.tick or None)
    answers = plan.batches.solve(nominal, case["number"])
    return CaseOutput({name: _plain(values) for name, values in vars(answers).items()})


def sampled_map(settings: Experiment, tick: float | None) -> StepMap:
    """The nominal map or, if a tick [s] is given, that of the robot with torques that are held for it.

    Raises:
        InputError: The robot has none.
        ValueError: The tick is out of its range.
    """
    if tick is None:
        return load_nominal(settings).map
    found = settings.robot.sampled_map(tick)
    if found is None:
        raise InputError(f"robot '{settings.robot.name}' has no map with torques that are held for a tick")
    return found


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
