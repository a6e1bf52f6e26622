"""`python -m benchmarks.learning`: its measures are correct; no test checks which method is best."""

import json
import os
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from benchmarks.learning import learning_plan, tasks
from benchmarks.learning.__main__ import learning_line
from benchmarks.learning.learning_plan import LearningPlan, learning_results, read_learning_plan
from benchmarks.learning.learning_summary import summarise_learning
from benchmarks.learning.methods.registry import methods
from benchmarks.learning.tasks import Change, Task, square_reference
from benchmarks.learning.trial import Trial, hopping_gap
from benchmarks.learning.twin_trials import measure_twin
from stepgap.base.errors import InputError, StepGapError
from stepgap.base.settings_file import to_table
from stepgap.control.reference import Reference, parse_reference, reference_text
from stepgap.experiment.bands import interval_coverage
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.robots.gap import differences
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.step import StepRecord, StepStatus
from stepgap.sweep.cases.case_folder import CaseFolder
from stepgap.sweep.cases.plan import CaseResult
from tests.cli.command_line import Command, refused

SHORT = Reference.from_segments(("speed", "height"), [(1, (0.0, 0.55)), (3, (0.17, 0.58))], steps=5)
NOMINAL = ApexMap()
TASK = Task("reference", SHORT)
TINY = Reference(SHORT.names, SHORT.targets[:2])


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tasks, "paper_reference", lambda: TINY)
    monkeypatch.setattr(os, "cpu_count", lambda: 1)


def test_every_twin_of_the_family_is_drawn_independently() -> None:
    rng = np.random.default_rng(0)
    gaps = [RealityGap.random(rng) for _ in range(20)]
    assert all(
        len({getattr(gap, name) for gap in gaps}) == 20
        for name, known in differences(RealityGap).items()
        if known.drawn
    )
    assert RealityGap.random(np.random.default_rng(3)) == RealityGap.random(np.random.default_rng(3))


def test_every_method_has_the_same_twin_and_the_same_seed_gives_the_same_numbers() -> None:
    rows = measure_twin(TASK, 0, 1, ["auto", "online"])
    assert [row["method"] for row in rows] == ["none", "auto", "online"]
    for row in rows:
        assert (row["twin"], row["seed"], row["steps"], row["falls"]) == (0, 1, len(SHORT), 0)
        assert np.isfinite([row["error"], *row["rmse"], *row["transient_rmse"]]).all()
    assert measure_twin(TASK, 0, 1, ["online"]) == [rows[0], rows[-1]]
    assert measure_twin(TASK, 0, 2, [])[0]["error"] != rows[0]["error"]


def test_equal_residuals_are_deployed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    trial = Trial(NOMINAL, RealityGap(), TASK, twin=0, seed=0)
    first = methods()["linear"](trial)
    assert first[0] is trial.first
    assert methods()["linear"](trial)[1] is first[1]
    assert methods()["constant"](trial)[1] is not first[1]


def test_a_deployment_is_recorded_as_it_was_made() -> None:
    trial, ticks = Trial(NOMINAL, RealityGap(), TASK, twin=0, seed=0), []
    log, again = trial.first, trial.deploy(trial.uncorrected(NOMINAL), 0, on_ticks=lambda got, step: ticks.extend(got))
    np.testing.assert_array_equal(again.next_state, log.next_state)
    assert len(ticks) > 500 * len(log)


def test_draws_that_fall_at_once_are_drawn_again(monkeypatch: pytest.MonkeyPatch) -> None:
    lame = RealityGap(torque_scale=0.1)
    draws = iter([lame, RealityGap()])
    monkeypatch.setattr(RealityGap, "random", lambda rng: next(draws))
    assert hopping_gap(NOMINAL, TASK, 0) == (RealityGap(), 1)
    fallen = Trial(NOMINAL, lame, TASK, twin=0, seed=0)
    assert fallen.first.failed_steps == 1 or not len(fallen.first)


def test_coverage_counts_steps_within_the_interval() -> None:
    def logged(error: float, std: float) -> LoggedStep:
        predicted = np.array([0.2, 0.58])
        record = StepRecord(predicted, np.zeros(2), np.zeros(2), predicted + np.array([error, 0.0]), StepStatus.OK)
        return LoggedStep(1, 1, predicted, predicted, np.full(2, std), record)

    steps = [logged(0.0195, 0.01), logged(-0.0197, 0.01), logged(0.0, 0.01), logged(0.0, 0.0)]
    covered, counted = interval_coverage(Steps(NOMINAL.space, steps))
    assert (covered.tolist(), counted.tolist()) == ([2, 3], [3, 3])


