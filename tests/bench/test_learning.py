"""`stepgap bench learning`: its measures are correct; no test checks which method is best."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from stepgap.bench import learning as bench_learning
from stepgap.bench.learning import SKIPPED, Trial, count_covered, hopping_gap, measure_twin, methods
from stepgap.control import reference
from stepgap.control.reference import Reference
from stepgap.learning.step_log import LoggedStep, StepLog
from stepgap.robots.hopper.apex_map import ApexMap
from stepgap.robots.hopper.twin.family import DRAWN, random_gap
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.step import StepRecord, StepStatus
from tests.cli.command_line import Command, refused

SHORT = Reference.from_segments(("speed", "height"), [(1, (0.0, 0.55)), (5, (0.17, 0.58))], steps=10)
NOMINAL = ApexMap()


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reference, "paper_reference", lambda: SHORT)
    monkeypatch.setattr(os, "cpu_count", lambda: 1)


def test_every_twin_of_the_family_is_drawn_independently() -> None:
    rng = np.random.default_rng(0)
    gaps = [random_gap(rng) for _ in range(20)]
    assert all(len({getattr(gap, name) for gap in gaps}) == 20 for name in DRAWN)
    assert random_gap(np.random.default_rng(3)) == random_gap(np.random.default_rng(3))


def test_every_method_has_the_same_twin_and_the_same_seed_gives_the_same_numbers() -> None:
    rows = measure_twin(SHORT, 0, 1, ["linear", "auto", "online"])
    assert [row["method"] for row in rows] == ["none", "linear", "auto", "online"]
    for row in rows:
        assert (row["twin"], row["seed"], row["steps"], row["falls"]) == (0, 1, 10, 0)
        assert np.isfinite([row["error"], *row["rmse"], *row["transient_rmse"]]).all()
    assert measure_twin(SHORT, 0, 1, ["online"]) == [rows[0], rows[-1]]
    assert measure_twin(SHORT, 0, 2, [])[0]["error"] != rows[0]["error"]


def test_equal_residuals_are_deployed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    trial = Trial(NOMINAL, RealityGap(), SHORT, twin=0, seed=0)
    log = trial.deploy(trial.uncorrected(), 0)
    first = methods()["linear"](trial, log)
    assert methods()["linear"](trial, log) is first
    assert methods()["constant"](trial, log) is not first


def test_a_deployment_is_recorded_as_it_was_made() -> None:
    trial, ticks = Trial(NOMINAL, RealityGap(), SHORT, twin=0, seed=0), []
    log, again = trial.deploy(trial.uncorrected(), 0), trial.deploy(trial.uncorrected(), 0, on_ticks=ticks.extend)
    np.testing.assert_array_equal(again.next_state, log.next_state)
    assert len(ticks) > 500 * len(log)


def test_draws_that_fall_at_once_are_drawn_again(monkeypatch: pytest.MonkeyPatch) -> None:
    lame = RealityGap(torque_scale=0.1)
    draws = iter([lame, RealityGap()])
    monkeypatch.setattr(bench_learning, "random_gap", lambda rng: next(draws))
    assert hopping_gap(NOMINAL, SHORT, 0) == (RealityGap(), 1)
    fallen = Trial(NOMINAL, lame, SHORT, twin=0, seed=0)
    log = fallen.deploy(fallen.uncorrected(), 0)
    assert log.falls == 1 or not len(log)


def test_coverage_counts_steps_within_the_interval() -> None:
    def logged(error: float, std: float) -> LoggedStep:
        predicted = np.array([0.2, 0.58])
        record = StepRecord(predicted, np.zeros(2), np.zeros(2), predicted + np.array([error, 0.0]), StepStatus.OK)
        return LoggedStep(1, 1, predicted, predicted, np.full(2, std), record)

    steps = [logged(0.0195, 0.01), logged(-0.0197, 0.01), logged(0.0, 0.01), logged(0.0, 0.0)]
    covered, counted = count_covered(StepLog(NOMINAL.space, steps))
    assert (covered.tolist(), counted) == ([2, 3], 3)


def test_a_second_call_adds_what_is_missing(tiny: None, stepgap: Command) -> None:
    result = stepgap("bench", "learning", "--twins", 1, "--seeds", 1, "--methods", "constant")
    assert result.code == 0, result.err
    assert result.out.endswith("\nbench_learning.jsonl\nbench_learning.json\nbench_learning.png\n")
    before = Path("bench_learning.jsonl").read_text()
    Path("bench_learning.jsonl").write_text(before + '[{"twin": 0, "se')  # cut off here
    result = stepgap("bench", "learning", "--twins", 1, "--seeds", 2, "--methods", "constant")
    assert "1 of 1 done" in result.err
    record = Path("bench_learning.jsonl").read_text()
    assert record.startswith(before)
    assert len(record.splitlines()) == 2
    again = stepgap("bench", "learning", "--twins", 1, "--seeds", 2, "--methods", "constant")
    assert (again.out, again.err) == (result.out, "")
    assert Path("bench_learning.jsonl").read_text() == record
    summary = json.loads(Path("bench_learning.json").read_text())
    assert (summary["pairs"], [row["method"] for row in summary["methods"]]) == (2, ["none", "constant"])


def test_bad_input_is_refused(stepgap: Command) -> None:
    refused(stepgap("bench", "learning", "--methods", "linear,magic"), "magic", "it must be one of integral")
    if "sysid" in SKIPPED:
        refused(stepgap("bench", "learning", "--methods", "sysid"), "sysid", "stepgap[sysid]")
    refused(stepgap("bench", "learning", "--out", "nowhere/x.jsonl"), "nowhere/x.jsonl", "a folder that exists")
    refused(stepgap("bench", "learning", "--out", "x.json"), ".jsonl")
    for content in ("my notes", "my notes\n", "[1]\n", '[{"twin": 0\n', "\xff"):
        Path("mine.jsonl").write_text(content, encoding="latin-1")
        refused(stepgap("bench", "learning", "--out", "mine.jsonl"), "--out mine.jsonl: not a record of this benchmark")
        assert Path("mine.jsonl").read_text(encoding="latin-1") == content
    Path("other.png").write_text("mine")
    refused(stepgap("bench", "learning", "--out", "other.jsonl"), "other.png: exists already; choose another --out")
    refused(stepgap("bench", "learning", "--twins", "0"), "twins")
