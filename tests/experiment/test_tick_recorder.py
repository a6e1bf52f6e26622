"""Recorded ticks of a run: each is assigned to its hop, and the ticks of the right deployments are kept."""

from pathlib import Path

import numpy as np

from stepgap.experiment.loop import Observer, deployment_generator
from stepgap.experiment.plants import simulation_of
from stepgap.experiment.settings import read_experiment
from stepgap.experiment.tick_recorder import HopCount, TickRecorder
from stepgap.learning.step_log import LoggedStep
from stepgap.plants.compiled_rig import Rows
from stepgap.records.summary import Deployment
from stepgap.robots.hopper.phases import Phase
from stepgap.robots.hopper.tick import TICK_UNITS
from stepgap.step import StepRecord, StepStatus

NONE = np.zeros(2)


def step(iteration: int, number: int) -> LoggedStep:
    return LoggedStep(iteration, number, NONE, NONE, NONE, StepRecord(NONE, NONE, NONE, NONE, StepStatus.OK))


def deployment(iteration: int) -> Deployment:
    return Deployment(iteration, "none", 2, 0, NONE, NONE, NONE, NONE, NONE, NONE, 0, NONE, NONE)


def tick(time: float, phase: Phase) -> list[float]:
    return [time, 1, 2, 3, 4, 5.0, phase, 0.1, 0.2, 0.0, 0.0, 0.0, 0.0, 0]


def hop(recorder: TickRecorder, ticks: int = 10) -> None:
    """Records a hop: descent, thrust, ascent, and descent in the last tick."""
    rows = [tick(0.001 * row, Phase(1 + row) if row < 3 else Phase.ASCENT) for row in range(ticks - 1)]
    rows.append(tick(1.0, Phase.DESCENT))
    for block in rows[:4], rows[4:5], rows[5:]:  # however many come at a time
        recorder.on_ticks(block)


def test_a_tick_is_assigned_to_its_hop(tmp_path: Path) -> None:
    (tmp_path / "experiment.toml").write_text("seed = 3\n")
    settings, count = read_experiment(tmp_path / "experiment.toml"), HopCount()
    observer, seen = count.observing(Observer()), set()

    def on_ticks(rows: Rows) -> None:
        seen.update((count.iteration, hop) for hop in count.on_ticks(rows))

    for iteration in range(2):
        rng = deployment_generator(settings.seed, iteration)
        with simulation_of(settings).plant(rng, on_ticks) as plant:
            plant.start()
            assert seen == {(iteration, 0)}
            for number in (1, 2, 3):
                seen.clear()
                plant.take_step(NONE)
                assert seen == {(iteration, number)}
                observer.on_step(step(iteration, number))
        seen.clear()
        observer.on_deployment(deployment(iteration))


def test_the_first_and_the_latest_deployment_are_kept() -> None:
    reported: list[object] = []
    recorder = TickRecorder(every=5)
    observer = recorder.observing(Observer(reported.append, reported.append))
    for iteration in range(3):
        for number in (0, 1, 2):
            hop(recorder, 10 + iteration)
            if number:
                observer.on_step(step(iteration, number))
        observer.on_deployment(deployment(iteration))
    assert len(reported) == 3 * (2 + 1)
    assert set(recorder.kept) == {0, 2}
    first = recorder.kept[0]
    assert list(first.units) == [*TICK_UNITS, "step"]
    assert first["step"].tolist() == [0, 0, 1, 1, 2, 2]
    assert recorder.kept[2]["step"].tolist() == [0, 0, 0, 1, 1, 2, 2, 2]


def test_exploratory_steps_have_numbers_up_to_zero() -> None:
    recorder = TickRecorder(every=5)
    observer = recorder.observing(Observer())
    hop(recorder)
    for number in (-1, 0, 1):
        hop(recorder)
        observer.on_step(step(0, number))
    observer.on_deployment(deployment(0))
    assert recorder.kept[0]["step"].tolist() == [-2, -2, -1, -1, 0, 0, 1, 1]


def test_deployments_that_were_recorded_earlier_have_no_ticks() -> None:
    recorder = TickRecorder(every=5)
    observer = recorder.observing(Observer())
    for number in (1, 2):
        observer.on_step(step(0, number))
    observer.on_deployment(deployment(0))
    hop(recorder)
    hop(recorder)
    observer.on_step(step(1, 1))
    observer.on_deployment(deployment(1))
    assert set(recorder.kept) == {1}
    assert recorder.kept[1]["step"].tolist() == [0, 0, 1, 1]