def test_a_task_gives_every_twin_its_numbers_and_changes_only_the_deployment_that_is_measured() -> None:
    task = Task("heavier", SHORT, {"torque_limit": 30.0}, Change(4, {"body_mass_scale": 1.15}))
    gap, _ = hopping_gap(NOMINAL, task, 0)
    assert gap.torque_limit == 30
    trial = Trial(NOMINAL, gap, task, twin=0, seed=0)
    unchanged, changed = trial.first.planned(), trial.measure(trial.uncorrected(NOMINAL), 0).planned()
    np.testing.assert_array_equal(changed.next_state[:3], unchanged.next_state[:3])
    heights = (changed.next_state - unchanged.next_state)[3:, 1]
    assert (heights < -0.001).all(), "the heavier robot hops lower"
    rows = measure_twin(task, 0, 0, ["linear"])
    assert (rows[0]["task"], rows[0]["deployments"], rows[1]["deployments"]) == ("heavier", 1, 2)
    np.testing.assert_array_equal(methods()["linear"](trial)[0].planned().next_state, unchanged.next_state)


def test_the_square_wave_never_rests_and_its_steady_error_is_unknown() -> None:
    square = square_reference()
    assert not len(square.steady)
    assert (np.diff(square.targets[:, 0]) != 0).sum() == len(square) // 4
    assert np.unique(square.targets, axis=0).tolist() == [[0.15, 0.58], [0.15, 0.62], [0.35, 0.58], [0.35, 0.62]]
    short = Reference(square.names, square.targets[:9])
    (row,) = measure_twin(Task("square", short), 0, 0, [])
    assert row["steady_rmse"] is None
    assert np.isfinite([*row["rmse"], *row["transient_rmse"]]).all()


def test_every_task_has_twins_that_differ_as_it_says() -> None:
    found = tasks.tasks()
    assert {name: task.name for name, task in found.items()} == {name: name for name in found}
    drawn = RealityGap.random(np.random.default_rng(0))
    assert found["reference"].gap_of(drawn) == drawn
    assert found["rough"].gap_of(drawn).ground_roughness == 0.01
    assert found["torque_limit"].gap_of(drawn).torque_limit == 13
    change = found["payload"].change
    assert change
    assert change.of(drawn).body_mass_scale == pytest.approx(1.15 * drawn.body_mass_scale)


PLAN = LearningPlan(twins=2, seeds=2, methods=("constant",), reference=reference_text(SHORT))
COMMAND = ("--twins", 2, "--seeds", 1, "--methods", "constant")
RESULTS = ("results.json", "summary.json", "learning.png")


def test_a_plan_is_read_again_and_its_cases_are_all_twins_of_one_seed_after_the_other(tmp_path: Path) -> None:
    ((name, text),) = PLAN.files.items()
    (tmp_path / name).write_text(text)
    assert read_learning_plan(tmp_path / name) == PLAN
    cases = [PLAN.case(number) for number in range(len(PLAN))]
    assert [(case["twin"], case["seed"]) for case in cases] == [(0, 0), (1, 0), (0, 1), (1, 1)]
    assert [PLAN.twin_and_seed(number) for number in range(4)] == [(0, 0), (1, 0), (0, 1), (1, 1)]
    read = parse_reference(cases[0]["reference"], NOMINAL.space)
    np.testing.assert_array_equal(read.targets, SHORT.targets)


@pytest.fixture
def compare(stepgap: Command) -> Command:
    """The command line of the benchmark."""
    return partial(stepgap, verbs=learning_line)


def test_processes_measure_the_same_as_one_call_after_the_other(tiny: None, compare: Command) -> None:
    result = compare(*COMMAND, "--out", "both", "--processes", 2)
    assert result.code == 0, result.err
    assert result.out.endswith("\nboth/results.json\nboth/summary.json\nboth/learning.png\n")
    first, second = (measure_twin(Task("reference", TINY), twin, 0, ["constant"]) for twin in (0, 1))
    rows = json.loads(Path("both/results.json").read_text())
    assert rows == [first[0], second[0], first[1], second[1]]
    assert json.loads(Path("both/summary.json").read_text()) == summarise_learning(rows)


