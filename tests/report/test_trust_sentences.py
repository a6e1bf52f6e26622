"""A run says which steps showed that the robot had changed, while it goes on and in its report."""

from pathlib import Path

import numpy as np

from stepgap.control.reference import Reference
from stepgap.experiment.loop import Observer, Plants, Setup, run_experiment
from stepgap.experiment.run import Run
from stepgap.experiment.settings import Experiment
from stepgap.learning.alarm import Alarm
from stepgap.learning.settings import LearningSettings
from stepgap.plants.plant import Plant
from stepgap.report.diagnosis_sentences import trust_sentences
from stepgap.robots.hopper.robot import Hopper
from stepgap.step import Array, StepRecord, StepSpace, StepStatus
from tests.control.maps import LossyHopper

NOMINAL = LossyHopper()
BEFORE, CHANGED = LossyHopper(loss=0.45, keep=0.6, drift=0.09), LossyHopper(loss=0.45, keep=0.6, drift=0.25)
FROM, TO = 41, 61
"""The robot has changed in these steps of every second deployment, the latter excluded."""


class ChangingPlant(Plant):
    """A robot that changes, and is later what it was."""

    def __init__(self, rng: np.random.Generator, *, changes: bool):
        self._rng, self._changes, self._state, self._step = rng, changes, np.array([0.2, 0.58]), 0

    @property
    def space(self) -> StepSpace:
        return NOMINAL.space

    def start(self) -> Array:
        return self._state

    def take_step(self, command: Array) -> StepRecord:
        self._step += 1
        robot = CHANGED if self._changes and FROM <= self._step < TO else BEFORE
        after = robot(self._state, command) + self._rng.normal(0, [0.004, 0.001])
        record = StepRecord(self._state, command, command, after, StepStatus.OK)
        self._state = after
        return record

    def stop(self) -> None:
        pass


def test_a_change_and_its_end_are_said(tmp_path: Path) -> None:
    targets = np.random.default_rng(5).uniform([0.05, 0.55], [0.3, 0.6], (80, 2))
    learning, made, heard = LearningSettings(iterations=1), [], list[Alarm]()

    def make(rng: np.random.Generator) -> Plant:
        made.append(rng)
        return ChangingPlant(rng, changes=len(made) > 1)

    setup = Setup(NOMINAL, Plants(make, replays=False), Reference(("speed", "height"), targets), learning, seed=3)
    found = run_experiment(setup, tmp_path, Observer(on_alarm=heard.append))
    assert [alarm.source for alarm in heard] == ["changed", "earlier"]
    assert FROM <= heard[0].step <= FROM + 3
    assert TO <= heard[1].step <= TO + 3
    assert [each.alarms for each in found] == [(), tuple(heard)]
    summary = tmp_path / "summary.json"
    written = summary.read_bytes()
    for kept in (written, None):  # with the summary alarms are read from it, without it they are found again
        if kept is None:
            summary.unlink()
        assert [each.alarms for each in run_experiment(setup, tmp_path)] == [(), tuple(heard)]
        assert summary.read_bytes() == written
    run = Run(tmp_path, nominal=NOMINAL, settings=Experiment(Hopper(), learning=learning), space=NOMINAL.space)
    first, second = trust_sentences(run)
    assert first.startswith(f"Deployment 1: after step {heard[0].step}, the robot was not the same as before")
    assert second.startswith(f"Deployment 1: after step {heard[1].step}, the robot was again as before")
