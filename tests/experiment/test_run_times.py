"""Times of a run are recorded beside its record, which stays the same byte by byte."""

from functools import partial
from pathlib import Path

import numpy as np

from stepgap.experiment.loop import Observer, Plants, Setup, run_experiment
from stepgap.experiment.recorders import TimeRecorder
from stepgap.experiment.run import Run
from stepgap.learning.settings import LearningSettings
from stepgap.plants.model_plant import ModelPlant
from stepgap.records.times_file import TIMES_FILE, read_times
from stepgap.report.tables import times_in_words, times_table
from tests.control.maps import LossyHopper
from tests.report.runs import REAL, TARGETS


def setup(iterations: int) -> Setup:
    plant = partial(ModelPlant, REAL, TARGETS.targets[0], np.array([0.005, 0.002]))
    return Setup(LossyHopper(), Plants(plant), TARGETS, LearningSettings("linear", iterations, early_stop=False))


def test_every_fit_and_every_plan_is_timed_and_the_record_stays_the_same(tmp_path: Path) -> None:
    timed, plain, heard = tmp_path / "timed", tmp_path / "plain", list[str]()
    for folder in (timed, plain):
        folder.mkdir()
    observer = Observer(on_time=lambda iteration, part, seconds: heard.append(f"{iteration} {part}"))
    run_experiment(setup(1), timed, TimeRecorder(timed).observing(observer))
    run_experiment(setup(1), plain)
    times = read_times(timed)
    assert isinstance(times, dict)
    assert {number: {part: found["count"] for part, found in parts.items()} for number, parts in times.items()} == {
        0: {"planning": len(TARGETS), "learning": len(TARGETS)},
        1: {"fit": 1, "planning": len(TARGETS), "learning": len(TARGETS)},
    }
    assert heard.count("1 planning") == len(TARGETS)
    names = {path.relative_to(timed) for path in timed.rglob("*") if path.is_file()} - {Path(TIMES_FILE)}
    assert all((timed / name).read_bytes() == (plain / name).read_bytes() for name in names)
    run = Run(timed, space=LossyHopper().space)
    assert times_in_words(run)[0].startswith("In deployment 1, planning a step took ")
    assert times_table(run).count("<tr>") == 3
    without = Run(plain, space=LossyHopper().space)
    assert (times_in_words(without), times_table(without)) == ([], "")


def test_deployments_that_are_not_executed_again_keep_their_times(tmp_path: Path) -> None:
    run_experiment(setup(1), tmp_path, TimeRecorder(tmp_path).observing(Observer()))
    before = read_times(tmp_path)
    assert isinstance(before, dict)
    run_experiment(setup(1), tmp_path, TimeRecorder(tmp_path).observing(Observer()))
    assert read_times(tmp_path) == before
    run_experiment(setup(2), tmp_path, TimeRecorder(tmp_path).observing(Observer()))
    after = read_times(tmp_path)
    assert isinstance(after, dict)
    assert sorted(after) == [0, 1, 2]
    assert {number: after[number] for number in before} == before
