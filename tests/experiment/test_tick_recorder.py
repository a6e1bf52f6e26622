"""Recorded ticks of a run: each is assigned to its step, and the ticks of the right deployments are kept."""

from pathlib import Path

import numpy as np

from stepgap.experiment.loop import Observer, deployment_generator
from stepgap.experiment.plants import simulation_of
from stepgap.experiment.recorders import TickRecorder
from stepgap.experiment.settings import read_experiment
from stepgap.learning.steps import LoggedStep
from stepgap.plants.compiled_rig import Rows
from stepgap.records.summary import Deployment
from stepgap.step import StepRecord, StepStatus

NONE = np.zeros(2)


def step(iteration: int, number: int) -> LoggedStep:
    return LoggedStep(iteration, number, NONE, NONE, NONE, StepRecord(NONE, NONE, NONE, NONE, StepStatus.OK))


def deployment(iteration: int) -> Deployment:
    return Deployment(iteration, "none", 2, 0, NONE, NONE, NONE, NONE, NONE, NONE, 0, NONE, NONE)


UNITS = {"time": "s", "height": "m"}


def execute(recorder: TickRecorder, number: int, ticks: int = 10) -> None:
    """Records the ticks of a step, some at a time."""
    rows = [(0.001 * row, 0.5) for row in range(ticks)]
    for block in rows[:4], rows[4:5], rows[5:]:
        recorder.on_ticks(block, number)


def test_a_tick_is_assigned_to_its_step(tmp_path: Path) -> None:
    (tmp_path / "experiment.toml").write_text("seed = 3\n")
    settings, seen = read_experiment(tmp_path / "experiment.toml"), set[int]()

    def on_ticks(rows: Rows, number: int) -> None:
        seen.add(number)

    plant = simulation_of(settings).plant(deployment_generator(settings.seed, 0), on_ticks)
    for _ in range(2):
        with plant:
            plant.start()
            assert seen == {0}
            for number in (1, 2, 3):
                seen.clear()
                plant.take_step(NONE)
                assert seen == {number}
        seen.clear()


def test_the_first_and_the_latest_deployment_are_kept() -> None:
    reported: list[object] = []
    recorder = TickRecorder(UNITS, every=5)
    observer = recorder.observing(Observer(reported.append, reported.append))
    for iteration in range(3):
        for number in (0, 1, 2):
            execute(recorder, number, 10 + iteration)
            if number:
                observer.on_step(step(iteration, number))
        observer.on_deployment(deployment(iteration))
    assert len(reported) == 3 * (2 + 1)
    assert set(recorder.kept) == {0, 2}
    first = recorder.kept[0]
    assert list(first.units) == [*UNITS, "step"]
    assert first["step"].tolist() == [0, 0, 1, 1, 2, 2]
    assert recorder.kept[2]["step"].tolist() == [0, 0, 0, 1, 1, 2, 2, 2]


def test_exploratory_steps_have_numbers_up_to_zero() -> None:
    recorder = TickRecorder(UNITS, every=5)
    observer = recorder.observing(Observer())
    execute(recorder, 0)
    for executed, number in enumerate((-1, 0, 1), 1):
        execute(recorder, executed)
        observer.on_step(step(0, number))
    observer.on_deployment(deployment(0))
    assert recorder.kept[0]["step"].tolist() == [-2, -2, -1, -1, 0, 0, 1, 1]


def test_deployments_that_were_recorded_earlier_have_no_ticks() -> None:
    recorder = TickRecorder(UNITS, every=5)
    observer = recorder.observing(Observer())
    for number in (1, 2):
        observer.on_step(step(0, number))
    observer.on_deployment(deployment(0))
    execute(recorder, 0)
    execute(recorder, 1)
    observer.on_step(step(1, 1))
    observer.on_deployment(deployment(1))
    assert set(recorder.kept) == {1}
    assert recorder.kept[1]["step"].tolist() == [0, 0, 1, 1]