def test_shards_that_are_merged_and_a_continued_call_give_the_same_files(
    tiny: None, in_a_thread: None, compare: Command
) -> None:
    whole = compare(*COMMAND, "--out", "whole")
    for shard in (1, 2):
        part = compare(*COMMAND, "--out", f"part{shard}", "--shard", f"{shard}/2")
        assert (part.code, part.out) == (0, "")
        assert part.err.endswith(f"part{shard}: 1 of 2 cases are finished\n")
    shutil.copytree("part1", "continued")
    shutil.copytree("part1", "merged")
    shutil.copytree("part2/cases", "merged/cases", dirs_exist_ok=True)
    merged = compare("--resume", "--out", "merged")
    continued = compare("--resume", "--out", "continued")
    shared = compare(*COMMAND, "--out", "part1", "--shard", "2/2", "--quiet")
    assert "1 of 1 cases" in continued.err, "the other one was finished"
    assert (merged.code, continued.code, shared.code) == (0, 0, 0)
    assert shared.out == "part1/results.json\npart1/summary.json\npart1/learning.png\n"
    for folder, result in {"merged": merged, "continued": continued}.items():
        assert result.out == whole.out.replace("whole/", f"{folder}/")
    for folder in ("merged", "continued", "part1"):
        for name in RESULTS:
            assert Path(folder, name).read_bytes() == Path("whole", name).read_bytes()


def test_failed_cases_are_named_and_left_out_until_they_are_measured_again(
    tiny: None, in_a_thread: None, compare: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    def measure(task: Task, twin: int, seed: int, names: list[str]) -> list[dict[str, object]]:
        raise StepGapError("the boom\nbroke")

    with monkeypatch.context() as patch:
        patch.setattr(learning_plan, "measure_twin", measure)
        result = compare(*COMMAND, "--out", "all")
        assert (result.code, result.out) == (1, "")
        assert result.err.endswith("\nstepgap: all: all 2 cases failed, the first one: the boom broke\n")
        compare(*COMMAND, "--out", "one", "--shard", "1/2")
    result = compare(*COMMAND, "--out", "one", "--resume")
    assert "\n1 of 2 cases failed and are left out:\n  twin 0, seed 0: the boom broke\none/results.json" in result.out
    assert json.loads(Path("one/summary.json").read_text())["pairs"] == 1
    result = compare(*COMMAND, "--out", "one", "--resume", "--retry-failed")
    assert "left out" not in result.out
    assert json.loads(Path("one/summary.json").read_text())["pairs"] == 2


def test_bad_input_is_refused(compare: Command) -> None:
    refused(compare("--methods", "linear,magic"), "--methods magic: it must be one of integral")
    refused(compare("--task", "stairs"), "--task stairs: it must be one of reference, payload")
    refused(compare("--twins", "0"), "twins")
    refused(compare("--shard", "3/2"), "--shard 3/2: must be I/N")
    Path("mine").write_text("my notes")
    refused(compare("--out", "mine"), "mine: File exists; choose another folder")
    assert Path("mine").read_text() == "my notes"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"twins": 0}, "learning.toml: twins = 0, but it must lie between 1 and 1000"),
        ({"twins": "two"}, "learning.toml: twins = 'two', but it must be an integer"),
        ({"task": "stairs"}, "learning.toml: task = 'stairs', but it must be one of reference, payload"),
        ({"seed": 1}, "learning.toml: seed: unknown key; did you mean seeds?"),
        ({"methods": ["magic"]}, "learning.toml: methods magic: it must be one of integral"),
    ],
)
def test_a_folder_with_a_wrong_plan_is_refused(compare: Command, changes: dict[str, object], message: str) -> None:
    Path("mine").mkdir()
    Path("mine/learning.toml").write_text(tomli_w.dumps(to_table(PLAN) | changes))
    refused(compare("--out", "mine", "--resume"), message)


def test_a_folder_of_other_cases_is_refused(compare: Command) -> None:
    Path("mine").mkdir()
    ((name, text),) = PLAN.files.items()
    Path("mine", name).write_text(text)
    other = ("--out", "mine", "--resume", "--quick")
    refused(compare(*other), "mine/learning.toml: already there, but of other cases than these; choose another")
    assert Path("mine", name).read_text() == text


def test_a_result_of_other_methods_is_refused(tiny: None, tmp_path: Path) -> None:
    folder = CaseFolder(tmp_path, PLAN, join=False)
    folder.store(1, CaseResult([{"method": "none"}]))
    with pytest.raises(InputError, match="case 1 lacks the rows of a method"):
        learning_results(PLAN, folder)
