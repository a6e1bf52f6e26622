"""The comparison of learning methods as cases, one for each twin and seed."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import tomli_w

from benchmarks.learning.learning_summary import UNCORRECTED, DeploymentRow
from benchmarks.learning.tasks import DEFAULT_TASK, tasks
from benchmarks.learning.twin_trials import measure_twin
from stepgap.base.errors import InputError
from stepgap.base.ranges import require
from stepgap.base.settings_file import build_from_file, to_table
from stepgap.control.reference import parse_reference
from stepgap.robots.hopper.parameters import CommandBounds
from stepgap.sweep.cases.case_folder import CaseFolder
from stepgap.sweep.cases.plan import CaseOutput

LEARNING_FILE = "learning.toml"
"""File in the folder of a comparison with its plan."""

MOST_REPETITIONS = 1000
"""Largest number of twins, and of seeds."""


@dataclass(frozen=True)
class LearningPlan:
    """What is compared; it is a `Plan`, in which the twin changes faster than the seed.

    Attributes:
        twins: Number of twins.
        seeds: Number of seeds of each twin.
        methods: Names of methods.
        reference: Reference to track, as CSV text.
        task: Name of the task.
    """

    twins: int
    seeds: int
    methods: tuple[str, ...]
    reference: str
    task: str = DEFAULT_TASK

    def __post_init__(self) -> None:
        for name in ("twins", "seeds"):
            number = getattr(self, name)
            require(1 <= number <= MOST_REPETITIONS, name, number, f"lie between 1 and {MOST_REPETITIONS}")
        require(self.task in tasks(), "task", self.task, f"be one of {', '.join(tasks())}")

    def __len__(self) -> int:
        return self.twins * self.seeds

    @property
    def files(self) -> Mapping[str, str]:
        """Text of the file from which `read_learning_plan` reads the plan again, by its name."""
        return {LEARNING_FILE: tomli_w.dumps(to_table(self), multiline_strings=True)}

    def twin_and_seed(self, number: int) -> tuple[int, int]:
        """Twin and seed of a case."""
        return number % self.twins, number // self.twins

    def case(self, number: int) -> dict[str, Any]:
        """Twin, seed, methods, reference and task of a case."""
        twin, seed = self.twin_and_seed(number)
        shared = {"methods": list(self.methods), "reference": self.reference, "task": self.task}
        return {"twin": twin, "seed": seed} | shared


def read_learning_plan(path: Path) -> LearningPlan:
    """Reads the plan of a comparison from its file.

    Raises:
        InputError: The file is not such a plan; the message names the file, the key and what would be right.
    """
    return build_from_file(LearningPlan, path, "the plan of a comparison")


def measure_case(case: Mapping[str, Any]) -> CaseOutput:
    """Measures all methods on the twin of a case; the result is the list of their rows."""
    reference = parse_reference(case["reference"], CommandBounds().space())
    task = replace(tasks()[case["task"]], reference=reference)
    return CaseOutput(measure_twin(task, case["twin"], case["seed"], case["methods"]))


class LearningResults(NamedTuple):
    """Results of the finished cases.

    Attributes:
        rows: Measures of the deployments, sorted by method, seed and twin; deployment 0 of all cases comes first.
        failed: Reasons of the cases that failed, by their number; they have no rows.
    """

    rows: list[DeploymentRow]
    failed: dict[int, str]


def learning_results(plan: LearningPlan, folder: CaseFolder) -> LearningResults:
    """Reads the results of all finished cases.

    Raises:
        InputError: The result of a case is not valid.
        OSError: A file cannot be read.
    """
    cases: list[dict[str, DeploymentRow]] = []
    failed: dict[int, str] = {}
    methods = (UNCORRECTED, *plan.methods)
    for number, found in folder.results():
        if found.failed:
            failed[number] = found.failed
            continue
        try:
            rows = {row["method"]: row for row in found.result}
            if not rows.keys() >= set(methods):
                raise KeyError
        except (KeyError, TypeError):
            raise InputError(f"{folder.path}: case {number} lacks the rows of a method; choose another --out") from None
        cases.append(rows)
    return LearningResults([rows[method] for method in methods for rows in cases], failed)
