"""Cases of a command table: together they are the table, to the last bit."""

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest

from stepgap.base.errors import InputError, StepGapError
from stepgap.control.command_table import CommandTable
from stepgap.control.command_table_file import write_table
from stepgap.experiment.cases.case_folder import CaseFolder
from stepgap.experiment.cases.plan import CaseResult, computed
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.settings import Experiment
from stepgap.experiment.table_plan import TablePlan, solve_batch, table_of_cases
from stepgap.robots.hopper.parameters import Gains
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.sampled_map import SampledApexMap
from stepgap.step import StepStatus

STUMBLING = Gains(speed_gain=2.0)
STUMBLES = Experiment(Hopper(gains=STUMBLING))
PLAN = TablePlan(STUMBLES, points=3, batch=20)
"""A map with nodes without any step, which have no numbers."""


def content(path: Path, table: CommandTable) -> bytes:
    write_table(path, table)
    return path.read_bytes()


def stored(folder: CaseFolder, **results: Any) -> None:
    for number in range(len(PLAN)):
        assert folder.claim(number)
        folder.store(number, results.get(f"case{number}") or computed(solve_batch, PLAN.case(number)))


def test_the_cases_are_the_table_to_the_last_bit(tmp_path: Path) -> None:
    batches, nominal = PLAN.batches, load_nominal(PLAN.settings).map
    expected = batches.table([batches.solve(nominal, number) for number in range(len(batches))])
    assert len(PLAN) == len(batches) == 4
    assert 0 < (expected.statuses == StepStatus.OK).mean() < 1
    with CaseFolder(tmp_path / "cases", PLAN, join=False) as folder:
        stored(folder)
        found = table_of_cases(PLAN, folder)
    assert content(tmp_path / "found.npz", found) == content(tmp_path / "expected.npz", expected)


def test_a_tick_is_a_part_of_the_plan() -> None:
    plan = TablePlan(Experiment(), points=2, tick=0.001, batch=4)
    found = solve_batch(tomllib.loads(plan.case(3))).result
    expected = plan.batches.solve(SampledApexMap(tick=0.001), 3)
    assert found["command"] == expected.command.tolist()
    assert found["status"] == expected.status.tolist()


def test_results_are_valid_json() -> None:
    result = computed(solve_batch, PLAN.case(3))
    assert result.failed == ""
    assert "NaN" not in json.dumps(result.content())
    assert json.loads(json.dumps(result.content()))["result"] == result.result


def test_a_failed_or_a_wrong_case_makes_no_table(tmp_path: Path) -> None:
    with CaseFolder(tmp_path / "failed", PLAN, join=False) as folder:
        stored(folder, case2=CaseResult(failed="too little memory"))
        with pytest.raises(StepGapError, match=r"1 of 4 cases failed \(too little memory\); compute them again"):
            table_of_cases(PLAN, folder)
    short = {"command": [], "predicted": [], "reached": [], "status": []}
    for number, wrong in enumerate(({}, [1], {**short, "status": ["lame"]}, short)):
        with CaseFolder(tmp_path / str(number), PLAN, join=False) as folder:
            stored(folder, case1=CaseResult(wrong))
            with pytest.raises(InputError, match="a result is not that of this table"):
                table_of_cases(PLAN, folder)
