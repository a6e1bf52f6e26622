"""`benchmarks.speed gp`: it runs and reports its measurements; no test checks the times."""

import json
import re
from pathlib import Path

import pytest

from benchmarks.speed import gaussian_process as bench_gp
from benchmarks.speed.__main__ import speed_line
from tests.cli.command_line import Command, refused


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        bench_gp, "QUICK_GP_BENCH", bench_gp.GpBenchSize(points=(30, 40), rounds=(1, 1), calls=2, queries=50)
    )


def test_the_quick_bench_writes_json_and_a_table(stepgap: Command) -> None:
    command_result = stepgap("gp", "--quick", verbs=speed_line)
    assert command_result.code == 0, command_result.err
    assert command_result.out.endswith("\nbench_gp.json\n")
    for line in (" +30  StepGap ", " +40  StepGap, linear basis "):
        assert re.search(f"^{line}", command_result.out, re.MULTILINE), line
    result = json.loads(Path("bench_gp.json").read_text())
    assert {row["name"] for row in result["rows"]} == {"StepGap", "StepGap, linear basis"}


def test_bad_input_is_refused(stepgap: Command) -> None:
    Path("there.json").write_text("keep me")
    refused(stepgap("gp", "--out", "there.json", verbs=speed_line), "there.json: exists already; choose another --out")
    assert Path("there.json").read_text() == "keep me"
