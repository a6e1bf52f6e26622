"""`benchmarks.speed step-map`: it runs and reports its measurements; no test checks the times."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.speed import step_map as bench_map
from benchmarks.speed.__main__ import speed_line
from tests.cli.command_line import Command, refused

TINY = bench_map.MapBenchSize(points=1, rounds=1, solves=3, table=5, batch=20)

SECTIONS = ("Jacobian ", "root solve ", "batch ", "command table ")
KEYS = {"schema", "quick", "seed", "machine", "engines", "jacobian", "root_solve", "batch", "table"}


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_map, "QUICK_MAP_BENCH", TINY)


@pytest.mark.usefixtures("tiny")
def test_the_quick_bench_writes_json_and_a_table(stepgap: Command) -> None:
    command_result = stepgap("step-map", "--quick", verbs=speed_line)
    assert command_result.code == 0, command_result.err
    assert command_result.out.endswith("\nbench_map.json\n")
    for line in ("StepGap ", "StepGap in a batch ", *SECTIONS):
        assert re.search(f"^{line}", command_result.out, re.MULTILINE), line
    result = json.loads(Path("bench_map.json").read_text())
    assert result.keys() == KEYS
    ours, batch = result["engines"]
    assert (ours["name"], batch["name"]) == ("StepGap", "StepGap in a batch")
    assert result["root_solve"]["solved_share"] == 1
    assert result["machine"]["numpy"] == np.__version__


def test_bad_input_is_refused(stepgap: Command) -> None:
    Path("there.json").write_text("keep me")
    again = stepgap("step-map", "--out", "there.json", verbs=speed_line)
    refused(again, "there.json: exists already; choose another --out")
    refused(stepgap("step-map", "--gains.stifness", "3", verbs=speed_line), "did you mean stiffness?")
    refused(stepgap("maps", verbs=speed_line), "maps")
    assert Path("there.json").read_text() == "keep me"


def test_settings_with_which_nothing_hops_fail_in_one_line(stepgap: Command) -> None:
    command_result = stepgap("step-map", "--quick", "--gains.rest_length", "0.2", verbs=speed_line)
    assert (command_result.code, command_result.out) == (1, "")
    assert command_result.err.splitlines()[-1].startswith("stepgap: only 0 of 12 random steps succeed; choose settings")
    assert not list(Path().iterdir())
